"""TinyOS active messages as they pass between a mote's base station and its host.

A packet is the serial format of TinyOS 2. It has a dispatch byte, then destination, source, payload length, group, AM
type and the payload, all big-endian. The sources are TEP 113, Serial Communication, and `serial_header_t` in
tos/lib/serial/Serial.h of tinyos-main. The framing of packets on a line is in `serial_forwarder` for TCP and in
`serial_line` for a serial line.
"""

import struct

import msgspec

AM_DISPATCH = 0x00
"""TOS_SERIAL_ACTIVE_MESSAGE_ID: the packet is a serial active message."""
BROADCAST = 0xFFFF
"""TOS_BCAST_ADDR."""
DEFAULT_GROUP = 0x22
"""TinyOS' own TOS_AM_GROUP."""
MAX_PAYLOAD_BYTES = 28
"""TinyOS' own TOSH_DATA_LENGTH."""

_HEADER = struct.Struct(">BHHBBB")
MAX_PACKET_BYTES = _HEADER.size + MAX_PAYLOAD_BYTES


class BadPacket(ValueError):
    """Bytes that are no packet, or values that no packet holds; its text is one sentence for a person."""


class ActiveMessage(msgspec.Struct, frozen=True, kw_only=True):
    """One packet; `type` defines its payload."""

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
            raise BadPacket(f"expected the {length} bytes of payload in the header, got {len(payload)}")
        return cls(type=kind, payload=payload, source=source, destination=destination, group=group)
