"""How a motor controller is reached: commands down, wheel counts and status up, whatever the bus."""

from collections.abc import Sequence, Sized
from typing import Protocol

import msgspec

from robrain.plugins.device.mocdevice.errors import MotionFault
from robrain.plugins.device.mocdevice.interface import ControllerStatus, Counters


class WheelReport(msgspec.Struct, frozen=True):
    """Counts of all wheels at one time."""

    counts: tuple[int, ...]
    """One for each wheel; they wrap."""
    stamp_ns: int
    """Time stamp of the interface."""
    counter: int | None = None
    """The frame's 8-bit counter; None if it has none."""
    missing: int = 0
    """Reports lost before this one, by the counter."""


class WheelLink(Protocol):
    """A connection to a motor controller; its users' calls never fail, as the device's own step raises `broken`."""

    pending: Sized
    """Empty if `take` has nothing to take."""
    status: ControllerStatus | None
    """Last status of the controller; None before the first, or if it sends none."""
    statuses: int
    """Number of statuses received."""
    has_failed: bool
    """Whether the last status says that the power stage has failed."""
    broken: MotionFault | None
    """Why nothing can be sent or read any more; None if it can."""

    @property
    def refusal(self) -> str:
        """What has come since the last report and is none, and why; empty if nothing has come."""

    def command(self, values: Sequence[float]) -> None:
        """Send the base's commands."""

    def stop(self) -> None:
        """Stop the wheels at once."""

    def take(self) -> list[WheelReport]:
        """What has arrived since the last call."""

    def counters(self, believed: int, rejected: int) -> Counters:
        """What was seen on the bus; the device adds the reports that it believed and rejected."""

    def close(self) -> None:
        """Leave the bus."""
