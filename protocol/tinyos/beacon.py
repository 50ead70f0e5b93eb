"""Beacons: what a robot's base station says so that other base stations can tell how well they hear it.

| AM type | from → to | payload |
|---|---|---|
| 0x57 beacon | robot → anybody | `BeaconPayload` |

Motes leave beacons alone: a mote's program takes in the AM types that it knows.
"""

import struct

import msgspec

from robrain.protocol.tinyos.packet import MAX_PAYLOAD_BYTES, BadPacket
from robrain.protocol.tinyos.payloads import SEQUENCES

BEACON_TYPE = 0x57
_ENDS = struct.Struct(">Hb")
MAX_NAME_BYTES = MAX_PAYLOAD_BYTES - _ENDS.size
"""A robot of a longer name cannot be heard by its name."""


class BeaconPayload(msgspec.Struct, frozen=True):
    """A robot's name, and how well the base station heard it: a number of 16 bits, 1 to 25 bytes of name, dBm."""

    sequence: int
    """Counts the robot's beacons, wrapping at 65536."""
    robot: str
    rssi_dbm: int = 0
    """Written by the base station that heard the packet; 0 on the air."""

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
