"""A reading that motes have passed on: AM type 0x58, from mote to mote and to base stations."""

import struct

import msgspec

from robrain.protocol.tinyos.packet import BadPacket
from robrain.protocol.tinyos.payloads import ReadingPayload

FORWARDED_TYPE = 0x58
HOPS_MAX = 255
_WAY = struct.Struct(">HB")


class ForwardedPayload(msgspec.Struct, frozen=True):
    """A reading with the way that it has come: 27 bytes, the signal strength last, as in `ReadingPayload`."""

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
            return reading[:-1] + _WAY.pack(self.forwarder, self.hops) + reading[-1:]
        except struct.error as error:
            raise BadPacket(f"expected a number of 16 bits and hops up to {HOPS_MAX}, got {self}: {error}") from error

    @classmethod
    def unpack(cls, payload: bytes) -> "ForwardedPayload":
        """The reading in a payload.

        Raises:
            BadPacket: it is not 27 bytes long.

        """
        middle, end = len(payload) - 1 - _WAY.size, len(payload) - 1
        if middle < 0:
            raise BadPacket(f"expected a reading that was passed on, of 27 bytes, got {len(payload)}")
        forwarder, hops = _WAY.unpack(payload[middle:end])
        return cls(ReadingPayload.unpack(payload[:middle] + payload[end:]), forwarder, hops)
