"""Common part of all lidar devices: the last turn, silence, and implausible turns.

A silent lidar is a fault of this device. So is a lidar that a user doubts, as the driver does when the ranges stay
equal while the robot moves. Both faults are reported to the team. A doubted turn is not passed on again, even after a
restart, so that no map is made of it.
"""

import logging
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.agent.errors import PluginError
from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.agent.silence import FirstWord, Silence
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.model.geometry import Pose2D, wrap_angle_rad
from robrain.protocol.serial.points import Point

logger = logging.getLogger(__name__)


Offset = Annotated[float, Meta(ge=-5.0, le=5.0)]


class Mount(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Pose of a lidar on the robot, frame of REP 103."""

    x_m: Offset = 0.0
    """Ahead of the robot's centre."""
    y_m: Offset = 0.0
    """To the left of it."""
    yaw_rad: Annotated[float, Meta(ge=-math.tau, le=math.tau)] = 0.0
    """Direction of its front, counter-clockwise from the robot's."""
    upside_down: bool = False
    """Mounted with its top down: it then turns in reverse."""
    hidden_within_m: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.0
    """Points nearer than this to the robot's centre are parts of the robot itself, and are omitted."""


Placed = tuple[Pose2D, Sequence[Point]]
"""Points in the sensor's frame, and a pose of the robot."""


class ScanMaker:
    """Sorts the points of a turn into beams of equal angles, as their number differs from turn to turn.

    The nearest point of a beam counts, at its own angle.

    Args:
        beams: of a scan, all around; the first points back (−π).
        range_max_m: points beyond it are none.
        mount: how the lidar is mounted.

    """

    def __init__(self, beams: int, range_max_m: float, mount: Mount) -> None:
        self._beams, self._range_max_m, self._mount = beams, range_max_m, mount
        step_rad = math.tau / beams
        self._angles_rad = tuple([-math.pi + step_rad * beam for beam in range(beams)])
        self._is_central = mount.x_m == 0.0 == mount.y_m

    def scan(self, seen: Iterable[Placed], before: Iterable[Placed], stamp_ns: int) -> LaserScan:
        """A turn as a scan; it omits beams without points.

        Args:
            seen: points of the turn, in the sensor's frame, with the robot's place at their measurement. This place is
                in the robot's frame at the time of the scan.
            before: points of the turn before, for beams without points in this one. A robot that turns against its
                lidar leaves a gap of some degrees.
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
        """Write the nearest point of each beam, and its direction, into the lists."""
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


class LidarFault(PluginError):
    """The lidar is silent or unplugged, or its data cannot be true."""


class LidarDevice(Device):
    """Passes on each turn of a lidar; subclasses read the turns in `read_turns`.

    Their parameter `silent_s` is the time without a turn after which the lidar faults.
    """

    interface = ScanInterface
    scanned = Event[LaserScan]()
    trouble = Event[str](outside=True)
    """Reason why the lidar is at fault, before the device faults."""

    def init(self) -> None:
        self._latest: LaserScan | None = None
        self._ranges_mm: list[int] = []
        self._doubt = ""

    def activate(self) -> None:
        self._silence = Silence(to_ns(self.parameters.silent_s))
        self._received_ns = self.env.clock.now_ns()
        self._first = FirstWord(self._received_ns)
        self.begin()

    def begin(self) -> None:
        """Open the line to the lidar."""
        raise NotImplementedError

    def read_turns(self, now_ns: int) -> None:
        """Call `record` with each turn that has arrived."""
        raise NotImplementedError

    def record(self, scan: LaserScan, ranges_mm: list[int], now_ns: int) -> None:
        """Pass on a turn, unless it was doubted.

        Args:
            scan: the turn.
            ranges_mm: its ranges, to recognise it again.
            now_ns: the time.

        """
        board = self.env.board
        if ranges_mm == board.doubted_scan:
            return
        board.doubted_scan = None
        board.has_scanned = True
        self._received_ns = now_ns
        self._ranges_mm = ranges_mm
        self._latest = scan
        self.scanned.notify(scan)

    def step(self) -> None:
        board, now_ns = self.env.board, self.env.clock.now_ns()
        self.read_turns(now_ns)
        if self._doubt:
            board.doubted_scan = self._ranges_mm
            self.fail(self._doubt)
        if not board.has_scanned:
            if self._first.is_missing(now_ns):
                logger.warning("%s: the lidar has sent no turn yet%s", self.env.robot, self.where())
            return
        if now_ns - self._received_ns <= self._silence.begins_ns:
            return
        silent_ns = self._silence.since(self._received_ns, now_ns)
        if silent_ns >= self._silence.limit_ns:
            silent_s = silent_ns / NS_PER_S
            what = "no turn" if board.doubted_scan is None else "nothing but the turn that it froze in"
            self.fail(f"the lidar has sent {what} for {silent_s:.1f} s{self.where()}")

    def where(self) -> str:
        """Description of a silent lidar after a colon; empty if there is none."""
        return ""

    def latest(self) -> LaserScan | None:
        """The last scan; None before the first."""
        return self._latest

    def doubt(self, reason: str) -> None:
        """Report that the last scan cannot be true: the device faults, and passes no such turn on again."""
        self._doubt = reason

    @external
    def nearest_m(self) -> float | None:
        """Distance to the nearest object in sight; null if there is none, and before the first scan."""
        if self._latest is None:
            return None
        nearest_m = min(self._latest.beam_ranges_m, default=math.inf)
        return nearest_m if nearest_m < self._latest.range_max_m else None

    def fail(self, reason: str) -> None:
        """Report to the team, and fault."""
        self.trouble.notify(reason)
        raise LidarFault(self.env.plugin, reason)
