"""Bump contacts, each on a GPIO line of its own: they take the place of the ring of range sensors."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.plugins.device.gpio.input_lines import DEBOUNCE_S_MAX, ChipPath, InputLines, LineName, Pull
from robrain.plugins.device.range_sensors.interface import Bump, RangeRing, RangeSensorsInterface
from robrain.protocol.model.ranges import check_finite, check_within

CONTACTS_MAX = 24


class BumperContact(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One contact."""

    line: LineName
    direction_rad: float
    """Where it is on the hull, robot's frame."""

    def __post_init__(self) -> None:
        check_finite(self, "direction_rad")


class GpioBumpers(Device):
    """Tells each change of the contacts. It measures no ranges."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """Contacts that close to ground when they are pressed, unless said otherwise."""

        chip: ChipPath = "/dev/gpiochip0"
        contacts: Annotated[tuple[BumperContact, ...], Meta(max_length=CONTACTS_MAX)] = ()
        is_pressed_low: bool = True
        """Whether a pressed contact makes its line low."""
        pull: Pull = Pull.UP
        debounce_s: float = 0.005

        def __post_init__(self) -> None:
            if not self.contacts:
                raise ValueError("expected at least one of contacts, such as { line = 17, direction_rad = 0.0 }")
            check_within(self, 0, DEBOUNCE_S_MAX, "debounce_s")

    interface = RangeSensorsInterface
    period_s = 0.02
    parameters: Parameters
    measured = Event[RangeRing]()
    bumped = Event[Bump](outside=True)

    def init(self) -> None:
        wanted = self.parameters
        self._lines = InputLines(
            wanted.chip,
            [contact.line for contact in wanted.contacts],
            wanted.pull,
            is_low_active=wanted.is_pressed_low,
            debounce_s=wanted.debounce_s,
            consumer="robrain bumpers",
        )
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
