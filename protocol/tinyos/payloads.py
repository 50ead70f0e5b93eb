"""Payloads of active messages between our motes and robots; big-endian, as nx_ types of nesC are.

| AM type | from → to | payload |
|---|---|---|
| 0x52 reading | mote → anybody | `ReadingPayload`, just sensed |
| 0x53 stored reading | mote → who asked | `ReadingPayload`, out of the mote's log |
| 0x54 request | robot → mote | `RequestPayload`: send what you have of these |
| 0x55 acknowledgement | robot → mote | `SequenceRange`: arrived, forget it |
| 0x56 duty | robot → mote | `DutyPayload`: sense that often; the next reading's period confirms it |
| 0x57 beacon | robot → anybody | `BeaconPayload`, so that base stations can tell how well they hear each other |
| 0x58 forwarded | mote → mote, anybody | `ForwardedPayload` (`forwarded`): a reading of another mote, passed on |
| 0x59 routed | robot → mote → mote | `RoutedPayload` (`routed`): one of the others, for a mote out of reach |

A mote listens for a moment after each packet that it sends, so robots speak when they are spoken to. Sequence numbers
count a mote's readings and wrap at 65536; which of two is the later is decided as in RFC 1982. Motes leave beacons
alone: a mote's program receives the AM types that it knows.
"""

import struct
from enum import IntEnum
from typing import ClassVar, Self

import msgspec

from robrain.protocol.tinyos.packet import MAX_PAYLOAD_BYTES, BadPacket

READING_TYPE = 0x52
STORED_TYPE = 0x53
REQUEST_TYPE = 0x54
ACKNOWLEDGE_TYPE = 0x55
DUTY_TYPE = 0x56

SEQUENCES = 1 << 16
CENTI = 100
DECI = 10
RSSI_MIN_DBM, RSSI_MAX_DBM = -128, 127
PERIOD_MIN_S, PERIOD_MAX_S = 0.1, 6553.5
REQUEST_SPAN = 32
"""Sequence numbers that one request can ask for."""
NO_PLACE = -0x8000
"""Both coordinates of a mote that does not know where it lies."""


BEACON_TYPE = 0x57
_ENDS = struct.Struct(">Hb")
MAX_NAME_BYTES = MAX_PAYLOAD_BYTES - _ENDS.size
"""A robot of a longer name cannot be received by its name."""


class Quantity(IntEnum):
    """Measured quantity, and the meaning of its hundredths."""

    TEMPERATURE = 1
    LIGHT = 2
    HUMIDITY = 3

    @property
    def wire_name(self) -> str:
        """The quantity with its unit, as `MoteReading` has it."""
        return _WIRE_NAMES[self]


_WIRE_NAMES = {Quantity.TEMPERATURE: "temperature_c", Quantity.LIGHT: "light_lx", Quantity.HUMIDITY: "humidity_pct"}


def sequences_after(sequence: int, other: int) -> int:
    """How many readings `sequence` comes after `other`, negative if before; across the wrap.

    >>> sequences_after(2, 65535)
    3
    """
    return (sequence - other + SEQUENCES // 2) % SEQUENCES - SEQUENCES // 2


class Payload(msgspec.Struct, frozen=True):
    """A payload whose fields, all numbers, have fixed places, in the order in which they are declared."""

    LAYOUT: ClassVar[struct.Struct]
    WHAT: ClassVar[str]
    """Names it in errors."""
    EXPECTED: ClassVar[str]
    """The values that fit its fields, for errors."""

    def pack(self) -> bytes:
        """The payload's bytes.

        Raises:
            BadPacket: a value does not fit its field.

        """
        try:
            return self.LAYOUT.pack(*msgspec.structs.astuple(self))
        except struct.error as error:
            raise BadPacket(f"expected {self.EXPECTED}, got {self}: {error}") from error

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """The values in a payload.

        Raises:
            BadPacket: it has another length.

        """
        if len(payload) != cls.LAYOUT.size:
            raise BadPacket(f"expected {cls.WHAT} of {cls.LAYOUT.size} bytes, got {len(payload)}")
        return cls(**dict(zip(cls.__struct_fields__, cls.LAYOUT.unpack(payload), strict=True)))


class ReadingPayload(Payload, frozen=True, kw_only=True):
    """A reading of a mote, and its signal strength at the base station: 24 bytes."""

    LAYOUT = struct.Struct(">HHHIHHBihhb")
    WHAT, EXPECTED = "a reading", "values that fit their fields"

    mote: int
    """The mote's number."""
    sequence: int
    """Counts the mote's readings, wrapping at 65536."""
    oldest: int
    """The oldest reading that the mote's log still holds, not yet acknowledged; `sequence` if there is no older one."""
    age_ds: int = 0
    """Tenths of a second since it was sensed, by the mote's clock."""
    period_ds: int
    """How often the mote senses now, tenths of a second."""
    voltage_mv: int
    quantity: int
    """One of `Quantity`; others are for newer motes."""
    value_centi: int
    """Hundredths of the quantity's unit."""
    x_dm: int
    """Where the mote was put, 0.1 m, arena frame; NO_PLACE in both if it does not know."""
    y_dm: int
    rssi_dbm: int = 0
    """Written by the base station that received the packet, as in TinyOS' RssiDemo; 0 on the air."""


def with_rssi(payload: bytes, rssi_dbm: float) -> bytes:
    """A reading's bytes with its received signal strength, which is its last byte."""
    whole_dbm = max(RSSI_MIN_DBM, min(RSSI_MAX_DBM, round(rssi_dbm)))
    return payload[:-1] + (whole_dbm & 0xFF).to_bytes()


class SequenceRange(Payload, frozen=True):
    """Readings from `first` to `last`, both included: payload of AM type 0x55, 4 bytes."""

    LAYOUT = struct.Struct(">HH")
    WHAT, EXPECTED = "a range of sequence numbers", "sequence numbers of 16 bits"

    first: int
    last: int

    def holds(self, sequence: int) -> bool:
        """Whether a reading is in the range, across the wrap.

        >>> SequenceRange(65534, 1).holds(0)
        True
        """
        return (sequence - self.first) % SEQUENCES <= (self.last - self.first) % SEQUENCES


class RequestPayload(Payload, frozen=True):
    """Readings of the range from `first` to 31 after it: payload of AM type 0x54, 6 bytes.

    The lost part of an answer can therefore be requested again in one packet.
    """

    LAYOUT = struct.Struct(">HI")
    WHAT, EXPECTED = "a request", "16 and 32 bits"
    first: int
    wanted: int
    """Bit i: whether `first` + i is wanted."""

    def sequences(self) -> list[int]:
        """The numbers that are wanted, across the wrap.

        >>> RequestPayload(65535, 0b101).sequences()
        [65535, 1]
        """
        return [(self.first + bit) % SEQUENCES for bit in range(REQUEST_SPAN) if self.wanted >> bit & 1]


class DutyPayload(Payload, frozen=True):
    """How often a mote is to sense: payload of AM type 0x56, 2 bytes."""

    LAYOUT = struct.Struct(">H")
    WHAT, EXPECTED = "a duty", "a period of 16 bits"
    period_ds: int

    @classmethod
    def of_seconds(cls, period_s: float) -> "DutyPayload":
        """The duty with this period, rounded to a tenth of a second.

        Raises:
            ValueError: the period is not between 0.1 and 6553.5 s.

        """
        if not PERIOD_MIN_S <= period_s <= PERIOD_MAX_S:
            raise ValueError(f"expected a period from {PERIOD_MIN_S} to {PERIOD_MAX_S} s, got {period_s}")
        return cls(round(DECI * period_s))

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Decode the duty in a payload.

        Raises:
            BadPacket: the payload is not 2 bytes long, or the period is 0.

        """
        duty = super().unpack(payload)
        if duty.period_ds == 0:
            raise BadPacket("expected a period above 0, got 0")
        return duty


class BeaconPayload(msgspec.Struct, frozen=True):
    """A robot's name, and its signal strength at the base station: a number of 16 bits, 1 to 25 bytes of name, dBm."""

    sequence: int
    """Counts the robot's beacons, wrapping at 65536."""
    robot: str
    rssi_dbm: int = 0
    """Written by the base station that received the packet; 0 on the air."""

    def pack(self) -> bytes:
        """The payload's bytes, 4 to 28.

        Raises:
            BadPacket: the name is empty or too long, or a number does not fit its field.

        """
        name = self.robot.encode()
        if not 1 <= len(name) <= MAX_NAME_BYTES:
            raise BadPacket(f"expected a robot's name of 1 to {MAX_NAME_BYTES} bytes, got {self.robot!r}")
        try:
            ends = _ENDS.pack(self.sequence, self.rssi_dbm)
        except struct.error as error:
            raise BadPacket(f"expected a sequence number of 16 bits and dBm of 8, got {self}: {error}") from error
        return ends[:2] + name + ends[2:]

    @classmethod
    def unpack(cls, payload: bytes) -> "BeaconPayload":
        """The beacon in a payload.

        Raises:
            BadPacket: it is too short or too long, or the name is no text.

        """
        if not _ENDS.size < len(payload) <= MAX_PAYLOAD_BYTES:
            raise BadPacket(f"expected a beacon of {_ENDS.size + 1} to {MAX_PAYLOAD_BYTES} bytes, got {len(payload)}")
        sequence, rssi_dbm = _ENDS.unpack(payload[:2] + payload[-1:])
        try:
            return cls(sequence % SEQUENCES, payload[2:-1].decode(), rssi_dbm)
        except UnicodeDecodeError as error:
            raise BadPacket(f"expected a name in UTF-8, got {payload[2:-1]!r}") from error


ROUTED_TYPE = 0x59
INNER_MAX_BYTES = 6
"""The longest payload that is routed: a request."""
_HEAD = struct.Struct(">BBB")
ROUTE_MAX = (MAX_PAYLOAD_BYTES - _HEAD.size - INNER_MAX_BYTES) // 2
"""Motes that a route may name behind the one that the packet is addressed to."""
SERIALS = 256


class RoutedPayload(msgspec.Struct, frozen=True):
    """A message to a mote, and the motes that forward it: 5 to 27 bytes.

    Layout: AM type u8, serial u8, number of motes u8, the motes u16 each, the payload of that AM type.
    """

    kind: int
    """AM type of the message to the last mote of the route."""
    serial: int
    """Counts a base station's routed packets, so that one which is repeated on a hop is passed on once."""
    route: tuple[int, ...]
    """Numbers of the remaining motes of the route; the last one is the destination. Never empty."""
    inner: bytes
    """The payload for it."""

    def pack(self) -> bytes:
        """The payload's bytes.

        Raises:
            BadPacket: a value does not fit its field, or the route or the payload is too long or empty.

        """
        if not 1 <= len(self.route) <= ROUTE_MAX or not 1 <= len(self.inner) <= INNER_MAX_BYTES:
            raise BadPacket(
                f"expected a route of 1 to {ROUTE_MAX} motes and a payload of 1 to {INNER_MAX_BYTES} bytes, got {self}"
            )
        try:
            head = _HEAD.pack(self.kind, self.serial, len(self.route))
            return head + struct.pack(f">{len(self.route)}H", *self.route) + self.inner
        except struct.error as error:
            raise BadPacket(f"expected motes of 16 bits, type and serial of 8, got {self}: {error}") from error

    @classmethod
    def unpack(cls, payload: bytes) -> "RoutedPayload":
        """The packet in a payload.

        Raises:
            BadPacket: its length is not that of its route and of a payload, or the route is empty or too long.

        """
        if len(payload) < _HEAD.size:
            raise BadPacket(f"expected a routed packet of at least {_HEAD.size} bytes, got {len(payload)}")
        kind, serial, count = _HEAD.unpack_from(payload)
        end = _HEAD.size + 2 * count
        if not 1 <= count <= ROUTE_MAX or not 1 <= len(payload) - end <= INNER_MAX_BYTES:
            raise BadPacket(
                f"expected a route of 1 to {ROUTE_MAX} motes and a payload of 1 to {INNER_MAX_BYTES} bytes behind it, "
                f"got {count} motes and {len(payload) - end} bytes"
            )
        route = struct.unpack(f">{count}H", payload[_HEAD.size : end])
        return cls(kind, serial, route, payload[end:])


FORWARDED_TYPE = 0x58
HOPS_MAX = 255
_ROUTE = struct.Struct(">HB")


class ForwardedPayload(msgspec.Struct, frozen=True):
    """A reading with its route: 27 bytes, the signal strength last, as in `ReadingPayload`."""

    reading: ReadingPayload
    """Its signal strength is that of the last packet, from the mote that passed it on last."""
    forwarder: int
    """Number of the first mote that passed it on."""
    hops: int
    """Number of motes that have passed it on."""

    def pack(self) -> bytes:
        """The payload's 27 bytes.

        Raises:
            BadPacket: a value does not fit its field.

        """
        reading = self.reading.pack()
        try:
            return reading[:-1] + _ROUTE.pack(self.forwarder, self.hops) + reading[-1:]
        except struct.error as error:
            raise BadPacket(f"expected a number of 16 bits and hops up to {HOPS_MAX}, got {self}: {error}") from error

    @classmethod
    def unpack(cls, payload: bytes) -> "ForwardedPayload":
        """The reading in a payload.

        Raises:
            BadPacket: it is not 27 bytes long.

        """
        middle, end = len(payload) - 1 - _ROUTE.size, len(payload) - 1
        if middle < 0:
            raise BadPacket(f"expected a reading that was passed on, of 27 bytes, got {len(payload)}")
        forwarder, hops = _ROUTE.unpack(payload[middle:end])
        return cls(ReadingPayload.unpack(payload[:middle] + payload[end:]), forwarder, hops)
