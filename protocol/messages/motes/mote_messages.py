"""Readings and duties of sensor motes."""

from typing import Annotated, Self

import msgspec
from msgspec import UNSET, Meta, UnsetType

from robrain.protocol.messages.message import Message
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Count, Name, Quantity, Seconds, Stamp
from robrain.protocol.topic import Delivery, Role, Topic, Urgency


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
    """The robot or gateway that received it."""
    sequence: Count | None = None
    """Number of the reading, counted by the mote and wrapping at 65536: mote and number name a reading."""
    measured_ns: Stamp = 0
    """Time of the measurement, within the accuracy of the mote's clock; 0 if it is unknown."""
    period_s: Seconds = 0.0
    """How often the mote senses; 0 if that is not known."""
    stored: Count = 0
    """Readings before the mote's latest that it still stores, because they are not acknowledged."""
    hops: Count | UnsetType = UNSET
    """Number of motes that have passed it on; absent if none has."""
    forwarder: Name | UnsetType = UNSET
    """The first of them."""
    waiting: Count | UnsetType = UNSET
    """Readings that its gateway still stores; absent if it does not store any."""
    dropped: Count | UnsetType = UNSET
    """Readings that its gateway has had no room for."""

    def moved_in_time(self, by_ns: int) -> Self:
        """The reading with its times moved, from its sender's clock to the receiver's."""
        measured_ns = self.measured_ns and self.measured_ns + by_ns
        return msgspec.structs.replace(self, stamp_ns=self.stamp_ns + by_ns, measured_ns=measured_ns)


class MoteDuty(Message, frozen=True, kw_only=True):
    """How often a mote is to sense; any robot that meets it passes this on."""

    mote: Name
    period_s: Seconds
    by: Name = ""
    """Name of the requester."""


class ForwarderCount(msgspec.Struct, frozen=True, kw_only=True):
    """A mote that passes on readings of its neighbours."""

    mote: Name
    readings: Count
    """Readings that have arrived for which it was the first to pass them on."""


class GatewayCount(msgspec.Struct, frozen=True, kw_only=True):
    """A gateway between the field and the team's network."""

    name: Name
    readings: Count
    """Readings that have arrived by it."""
    waiting: Count
    """Readings in its store when it last reported one."""
    dropped: Count
    """Readings that it has had no room for."""
    last_seen_ns: Stamp
    """Time of its last report."""


class MoteFieldState(msgspec.Struct, frozen=True, kw_only=True):
    """State of all motes that the coordinator has ever received."""

    motes: Count
    """Number of motes."""
    dead: Count
    """Number of motes whose cells are empty, by their last reports."""
    delivery_ratio: Quantity
    """Share of the readings since each mote's first reading that have arrived; dead motes count as if they
    continued."""
    age_s: Quantity
    """Mean age of the newest reading of each living mote."""
    oldest_s: Quantity
    """Greatest of these ages."""
    coverage: Quantity
    """Share of the floor between the motes, within their sensing range, that a mote or a robot covers."""
    on_duty: Count
    """Number of living motes that are on duty."""
    first_dead_ns: Stamp | None = None
    """Time of the last reading of the first mote that died."""
    half_dead_ns: Stamp | None = None
    """The same of the mote with which half of them were dead."""
    last_dead_ns: Stamp | None = None
    """The same of the last mote, if all are dead."""
    forwarded: Count | UnsetType = UNSET
    """Readings that have arrived over other motes; absent, as the next two, if there are none."""
    hops: Quantity | UnsetType = UNSET
    """Mean number of motes that have passed such a reading on."""
    forwarders: Annotated[list[ForwarderCount], Meta(max_length=1000)] | UnsetType = UNSET
    """Motes that passed most of them on first, most readings first."""
    gateways: Annotated[list[GatewayCount], Meta(max_length=1000)] | UnsetType = UNSET
    """The gateways, by name; absent if there are none."""

    @property
    def words(self) -> str:
        """The state in one sentence, for people."""
        dead = f", {self.dead} dead" if self.dead else ""
        resting = self.motes - self.dead - self.on_duty
        rest = f", {resting} off duty" if resting > 0 else ""
        return (
            f"{self.motes} motes{dead}{rest}; {100 * self.delivery_ratio:.0f} % of the readings arrived, "
            f"newest {self.age_s:.0f} s old (oldest {self.oldest_s:.0f} s); {100 * self.coverage:.0f} % covered"
            f"{self._path_text}"
        )

    @property
    def _path_text(self) -> str:
        words = ""
        if self.forwarded and self.forwarders and self.hops:
            first = self.forwarders[0]
            words = f"; {self.forwarded} readings passed on, {self.hops:.1f} times each, most by {first.mote}"
        for gateway in self.gateways or ():
            dropped = f", has dropped {gateway.dropped}" if gateway.dropped else ""
            words += f"; gateway {gateway.name} stores {gateway.waiting}{dropped}"
        return words


MOTE_READING = Topic(
    "mote/{mote}/reading", "A reading that a robot or gateway received", MoteReading, delivery=Delivery.LOSSLESS,
    urgency=Urgency.DATA_LOW, recorded=True, max_bytes=16_384)  # fmt: skip
MOTE_DUTY = Topic(
    "mote/{mote}/duty", "Sampling interval of a mote; a robot that meets the mote sends it", MoteDuty,
    role=Role.COORDINATOR, delivery=Delivery.LOSSLESS, cache=1, recorded=True, max_bytes=4096)  # fmt: skip
