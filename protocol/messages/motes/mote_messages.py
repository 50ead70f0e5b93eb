"""Readings and duties of sensor motes."""

from typing import Self

import msgspec
from msgspec import UNSET, UnsetType

from robrain.protocol.messages.message import Message
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Count, Name, Quantity, Seconds, Stamp


class MoteReading(Message, frozen=True, kw_only=True):
    """A mote's reading, brought in by a robot or a gateway."""

    mote: Name
    place: Point2D | None
    quantity: Name
    value: Quantity
    """The measured value, in the unit of the quantity."""
    voltage_v: Quantity
    rssi_dbm: Quantity
    """Strength of the packet at the receiver."""
    via: Name
    """The robot or gateway that heard it."""
    sequence: Count | None = None
    """Number of the reading, counted by the mote and wrapping at 65536: mote and number name a reading."""
    taken_ns: Stamp = 0
    """When it was sensed, as well as the mote's clock can tell; 0 if that is not known."""
    period_s: Seconds = 0.0
    """How often the mote senses; 0 if that is not known."""
    stored: Count = 0
    """Readings before the mote's latest that it still keeps, because nobody has acknowledged them."""
    hops: Count | UnsetType = UNSET
    """Number of motes that have passed it on; absent if none has."""
    forwarder: Name | UnsetType = UNSET
    """The first of them."""
    waiting: Count | UnsetType = UNSET
    """Readings that its gateway still stores; absent if it does not store any."""
    dropped: Count | UnsetType = UNSET
    """Readings that its gateway had no room for so far."""

    def moved_in_time(self, by_ns: int) -> Self:
        """The reading with its times moved, from its sender's clock to the receiver's."""
        taken_ns = self.taken_ns and self.taken_ns + by_ns
        return msgspec.structs.replace(self, stamp_ns=self.stamp_ns + by_ns, taken_ns=taken_ns)


class MoteDuty(Message, frozen=True, kw_only=True):
    """How often a mote is to sense; any robot that meets it passes this on."""

    mote: Name
    period_s: Seconds
    by: Name = ""
    """Who requested it."""
