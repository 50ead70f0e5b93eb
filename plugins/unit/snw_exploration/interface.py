"""Interface of the sensor network's Unit for others in the robot."""

from typing import Protocol

import msgspec

from robrain.agent.event import Event
from robrain.protocol.model.geometry import Point2D


class ReceivedMote(msgspec.Struct, frozen=True, kw_only=True):
    """A mote by the packets that this robot has received."""

    mote: str
    """Its name on the wire, `m` and its number on the air."""
    place: Point2D | None
    """Its reported place, arena frame; None if it does not know."""
    rssi_dbm: float
    """Strength of the last received packet."""
    mean_rssi_dbm: float
    """Mean over all received packets; biased towards strong ones where weak ones are lost."""
    stamp_ns: int
    """Time of the last reception."""
    received_at: Point2D | None
    """Place of the robot then, arena frame; None if unknown."""
    readings: int
    """Readings taken in, each sequence number once."""
    missing: int
    """Readings that the mote is known to have made and neither this robot nor, to its knowledge, another has received.
    """
    period_s: float
    """Reported sensing period of the mote; 0 while unknown."""
    voltage_v: float
    last_value: float


class RssiMeasurement(msgspec.Struct, frozen=True, kw_only=True):
    """One received packet of a mote: a measure of its distance."""

    mote: str
    place: Point2D | None
    """Reported place of the mote, arena frame."""
    rssi_dbm: float
    stamp_ns: int
    """Time of the reception."""


class ReceivedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """Another robot's base station by the beacons that this one has received."""

    robot: str
    rssi_dbm: float
    """Strength of the last received beacon."""
    mean_rssi_dbm: float
    """Mean over all received beacons; biased towards strong ones where weak ones are lost."""
    stamp_ns: int
    """Time of the last reception."""
    packets: int
    missed: int
    """Beacons that were sent between the received ones, by their numbers."""


class SnwInterface(Protocol):
    """Motes and base stations in reach: the received ones, the motes' readings, and requests for more."""

    measured: Event[RssiMeasurement]

    def motes(self) -> list[ReceivedMote]: ...

    def robots(self) -> list[ReceivedRobot]: ...

    def request_stored(self, mote: str) -> None: ...

    def set_duty(self, mote: str, period_s: float) -> None: ...
