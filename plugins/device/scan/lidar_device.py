"""What all lidar devices have in common: the last turn, silence, and turns that cannot be true.

A lidar that falls silent is a fault of this device, and so is one that a user doubts, as the driver does when the
ranges stay equal while the robot moves. Both are told to the team. A turn that was doubted is not handed on again, also
after a restart, so that no map is made of it.
"""

import logging
import math
from typing import Protocol

from robrain.agent.errors import PluginError
from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.agent.silence import FirstWord, Silence
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.protocol.clock import NS_PER_S, to_ns

logger = logging.getLogger(__name__)


class LidarFault(PluginError):
    """The lidar is silent or unplugged, or what it says cannot be true."""


class HasSilence(Protocol):
    """Parameters of a lidar."""

    @property
    def silent_s(self) -> float:
        """Time without a turn after which the lidar faults."""


class LidarDevice(Device):
    """Hands on each turn of a lidar; subclasses take the turns in with `read_turns`."""

    interface = ScanInterface
    parameters: HasSilence
    scanned = Event[LaserScan]()
    trouble = Event[str](outside=True)
    """Why the lidar is at fault, before the device faults."""

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
        """Call `note` with each turn that has arrived."""
        raise NotImplementedError

    def note(self, scan: LaserScan, ranges_mm: list[int], now_ns: int) -> None:
        """Hand on a turn, unless it is one that was doubted.

        Args:
            scan: the turn.
            ranges_mm: its ranges, to know it again.
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
        """What is missing when the lidar is silent, with a colon before it; nothing if that is all to be said."""
        return ""

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

    def fail(self, why: str) -> None:
        """Tell the team, and fault."""
        self.trouble.notify(why)
        raise LidarFault(self.env.plugin, why)
