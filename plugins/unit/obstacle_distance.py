"""Obstacle distance: the nearest obstacle in each direction, by lidar and range sensors together.

It is computed on request, so that it costs nothing otherwise. Sensors that are not fresh are omitted and not named in
the answer. The robot's own motion since the measurement (some centimetres) is not made up for.
"""

import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import TYPE_CHECKING, Protocol

import msgspec

from robrain.agent.plugin import Unit, external
from robrain.algorithms.navigation.obstacles import (
    Passage,
    contact_distance_m,
    has_arrays,
    hold_off,
    joined,
    passage,
    points_of,
    sector_distances_m,
)
from robrain.plugins.device.mocdevice.interface import MocDeviceInterface
from robrain.plugins.device.range_sensors import Bump, RangeRing, RangeSensorsInterface
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Pose2D, wrap_angle_rad
from robrain.protocol.model.ranges import Positive

if TYPE_CHECKING:
    from robrain.algorithms.navigation.obstacles import Points


SCAN_FRESH_NS = to_ns(0.6)
"""Three turns of a lidar at 5 Hz."""
RING_FRESH_NS = to_ns(0.3)
FROZEN_M, FROZEN_RAD = 0.08, 0.08
"""Motion after which a robot cannot see the very same ranges, to the millimetre."""
BUMPED_RAD = math.radians(80.0)
"""The robot does not drive within this angle of a touched direction."""
SQUEEZED_GAP_M = 0.03
"""In a narrow place the robot's edge keeps this distance from obstacles ahead."""


def scan_points_m(scan: LaserScan, seen_from: Pose2D) -> "Points":
    """Points that a scan has hit (2, N), in the frame of its pose."""
    x_m, y_m, yaw_rad = seen_from.x_m, seen_from.y_m, seen_from.yaw_rad
    if not has_arrays():
        hits = [
            (range_m, yaw_rad + angle_rad)
            for angle_rad, range_m in zip(scan.beam_angles_rad, scan.beam_ranges_m, strict=True)
            if range_m < scan.range_max_m
        ]
        xs_m = [x_m + range_m * math.cos(angle_rad) for range_m, angle_rad in hits]
        return xs_m, [y_m + range_m * math.sin(angle_rad) for range_m, angle_rad in hits]
    import numpy as np

    hit = scan.ranges_m < scan.range_max_m
    angles_rad, ranges_m = scan.angles_rad[hit] + yaw_rad, scan.ranges_m[hit]
    return np.stack((x_m + ranges_m * np.cos(angles_rad), y_m + ranges_m * np.sin(angles_rad)))


def ring_points_m(ring: RangeRing, before: RangeRing | None, seen_from: Pose2D) -> "Points":
    """Echoes of the range sensors (2, N), on their axes, in the frame of the pose of the measurement.

    `before` is the measurement before: an echo that is missing once does not free the path.
    """
    xs_m: list[float] = []
    ys_m: list[float] = []
    for sensor, (angle_rad, range_m) in enumerate(zip(ring.angles_rad, ring.ranges_m, strict=True)):
        nearest_m = range_m
        if before is not None and nearest_m >= ring.range_max_m:
            nearest_m = before.ranges_m[sensor]
        if nearest_m < ring.range_max_m:
            direction_rad = seen_from.yaw_rad + angle_rad
            reach_m = ring.mounted_m + nearest_m
            xs_m.append(seen_from.x_m + reach_m * math.cos(direction_rad))
            ys_m.append(seen_from.y_m + reach_m * math.sin(direction_rad))
    return points_of(xs_m, ys_m)


class LidarMonitor:
    """Detects a frozen lidar: its ranges stay equal to the millimetre while the robot moves."""

    def __init__(self) -> None:
        self._ranges_m: Sequence[float] = ()
        self._before: Pose2D | None = None
        self._moved_m = self._turned_rad = 0.0
        """Since the first scan with these ranges."""

    def is_frozen(self, scan: LaserScan, seen_from: Pose2D) -> bool:
        """Check the next scan, with the robot's odometry pose at it."""
        before, self._before = self._before, seen_from
        ranges_m = scan.beam_ranges_m
        has_hit = min(ranges_m, default=math.inf) < scan.range_max_m  # out of sight of everything all scans are equal
        if before is None or not has_hit or ranges_m != self._ranges_m:
            self._ranges_m = ranges_m
            self._moved_m = self._turned_rad = 0.0
            return False
        self._moved_m += before.distance_m(seen_from)
        self._turned_rad += abs(wrap_angle_rad(seen_from.yaw_rad - before.yaw_rad))
        return self._moved_m > FROZEN_M or self._turned_rad > FROZEN_RAD


class ObstaclePoints:
    """The points of the last scan and the last ring, in the frame odom, kept up to date.

    Args:
        pose_at: T_odom_robot at a time within the last second.

    """

    def __init__(self, pose_at: Callable[[int], Pose2D]) -> None:
        self.points_m = points_of([], [])
        """(2, N), frame odom."""
        self.scan_m = points_of([], [])
        """Points seen by the lidar; (2, N), frame odom."""
        self.ring_m = points_of([], [])
        """Echoes of the range sensors, each on its sensor's axis; (2, N), frame odom."""
        self.is_frozen = False
        """Whether the lidar is frozen, by the last scan."""
        self._pose_at = pose_at
        self._watch = LidarMonitor()
        self._scan_ns = self._ring_ns = -1
        self._before: RangeRing | None = None

    def update(self, scan: LaserScan | None, ring: RangeRing | None, now_ns: int) -> str:
        """Read new data; returns the reason why the robot is blind, empty if it sees."""
        has_changed = False
        if scan is not None and scan.stamp_ns != self._scan_ns:
            self._scan_ns = scan.stamp_ns
            seen_from = self._pose_at(scan.stamp_ns)
            self.scan_m = scan_points_m(scan, seen_from)
            self.is_frozen = self._watch.is_frozen(scan, seen_from)
            has_changed = True
        if ring is not None and ring.stamp_ns != self._ring_ns:
            self._ring_ns = ring.stamp_ns
            self.ring_m = ring_points_m(ring, self._before, self._pose_at(ring.stamp_ns))
            self._before = ring
            has_changed = True
        elif len(self.ring_m[0]) and now_ns - self._ring_ns > RING_FRESH_NS:
            self.ring_m, self._before = points_of([], []), None
            has_changed = True
        if has_changed:
            self.points_m = joined(self.scan_m, self.ring_m) if len(self.ring_m[0]) else self.scan_m
        if self.is_frozen:
            return "the lidar has been frozen"
        if scan is None or now_ns - scan.stamp_ns > SCAN_FRESH_NS:
            return "there has been no fresh scan"
        if not len(scan.beam_ranges_m):
            return "the lidar is covered: its scan has no beam"
        return ""


class Lookout:
    """Keeps the latest sensor data and answers how far a direction is free.

    Args:
        moc: gives the robot's pose at a measurement, and its size.
        scan: the lidar; informed if it is frozen.
        ranges: the range sensors and bump contacts.
        stop_distance_m: distance that the robot's edge keeps from obstacles ahead.

    """

    def __init__(
        self, moc: MocDeviceInterface, scan: ScanInterface, ranges: RangeSensorsInterface, stop_distance_m: float
    ) -> None:
        self._scan = scan
        self._ranges = ranges
        self._obstacles = ObstaclePoints(moc.pose_at)
        self._touched_rad = ranges.pressed_rad()
        # Points that the swept disc, a little wider than the robot, would touch.
        self._reach_m = moc.radius_m() + 0.25 * stop_distance_m
        self._gap_m = 0.75 * stop_distance_m
        self._radius_m = moc.radius_m()

    def feel(self, bump: Bump) -> None:
        """Handle a change of the bump contacts."""
        self._touched_rad = bump.directions_rad

    def check(self, now_ns: int) -> str:
        """Read the sensors; returns the reason why the robot is blind, empty if it is not."""
        blind_reason = self._obstacles.update(self._scan.latest(), self._ranges.latest(), now_ns)
        if self._obstacles.is_frozen:
            self._scan.doubt("the lidar is frozen: its ranges stay equal to the millimetre while the robot moves")
        return blind_reason

    def free_m(self, pose: Pose2D, heading_rad: float) -> float:
        """Free straight path in this direction of odom, less the stop distance before an obstacle."""
        if self._touched_rad and self._is_touched(pose, heading_rad):
            return 0.0
        points_m = self._obstacles.points_m
        return contact_distance_m(points_m, pose.x_m, pose.y_m, heading_rad, self._reach_m) - self._gap_m

    def passage(self, pose: Pose2D, heading_rad: float) -> Passage:
        """The room for squeezing straight ahead through a narrow place, by the lidar.

        Range sensors give no direction within their cone, so they count only for obstacles straight ahead.
        """
        found = passage(self._obstacles.scan_m, pose.x_m, pose.y_m, heading_rad, self._radius_m)
        free_m = min(found.free_m, self._reach_of_lookout_m(pose, heading_rad)) - SQUEEZED_GAP_M
        return found._replace(free_m=0.0 if self._is_touched(pose, heading_rad) else free_m)

    def hold_off(
        self, pose: Pose2D, velocity_m_s: tuple[float, float], keep_m: float, per_s: float
    ) -> tuple[float, float]:
        """The velocity (x, y), frame odom, less its part towards lidar points within `keep_m` of the hull."""
        x_m_s, y_m_s = velocity_m_s
        if math.hypot(x_m_s, y_m_s) > 0.0 and self._is_touched(pose, math.atan2(y_m_s, x_m_s)):
            return 0.0, 0.0
        return hold_off(self._obstacles.scan_m, pose.x_m, pose.y_m, x_m_s, y_m_s, self._radius_m, keep_m, per_s)

    def _is_touched(self, pose: Pose2D, heading_rad: float) -> bool:
        return any(
            abs(wrap_angle_rad(pose.yaw_rad + touched_rad - heading_rad)) < BUMPED_RAD
            for touched_rad in self._touched_rad
        )

    def _reach_of_lookout_m(self, pose: Pose2D, heading_rad: float) -> float:
        reach_m = 0.5 * self._radius_m
        contact_m = contact_distance_m(self._obstacles.ring_m, pose.x_m, pose.y_m, heading_rad, reach_m)
        return contact_m - (self._radius_m - reach_m)


class ObstacleField(msgspec.Struct, frozen=True, kw_only=True):
    """The nearest obstacle in each direction, from the robot's hull.

    Sector 0 is centred on straight ahead, the others follow counter-clockwise. A distance is in metres; null means that
    nothing is seen there. Without any fresh sensor there is no distance at all, and `sees` is empty.
    """

    distances_m: list[float | None]
    sees: list[str]
    """The sensors that are fresh and in it: `scan`, `range_sensors`."""
    nearest_m: float | None = None
    nearest_rad: float | None = None
    """Middle of the sector of the nearest, robot's frame."""
    touched_rad: list[float] = []
    """Where a bump contact is pressed, robot's frame."""


class ObstacleDistanceInterface(Protocol):
    """Distances on request."""

    def view(self, sectors: int = 12) -> ObstacleField:
        """The nearest obstacle in each of this many sectors, by sensors with recent data."""


SECTORS_MAX = 360
HERE = Pose2D(0.0, 0.0, 0.0)


class ObstacleDistance(Unit):
    """Finds the nearest obstacle in each direction."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """The robot's hull."""

        radius_m: Positive = 0.20

    interface = ObstacleDistanceInterface
    parameters: Parameters

    def activate(self) -> None:
        self._scan = self.env.use("scan", ScanInterface)
        self._ranges = self.env.use("range_sensors", RangeSensorsInterface)

    @external
    def view(self, sectors: int = 12) -> ObstacleField:
        """The nearest obstacle in each of this many sectors, by sensors with recent data."""
        if not 1 <= sectors <= SECTORS_MAX:
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"view: expected 1 to {SECTORS_MAX} sectors, got {sectors}")
        now_ns = self.env.clock.now_ns()
        scan, ring = self._scan.latest(), self._ranges.latest()
        seen, sees = [], []
        if scan is not None and now_ns - scan.stamp_ns <= SCAN_FRESH_NS:
            seen.append(scan_points_m(scan, HERE))
            sees.append("scan")
        if ring is not None and now_ns - ring.stamp_ns <= RING_FRESH_NS:
            seen.append(ring_points_m(ring, None, HERE))
            sees.append("range_sensors")
        nearest_m = sector_distances_m(reduce(joined, seen), 0.0, 0.0, 0.0, sectors) if seen else [math.inf] * sectors
        distances_m = [
            round(max(0.0, distance_m - self.parameters.radius_m), 3) if math.isfinite(distance_m) else None
            for distance_m in nearest_m
        ]
        found = [(distance_m, sector) for sector, distance_m in enumerate(distances_m) if distance_m is not None]
        closest_m, sector = min(found, default=(None, 0))
        return ObstacleField(
            distances_m=distances_m,
            sees=sees,
            nearest_m=closest_m,
            nearest_rad=None if closest_m is None else math.remainder(math.tau * sector / sectors, math.tau),
            touched_rad=list(self._ranges.pressed_rad()),
        )
