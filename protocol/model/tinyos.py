"""TinyOS active messages as they pass between a mote's base station and its host, and the reading that ours carry.

A packet is the serial format of TinyOS 2: a dispatch byte, then destination, source, payload length, group, AM type
and the payload, all big-endian (TEP 113, Serial Communication; TEP 111, message_t). Framing and CRC of the serial
line belong to the serial forwarder, which has taken them off.
"""

import struct

import msgspec

AM_DISPATCH = 0x00
"""The packet is a serial active message."""
BROADCAST = 0xFFFF
DEFAULT_GROUP = 0x22
MAX_PAYLOAD_BYTES = 28
"""TinyOS' own TOSH_DATA_LENGTH."""
READING_TYPE = 0x52

_HEADER = struct.Struct(">BHHBBB")
_READING = struct.Struct(">HHHhhhb")


class BadPacket(ValueError):
    """Bytes that are no packet, or values that no packet holds; its text is one sentence for a person."""


class ActiveMessage(msgspec.Struct, frozen=True, kw_only=True):
    """One packet; `type` says what the payload is."""

    type: int
    payload: bytes
    source: int
    destination: int = BROADCAST
    group: int = DEFAULT_GROUP

    def pack(self) -> bytes:
        """The packet's bytes.

        Raises:
            BadPacket: the payload is longer than 28 bytes, or an address, group or type is out of range.

        """
        if len(self.payload) > MAX_PAYLOAD_BYTES:
            raise BadPacket(f"expected a payload of at most {MAX_PAYLOAD_BYTES} bytes, got {len(self.payload)}")
        length = len(self.payload)
        try:
            header = _HEADER.pack(AM_DISPATCH, self.destination, self.source, length, self.group, self.type)
        except struct.error as error:
            raise BadPacket(f"expected addresses of 16 bits, group and type of 8, got {self}: {error}") from error
        return header + self.payload

    @classmethod
    def unpack(cls, packet: bytes) -> "ActiveMessage":
        """The packet in these bytes.

        Raises:
            BadPacket: they are too few or too many, or do not start with the dispatch byte of active messages.

        """
        if len(packet) < _HEADER.size:
            raise BadPacket(f"expected a packet of at least {_HEADER.size} bytes, got {len(packet)}")
        dispatch, destination, source, length, group, kind = _HEADER.unpack_from(packet)
        if dispatch != AM_DISPATCH:
            raise BadPacket(f"expected dispatch byte {AM_DISPATCH:#04x} (active message), got {dispatch:#04x}")
        if length > MAX_PAYLOAD_BYTES:
            raise BadPacket(f"expected a payload of at most {MAX_PAYLOAD_BYTES} bytes, got length {length}")
        payload = packet[_HEADER.size :]
        if len(payload) != length:
            raise BadPacket(f"expected {length} bytes of payload as the header says, got {len(payload)}")
        return cls(type=kind, payload=payload, source=source, destination=destination, group=group)


class ReadingPayload(msgspec.Struct, frozen=True, kw_only=True):
    """Payload of AM type 0x52: what a mote senses, and how well the base station heard it."""

    mote: int
    """The mote's number."""
    sequence: int
    """Counts the mote's readings, wrapping at 65536."""
    voltage_mv: int
    reading_centi: int
    """Temperature, 0.01 °C."""
    x_dm: int
    """Where the mote was put, 0.1 m, arena frame."""
    y_dm: int
    rssi_dbm: int = 0
    """Written by the base station that heard the packet, as in TinyOS' RssiDemo; 0 on the air."""

    def pack(self) -> bytes:
        """The payload's 13 bytes.

        Raises:
            BadPacket: a value does not fit its field.

        """
        try:
            return _READING.pack(
                self.mote,
                self.sequence,
                self.voltage_mv,
                self.reading_centi,
                self.x_dm,
                self.y_dm,
                self.rssi_dbm,
            )
        except struct.error as error:
            raise BadPacket(f"a value does not fit its field in {self}: {error}") from error

    @classmethod
    def unpack(cls, payload: bytes) -> "ReadingPayload":
        """The reading in a payload.

        Raises:
            BadPacket: it is not 13 bytes long.

        """
        if len(payload) != _READING.size:
            raise BadPacket(f"expected a reading of {_READING.size} bytes, got {len(payload)}")
        mote, sequence, voltage_mv, reading_centi, x_dm, y_dm, rssi_dbm = _READING.unpack(payload)
        return cls(
            mote=mote,
            sequence=sequence,
            voltage_mv=voltage_mv,
            reading_centi=reading_centi,
            x_dm=x_dm,
            y_dm=y_dm,
            rssi_dbm=rssi_dbm,
        )
