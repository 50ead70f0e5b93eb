"""A lidar whose scans are those of a log."""

from collections import deque

from robrain.agent.event import Event
from robrain.agent.plugin import Device
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.plugins.device.scan.scan import ScanDevice


class LogScan(Device):
    """Stands in for the stock lidar; beams of which nothing is known have the range 0."""

    Parameters = ScanDevice.Parameters
    interface = ScanInterface
    period_s = 0.02
    scanned = Event[LaserScan]()

    def init(self) -> None:
        self._waiting: deque[LaserScan] = deque()
        self._latest: LaserScan | None = None

    def feed(self, scan: LaserScan) -> None:
        """Hand this on in the next step."""
        self._waiting.append(scan)

    def step(self) -> None:
        while self._waiting:
            self._latest = self._waiting.popleft()
            self.scanned.notify(self._latest)

    def latest(self) -> LaserScan | None:
        return self._latest

    def doubt(self, why: str) -> None:
        """What is in the log is what the lidar said."""
