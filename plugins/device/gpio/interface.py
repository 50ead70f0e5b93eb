"""What a button for emergency stops offers."""

from typing import Protocol

import msgspec

from robrain.agent.event import Event


class ButtonChange(msgspec.Struct, frozen=True):
    """The button was pressed, or released."""

    stamp_ns: int
    why: str
    """Why the robot stops, in words; empty if nothing speaks against its driving any more."""


class EmergencyStopInterface(Protocol):
    """The button. Nothing needs to call it: pressed, it halts the robot by itself."""

    changed: Event[ButtonChange]

    def why_pressed(self) -> str:
        """Why the robot has to stand, in words; empty if the button is released."""
