"""Lidar whose scans come over the wire."""

import numpy as np
from numpy.typing import NDArray

from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages import Scan
from robrain.protocol.wire.topics import ARENA_SCAN

MM_PER_M = 1000.0


class ScanDevice(Device):
    """Hands on each turn of the lidar."""

    interface = ScanInterface
    period_s = 0.02
    scanned = Event[LaserScan]()

    def init(self) -> None:
        self._inbox = Inbox()
        self._latest: LaserScan | None = None
        self._angles_rad: NDArray[np.float64] = np.empty(0)
        self._fan: tuple[int, float, float] | None = None

    def activate(self) -> None:
        self.env.wire.subscribe(self._inbox, ARENA_SCAN, robot=self.env.robot)

    def step(self) -> None:
        for received in self._inbox.drain():
            self._latest = self._convert(received.message)
            self.scanned.notify(self._latest)

    def latest(self) -> LaserScan | None:
        """The last scan; None before the first."""
        return self._latest

    @external
    def nearest_m(self) -> float | None:
        """Distance to the nearest thing in sight; null if there is none, and before the first scan."""
        if self._latest is None:
            return None
        nearest_m = float(self._latest.ranges_m.min(initial=self._latest.range_max_m))
        return nearest_m if nearest_m < self._latest.range_max_m else None

    def _convert(self, scan: Scan) -> LaserScan:
        fan = (len(scan.ranges_mm), scan.angle_min_rad, scan.angle_increment_rad)
        if fan != self._fan:
            self._fan = fan
            self._angles_rad = scan.angle_min_rad + scan.angle_increment_rad * np.arange(
                len(scan.ranges_mm), dtype=np.float64
            )
        ranges_m = np.array(scan.ranges_mm, dtype=np.float64) / MM_PER_M
        ranges_m[ranges_m == 0.0] = scan.range_max_m
        return LaserScan(scan.stamp_ns, self._angles_rad, ranges_m, scan.range_max_m)
