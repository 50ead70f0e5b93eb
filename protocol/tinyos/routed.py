"""A packet for a mote out of reach, with the way that it has to take: AM type 0x59, from base station to mote to mote.

The base station writes the whole route into the packet, as the root of an RPL network in non-storing mode does (RFC
6550, section 9; RFC 6554). It knows the route from the readings that came up: each names the first mote that passed it
on, which is the parent that a node of RPL reports in a DAO.
"""

import struct

import msgspec

from robrain.protocol.tinyos.packet import MAX_PAYLOAD_BYTES, BadPacket

ROUTED_TYPE = 0x59
INNER_MAX_BYTES = 6
"""The longest payload that is routed: a request."""
_HEAD = struct.Struct(">BBB")
ROUTE_MAX = (MAX_PAYLOAD_BYTES - _HEAD.size - INNER_MAX_BYTES) // 2
"""Motes that a route may name behind the one that the packet is addressed to."""
SERIALS = 256


class RoutedPayload(msgspec.Struct, frozen=True):
    """What a mote is to be told, and by which motes: 5 to 27 bytes.

    Layout: AM type u8, serial u8, number of motes u8, the motes u16 each, the payload of that AM type.
    """

    kind: int
    """AM type of what the last mote of the route is told."""
    serial: int
    """Counts a base station's routed packets, so that one which is repeated on a hop is passed on once."""
    route: tuple[int, ...]
    """Numbers of the motes that are still to come; the last one is told. Never empty."""
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
