"""Lidar whose scans come over the wire.

A lidar that falls silent is a fault of this device, and so is one that a user doubts, as the driver does when the
ranges stay equal while the robot moves. Both are told to the team. A turn that was doubted is not handed on again, also
after a restart, so that no map is made of it.
"""

import math

import msgspec

from robrain.agent.errors import PluginError
from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.agent.silence import Silence
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.protocol.model.ranges import check_positive
from robrain.protocol.wire.clock import NS_PER_S, to_ns
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.team.arena_messages import Scan
from robrain.protocol.wire.topics import ARENA_SCAN

MM_PER_M = 1000.0


class LidarFault(PluginError):
    """The lidar is silent, or what it says cannot be true."""


class ScanDevice(Device):
    """Passes on each turn of the lidar."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """When a lidar counts as gone."""

        silent_s: float = 3.0
        """Time without a turn after which the lidar faults; the stock lidar turns five times a second."""

        def __post_init__(self) -> None:
            check_positive(self, "silent_s")

    interface = ScanInterface
    period_s = 0.2  # and as soon as a turn arrives
    parameters: Parameters
    scanned = Event[LaserScan]()
    trouble = Event[str](outside=True)
    """Why the lidar is at fault, before the device faults."""

    def init(self) -> None:
        self._inbox = Inbox()
        self._latest: LaserScan | None = None
        self._ranges_mm: list[int] = []
        self._doubt = ""
        self._angles_rad: tuple[float, ...] = ()
        self._fan: tuple[int, float, float] | None = None

    def activate(self) -> None:
        self._silence = Silence(to_ns(self.parameters.silent_s))
        self._heard_ns = self.env.clock.now_ns()
        self.env.wire.subscribe(self._inbox, ARENA_SCAN, robot=self.env.robot)
        self.env.wake_on(self._inbox)

    def step(self) -> None:
        board, now_ns = self.env.board, self.env.clock.now_ns()
        for received in self._inbox.drain():
            scan: Scan = received.message
            if scan.ranges_mm == board.doubted_scan:
                continue
            board.doubted_scan = None
            board.has_scanned = True
            self._heard_ns = now_ns
            self._ranges_mm = scan.ranges_mm
            self._latest = self._convert(scan)
            self.scanned.notify(self._latest)
        if self._doubt:
            board.doubted_scan = self._ranges_mm
            self._fail(self._doubt)
        if not board.has_scanned or now_ns - self._heard_ns <= self._silence.begins_ns:
            return
        silent_ns = self._silence.since(self._heard_ns, now_ns)
        if silent_ns >= self._silence.limit_ns:
            silent_s = silent_ns / NS_PER_S
            what = "no turn" if board.doubted_scan is None else "nothing but the turn that it froze in"
            self._fail(f"the lidar has sent {what} for {silent_s:.1f} s")

    def latest(self) -> LaserScan | None:
        """The last scan; None before the first."""
        return self._latest

    def doubt(self, why: str) -> None:
        """Say that the last scan cannot be true: the device faults, and hands no such turn on again."""
        self._doubt = why

    @external
    def nearest_m(self) -> float | None:
        """Distance to the nearest object in sight; null if there is none, and before the first scan."""
        if self._latest is None:
            return None
        nearest_m = min(self._latest.beam_ranges_m, default=math.inf)
        return nearest_m if nearest_m < self._latest.range_max_m else None

    def _fail(self, why: str) -> None:
        self.trouble.notify(why)
        raise LidarFault(self.env.plugin, why)

    def _convert(self, scan: Scan) -> LaserScan:
        fan = (len(scan.ranges_mm), scan.angle_min_rad, scan.angle_increment_rad)
        if fan != self._fan:
            self._fan = fan
            first_rad, step_rad = scan.angle_min_rad, scan.angle_increment_rad
            self._angles_rad = tuple(first_rad + step_rad * beam for beam in range(len(scan.ranges_mm)))
        far_m = scan.range_max_m
        ranges_m = tuple([mm / MM_PER_M if mm else far_m for mm in scan.ranges_mm])
        return LaserScan(scan.stamp_ns, self._angles_rad, ranges_m, scan.range_max_m)
