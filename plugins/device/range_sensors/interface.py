"""What the range sensors and the bump ring offer."""

from typing import Protocol

import msgspec

from robrain.agent.event import Event


class RangeRing(msgspec.Struct, frozen=True):
    """One measurement of all range sensors, robot's frame.

    A range is the distance from the hull, along its sensor's direction; `range_max_m` means that nothing was heard.
    """

    stamp_ns: int
    angles_rad: tuple[float, ...]
    ranges_m: tuple[float, ...]
    range_max_m: float
    mounted_m: float
    """Distance of the sensors from the robot's centre."""


class Bump(msgspec.Struct, frozen=True):
    """The hull has begun to be touched, or is not touched any more."""

    stamp_ns: int
    directions_rad: tuple[float, ...]
    """Where, robot's frame; none if nothing touches it."""


class RangeSensorsInterface(Protocol):
    """Ranges and bumps as they come."""

    measured: Event[RangeRing]
    bumped: Event[Bump]
    """Whenever the contacts that are pressed change."""

    def latest(self) -> RangeRing | None:
        """The last measurement; None before the first, as on a robot without the sensors."""

    def pressed_rad(self) -> tuple[float, ...]:
        """Directions of the contacts that are pressed now, robot's frame."""
