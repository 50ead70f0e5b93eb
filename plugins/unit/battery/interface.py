"""What the battery unit offers."""

from typing import Protocol

import msgspec

from robrain.agent.event import Event
from robrain.algorithms.energy.consumption import Drawn
from robrain.protocol.messages.robots.robot_messages import BatteryState


class BatteryAlarm(msgspec.Struct, frozen=True):
    """Something about the battery that others should know."""

    why: str
    soc: float
    remaining_j: float
    voltage_v: float


class BatteryInterface(Protocol):
    """How much is left, and what is drawn."""

    low: Event[BatteryAlarm]
    cut_off: Event[BatteryAlarm]
    """The battery is at its end, or has cut the motors off."""
    implausible: Event[BatteryAlarm]
    """The measurements are not believed any more."""

    def state(self) -> BatteryState | None:
        """The battery as it is believed to be; None before the first measurement."""

    def drawn(self) -> Drawn | None:
        """Energy drawn so far, as of the last measurement; None before the first."""
