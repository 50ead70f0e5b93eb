"""Interface of the sensor network's Unit for others in the robot."""

from typing import Protocol

import msgspec

from robrain.agent.event import Event
from robrain.protocol.model.geometry import Point2D


class ReceivedMote(msgspec.Struct, frozen=True, kw_only=True):
    """A mote as this robot has heard it so far."""

    mote: str
    """Its name on the wire, `m` and its number on the air."""
    place: Point2D | None
    """Where it says that it lies, arena frame; None if it does not know."""
    rssi_dbm: float
    """Strength of the last packet heard."""
    mean_rssi_dbm: float
    """Mean over all packets heard; biased towards strong ones where weak ones are lost."""
    stamp_ns: int
    """When it was last heard."""
    heard_from: Point2D | None
    """Where the robot was then, arena frame; None if it did not know."""
    readings: int
    """Readings taken in, each sequence number once."""
    missing: int
    """Readings that the mote is known to have made and this robot has neither got nor seen another robot bring in."""
    period_s: float
    """How often the mote says that it senses; 0 while not known."""
    voltage_v: float
    last_value: float


class RssiMeasurement(msgspec.Struct, frozen=True, kw_only=True):
    """One packet of a mote was heard: what a robot can tell its distance from."""

    mote: str
    place: Point2D | None
    """Where the mote says that it lies, arena frame."""
    rssi_dbm: float
    stamp_ns: int
    """When the packet was heard."""


class ReceivedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """Another robot's base station as this one's has heard it so far."""

    robot: str
    rssi_dbm: float
    """Strength of the last beacon heard."""
    mean_rssi_dbm: float
    """Mean over all beacons heard; biased towards strong ones where weak ones are lost."""
    stamp_ns: int
    """When it was last heard."""
    packets: int
    missed: int
    """Beacons that were said between those heard, by their numbers."""


class SnwInterface(Protocol):
    """Motes and base stations in reach: who was heard, what motes sensed, and asking them for more."""

    measured: Event[RssiMeasurement]

    def heard(self) -> list[ReceivedMote]: ...

    def robots(self) -> list[ReceivedRobot]: ...

    def request_stored(self, mote: str) -> None: ...

    def set_duty(self, mote: str, period_s: float) -> None: ...
