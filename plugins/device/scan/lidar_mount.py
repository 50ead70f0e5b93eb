"""How a lidar is mounted, and its turns as scans in the robot's frame."""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.plugins.device.scan.interface import LaserScan
from robrain.protocol.lidar.points import Point
from robrain.protocol.model.geometry import Pose2D, wrap_angle_rad

Offset = Annotated[float, Meta(ge=-5.0, le=5.0)]


class Mount(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Pose of a lidar on the robot, frame of REP 103."""

    x_m: Offset = 0.0
    """Ahead of the robot's centre."""
    y_m: Offset = 0.0
    """To the left of it."""
    yaw_rad: Annotated[float, Meta(ge=-math.tau, le=math.tau)] = 0.0
    """Where its front looks, counter-clockwise from the robot's."""
    upside_down: bool = False
    """Mounted with its top down: it then turns the other way round."""
    hidden_within_m: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.0
    """Points nearer than this to the robot's centre are parts of the robot itself, and are left out."""


Placed = tuple[Pose2D, Sequence[Point]]
"""Points in the sensor's frame, and a pose of the robot."""


class ScanMaker:
    """Sorts the points of a turn into beams of equal angles, as their number differs from turn to turn.

    The nearest point of a beam counts, at its own angle.

    Args:
        beams: of a scan, all around; the first looks back (−π).
        range_max_m: points beyond it are none.
        mount: how the lidar is mounted.

    """

    def __init__(self, beams: int, range_max_m: float, mount: Mount) -> None:
        self._beams, self._range_max_m, self._mount = beams, range_max_m, mount
        step_rad = math.tau / beams
        self._angles_rad = tuple([-math.pi + step_rad * beam for beam in range(beams)])
        self._is_central = mount.x_m == 0.0 == mount.y_m

    def scan(self, seen: Iterable[Placed], before: Iterable[Placed], stamp_ns: int) -> LaserScan:
        """A turn as a scan; beams of which nothing is known are not in it.

        Args:
            seen: points of the turn, in the sensor's frame, with where the robot was when they were measured, in its
                frame at the time of the scan.
            before: those of the turn before, for beams that this one has no points of: a robot that turns against
                its lidar leaves a gap of some degrees.
            stamp_ns: robot's time of the scan.

        """
        far_m, beams = self._range_max_m, self._beams
        nearest_m: list[float] = [math.inf] * beams
        angles_rad = list(self._angles_rad)
        self._fill(nearest_m, angles_rad, seen)
        if math.inf in nearest_m:
            older_m, older_rad = [math.inf] * beams, list(self._angles_rad)
            self._fill(older_m, older_rad, before)
            for beam, range_m in enumerate(nearest_m):
                if range_m == math.inf:
                    nearest_m[beam], angles_rad[beam] = older_m[beam], older_rad[beam]
        known = [beam for beam, range_m in enumerate(nearest_m) if range_m < math.inf]
        angles = tuple([angles_rad[beam] for beam in known])
        return LaserScan(stamp_ns, angles, tuple([nearest_m[beam] for beam in known]), far_m)

    def _fill(self, nearest_m: list[float], angles_rad: list[float], seen: Iterable[Placed]) -> None:
        """Put the nearest point of each beam, and its direction, into the lists."""
        far_m, beams = self._range_max_m, self._beams
        for pose, points in seen:
            for direction_rad, range_m in self._around_robot(pose, points):
                beam = math.floor((direction_rad + math.pi) / math.tau * beams + 0.5) % beams
                if (range_m or far_m) < nearest_m[beam]:
                    middle_rad = self._angles_rad[beam]
                    nearest_m[beam] = range_m or far_m
                    angles_rad[beam] = middle_rad + wrap_angle_rad(direction_rad - middle_rad)  # they stay in order

    def _around_robot(self, pose: Pose2D, points: Sequence[Point]) -> Iterator[tuple[float, float]]:
        """Direction and range of points from the robot's centre at the time of the scan; range 0: nothing came back."""
        mount, far_m = self._mount, self._range_max_m
        sign = -1.0 if mount.upside_down else 1.0
        is_moved = not (self._is_central and pose.x_m == 0.0 == pose.y_m)
        for angle_rad, range_m in points:
            direction_rad = mount.yaw_rad + sign * angle_rad
            if not 0.0 < range_m < far_m:
                yield direction_rad + pose.yaw_rad, 0.0
                continue
            if not is_moved:
                if range_m >= mount.hidden_within_m:
                    yield direction_rad + pose.yaw_rad, range_m
                continue
            x_m = mount.x_m + range_m * math.cos(direction_rad)
            y_m = mount.y_m + range_m * math.sin(direction_rad)
            if math.hypot(x_m, y_m) < mount.hidden_within_m:
                continue
            cos, sin = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
            x_m, y_m = pose.x_m + cos * x_m - sin * y_m, pose.y_m + sin * x_m + cos * y_m
            yield math.atan2(y_m, x_m), math.hypot(x_m, y_m)
