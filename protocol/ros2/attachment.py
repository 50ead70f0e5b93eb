"""Attachment of `rmw_zenoh` to messages, requests and responses: number, time and sender.

33 bytes: two little-endian int64, and 16 bytes of gid behind their length, as Zenoh's serializer writes an array.
"""

import struct

import msgspec

from robrain.protocol.ros2.errors import BadAttachment

GID_BYTES = 16
_FORMAT = struct.Struct(f"<qqB{GID_BYTES}s")


class Attachment(msgspec.Struct, frozen=True):
    """Sender, number and time of a message.

    >>> Attachment.unpack(Attachment(1, 2, bytes(range(16))).pack()).gid.hex()
    '000102030405060708090a0b0c0d0e0f'
    """

    number: int
    """Counts a publisher's messages or a client's requests from 1; a response carries that of its request."""
    stamp_ns: int
    """Sender's clock, since 1970."""
    gid: bytes
    """Of the publisher, or of the client in requests and responses."""

    def pack(self) -> bytes:
        """The attachment as it travels."""
        return _FORMAT.pack(self.number, self.stamp_ns, GID_BYTES, self.gid)

    @classmethod
    def unpack(cls, payload: bytes) -> "Attachment":
        """Read an attachment.

        Raises:
            BadAttachment: it has another length, or a negative number or stamp, which rmw_zenoh refuses too.

        """
        if len(payload) != _FORMAT.size:
            raise BadAttachment(f"expected an attachment of {_FORMAT.size} bytes, got {len(payload)}")
        number, stamp_ns, gid_bytes, gid = _FORMAT.unpack(payload)
        if gid_bytes != GID_BYTES:
            raise BadAttachment(f"expected a gid of {GID_BYTES} bytes, got {gid_bytes}")
        if number < 0 or stamp_ns < 0:
            raise BadAttachment(f"expected a number and a stamp from 0, got {number} and {stamp_ns}")
        return cls(number, stamp_ns, gid)
