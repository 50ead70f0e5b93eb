"""Contacts on the lines of a GPIO chip, by libgpiod: bumpers, and the emergency stop's button."""

import threading
from collections.abc import Sequence
from contextlib import suppress
from datetime import timedelta
from typing import Annotated, Literal, Protocol

import gpiod
import msgspec
from gpiod.line import Bias, Direction, Value
from msgspec import Meta

from robrain.agent.event import Event
from robrain.agent.plugin import Device, external, unlocked
from robrain.plugins.device.range_sensors import Bump, RangeRing, RangeSensorsInterface
from robrain.protocol.model.checked import Checked

LineName = Annotated[int, Meta(ge=0, le=1023)] | Annotated[str, Meta(min_length=1, max_length=64)]
"""Offset of a line in its chip, or its name, such as `GPIO17`."""
ChipPath = Annotated[str, Meta(min_length=1, max_length=4096)]
DEBOUNCE_S_MAX = 0.1


Pull = Literal["up", "down", "none"]
"""The chip's resistor, which decides the level of an open line; `none`: a resistor on the board does."""
_BIASES = {"up": Bias.PULL_UP, "down": Bias.PULL_DOWN, "none": Bias.DISABLED}


class GpioAbsent(OSError):
    """Lines that cannot be opened or read. A fault like others: the plugin is started again later."""


class GpioParameters(Checked, frozen=True, forbid_unknown_fields=True):
    """A chip, and how its lines are read."""

    chip: ChipPath = "/dev/gpiochip0"
    """Path of its device file."""
    debounce_s: Annotated[float, Meta(ge=0, le=DEBOUNCE_S_MAX)] = 0.005
    """Changes that last less are not seen; 0 for all."""


class InputLines:
    """Some lines of one chip; may be used on any thread.

    Args:
        wanted: the chip, and how its lines are read.
        consumer: name of their user, as `gpioinfo` shows it.
        lines: which, in the order of `read`.
        pull: the resistor on all of them.
        is_low: whether `read` is true for a low level.

    """

    def __init__(
        self, wanted: GpioParameters, consumer: str, lines: Sequence[int | str], pull: Pull, *, is_low: bool
    ) -> None:
        self._chip, self._lines, self._consumer = wanted.chip, tuple(lines), consumer
        self._settings = gpiod.LineSettings(
            direction=Direction.INPUT,
            bias=_BIASES[pull],
            active_low=is_low,
            debounce_period=timedelta(seconds=wanted.debounce_s),
        )
        self._request: gpiod.LineRequest | None = None
        self._using = threading.RLock()

    @property
    def where(self) -> str:
        """Such as `lines 17, 27 of /dev/gpiochip0`."""
        return f"line{'s' if len(self._lines) > 1 else ''} {', '.join(map(str, self._lines))} of {self._chip}"

    def open(self) -> None:
        """Request the lines (GpioAbsent, naming them: there are none, or another program uses them)."""
        with self._using:
            try:
                self._request = gpiod.request_lines(self._chip, {self._lines: self._settings}, consumer=self._consumer)
            except (OSError, ValueError) as error:  # ValueError: the chip has no line of that name
                raise GpioAbsent(f"cannot open {self.where}: {error}") from error

    def read(self) -> list[bool]:
        """Which lines are active (GpioAbsent, naming them); lines that are not open are opened for that."""
        with self._using:
            if self._request is None:
                self.open()
                try:
                    return self.read()
                finally:
                    self.close()
            try:
                return [value is Value.ACTIVE for value in self._request.get_values()]
            except (OSError, gpiod.RequestReleasedError) as error:
                raise GpioAbsent(f"cannot read {self.where}: {error}") from error

    def close(self) -> None:
        """Release the lines."""
        with self._using:
            request, self._request = self._request, None
            if request is not None:
                with suppress(OSError):  # the chip has gone, and its lines with it
                    request.release()


CONTACTS_MAX = 24


class BumperContact(Checked, frozen=True, forbid_unknown_fields=True):
    """One contact."""

    line: LineName
    direction_rad: float
    """Direction of its place on the hull, robot's frame."""


class GpioBumpers(Device):
    """Reports each change of the contacts.

    It measures no ranges.
    """

    class Parameters(GpioParameters, frozen=True, forbid_unknown_fields=True):
        """Contacts that close to ground when they are pressed, unless configured otherwise."""

        contacts: Annotated[tuple[BumperContact, ...], Meta(min_length=1, max_length=CONTACTS_MAX)] = ()
        is_pressed_low: bool = True
        """Whether a pressed contact makes its line low."""
        pull: Pull = "up"

    interface = RangeSensorsInterface
    period_s = 0.02
    parameters: Parameters
    measured = Event[RangeRing]()
    bumped = Event[Bump](outside=True)

    def init(self) -> None:
        wanted, lines = self.parameters, [contact.line for contact in self.parameters.contacts]
        self._lines = InputLines(wanted, "robrain bumpers", lines, wanted.pull, is_low=wanted.is_pressed_low)
        self._pressed_rad: tuple[float, ...] = ()

    def activate(self) -> None:
        self._lines.open()

    def step(self) -> None:
        closed = self._lines.read()
        contacts = self.parameters.contacts
        pressed_rad = tuple(contact.direction_rad for contact, is_on in zip(contacts, closed, strict=True) if is_on)
        if pressed_rad != self._pressed_rad:
            self._pressed_rad = pressed_rad
            self.bumped.notify(Bump(self.env.clock.now_ns(), pressed_rad))

    def deactivate(self) -> None:
        self._lines.close()

    @external
    def latest(self) -> RangeRing | None:
        """Null: there are no range sensors."""
        return None

    @external
    def pressed_rad(self) -> tuple[float, ...]:
        """Directions of the contacts that are pressed now, robot's frame."""
        return self._pressed_rad


class ButtonChange(msgspec.Struct, frozen=True):
    """The button was pressed, or released."""

    stamp_ns: int
    why: str
    """Reason why the robot stops, in words; empty if it may drive again."""


class EmergencyStopInterface(Protocol):
    """The button.

    No plugin needs to call it: a press halts the robot by itself.
    """

    changed: Event[ButtonChange]

    def pressed_reason(self) -> str:
        """Reason why the robot has to stand, in words; empty if the button is released."""


LINES_MAX = 4


class GpioEmergencyStop(Device):
    """Halts the robot while its button is pressed, its cable broken or its line lost."""

    class Parameters(GpioParameters, frozen=True, forbid_unknown_fields=True):
        """Contacts that are closed unless the button is pressed."""

        lines: Annotated[tuple[LineName, ...], Meta(min_length=1, max_length=LINES_MAX)] = ()
        """One for each contact of the button; any that is open halts the robot."""
        wired_to: Literal["ground", "supply"] = "ground"
        """The potential to which a closed contact connects its line."""
        own_pull: bool = True
        """Whether the chip's resistor pulls an open line to the other level; false if the board has resistors."""

    interface = EmergencyStopInterface
    period_s = 0.01
    parameters: Parameters
    changed = Event[ButtonChange](outside=True)

    def init(self) -> None:
        wanted, is_grounded = self.parameters, self.parameters.wired_to == "ground"
        pull: Pull = ("up" if is_grounded else "down") if wanted.own_pull else "none"
        self._lines = InputLines(wanted, "robrain emergency stop", wanted.lines, pull, is_low=not is_grounded)
        self._reason = ""

    def activate(self) -> None:
        self.env.guard_resume(self.pressed_reason)
        try:
            self._lines.open()
            self._check()
        except GpioAbsent as error:
            self.env.halt_robot(str(error))
            raise

    def step(self) -> None:
        try:
            self._check()
        except GpioAbsent as error:
            self._report(str(error))
            raise

    def deactivate(self) -> None:
        self._lines.close()

    @external
    @unlocked
    def pressed_reason(self) -> str:
        """Reason why the robot has to stand, in words; empty if the button is released.

        May be asked on any thread, also while the device does not run. Lines that cannot be read are a reason as well.
        """
        try:
            return self._press()
        except GpioAbsent as error:
            return f"the emergency stop does not answer: {error}"

    def _press(self) -> str:
        """Reason why the robot has to stand; empty if all contacts are closed (GpioAbsent if they are unreadable)."""
        if not any(self._lines.read()):
            return ""
        return f"the emergency stop is pressed, or its cable is broken: {self._lines.where}"

    def _check(self) -> None:
        reason = self._press()
        # It steps, so the robot is not halted: the button was released and pressed again between two steps.
        if reason or self._reason:
            self._report(reason)

    def _report(self, reason: str) -> None:
        self._reason = reason
        self.changed.notify(ButtonChange(self.env.clock.now_ns(), reason))
        if reason:
            self.env.halt_robot(reason)
