"""A button that halts its robot: normally closed contacts, so that a broken cable halts it as well.

Pressed, it halts this robot as an operator's halt does. The robot drives again when the button is released and an
operator has resumed it. This is no safety function in the sense of ISO 13850: a button for that cuts the motors' power.
"""

import threading
from typing import Annotated, Literal, Protocol

import msgspec
from msgspec import Meta

from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.plugins.device.gpio.input_lines import DEBOUNCE_S_MAX, ChipPath, GpioAbsent, InputLines, LineName, Pull
from robrain.protocol.model.ranges import check_within


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


CONTACTS_MAX = 4


class StopButton:
    """The contacts of one button. May be asked on any thread, also while the device does not run.

    Args:
        lines: true for each contact that is open.

    """

    def __init__(self, lines: InputLines) -> None:
        self._lines = lines
        self._using = threading.Lock()

    def open(self) -> None:
        """Keep the lines open (GpioAbsent if that fails)."""
        with self._using:
            self._lines.open()

    def close(self) -> None:
        """Give them back."""
        with self._using:
            self._lines.close()

    def read(self) -> str:
        """Why the robot has to stand, in words; empty if all contacts are closed (GpioAbsent if not to be read)."""
        with self._using:
            was_open = self._lines.is_open
            if not was_open:
                self._lines.open()
            try:
                is_open = any(self._lines.read())
            finally:
                if not was_open:
                    self._lines.close()
        return f"the emergency stop is pressed, or its cable is broken: {self._lines.where}" if is_open else ""

    def why_not_resume(self) -> str:
        """As `read`; lines that cannot be read are a reason as well."""
        try:
            return self.read()
        except GpioAbsent as error:
            return f"the emergency stop does not answer: {error}"


class GpioEmergencyStop(Device):
    """Halts the robot while its button is pressed, its cable broken or its line lost."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """Contacts that are closed unless the button is pressed."""

        chip: ChipPath = "/dev/gpiochip0"
        lines: Annotated[tuple[LineName, ...], Meta(max_length=CONTACTS_MAX)] = ()
        """One for each contact of the button; any that is open halts the robot."""
        wired_to: Literal["ground", "supply"] = "ground"
        """What a closed contact connects its line to."""
        own_pull: bool = True
        """Whether the chip's resistor pulls an open line the other way; false if the board has resistors."""
        debounce_s: float = 0.005

        def __post_init__(self) -> None:
            if not self.lines:
                raise ValueError("expected at least one of lines, such as 17")
            check_within(self, 0, DEBOUNCE_S_MAX, "debounce_s")

    interface = EmergencyStopInterface
    period_s = 0.01
    parameters: Parameters
    changed = Event[ButtonChange](outside=True)

    def init(self) -> None:
        wanted, is_grounded = self.parameters, self.parameters.wired_to == "ground"
        lines = InputLines(
            wanted.chip,
            wanted.lines,
            (Pull.UP if is_grounded else Pull.DOWN) if wanted.own_pull else Pull.NONE,
            is_low_active=not is_grounded,
            debounce_s=wanted.debounce_s,
            consumer="robrain emergency stop",
        )
        self._button = StopButton(lines)
        self._why = ""

    def activate(self) -> None:
        self.env.guard_resume(self._button.why_not_resume)
        try:
            self._button.open()
            self._look()
        except GpioAbsent as error:
            self.env.halt_robot(str(error))
            raise

    def step(self) -> None:
        try:
            self._look()
        except GpioAbsent as error:
            self._tell(str(error))
            raise

    def deactivate(self) -> None:
        self._button.close()

    @external
    def why_pressed(self) -> str:
        """Why the robot has to stand, in words; empty if the button is released."""
        return self._button.why_not_resume()

    def _look(self) -> None:
        why = self._button.read()
        # It steps, so the robot is not halted: the button was released and pressed again between two steps.
        if why or self._why:
            self._tell(why)

    def _tell(self, why: str) -> None:
        self._why = why
        self.changed.notify(ButtonChange(self.env.clock.now_ns(), why))
        if why:
            self.env.halt_robot(why)
