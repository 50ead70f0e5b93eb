"""The protocol of Slamtec's RPLIDAR A-series, standard scan mode.

Source: Slamtec, *RPLIDAR interface protocol and application notes*, V2.8. A request is 0xA5 and a command byte. The
answer to SCAN is the descriptor A5 5A 05 00 00 40 81, then a node of five bytes for each measurement:

| bytes | content |
|---|---|
| 0 | quality (6 bits), not S, S; S is 1 in the first node of a turn |
| 1–2 | angle × 64 (15 bits, °, clockwise), and a check bit that is 1 |
| 3–4 | distance × 4, mm; 0 if nothing came back |

There is no checksum. A node is valid if S differs from not S, the check bit is 1 and the angle is within a turn.
"""

import math
import struct
from collections.abc import Sequence

from robrain.protocol.serial.points import LineCounts, Piece, Point

"""Of the A1 and A2M8; the A2M12 and A3 have 256,000."""
STOP, SCAN = b"\xa5\x25", b"\xa5\x20"
MOTOR = bytes.fromhex("a5f0029402c1")
"""Turn the motor with a duty of 660 of 1023, as Slamtec's SDK does for A2 and A3. That of an A1 turns while DTR is not
set, and it knows no such request."""
DESCRIPTOR = bytes.fromhex("a55a0500004081")
NODE = struct.Struct("<BHH")
FULL_Q6 = 360 << 6
BELIEVED_NODES = 3
"""This number of valid nodes in a row is required before a stream is accepted after invalid bytes."""
STREAM_NODES = 12
"""The same without a descriptor at the beginning, as with a sensor that scans already."""


class RplidarDecoder:
    """See LidarDecoder. It asks for a scan, and again when nodes cease to look right."""

    def __init__(self) -> None:
        self.counts = LineCounts()
        self._left = b""
        self._is_scanning = False
        self._asks = STOP + MOTOR + SCAN

    def to_write(self) -> bytes:
        """As LidarDecoder: the request of a scan, once and after each loss of the stream."""
        asks, self._asks = self._asks, b""
        return asks

    def ask_again(self) -> None:
        """The sensor is silent: ask once more."""
        self._asks, self._is_scanning, self._left = STOP + MOTOR + SCAN, False, b""

    def feed(self, data: bytes) -> list[Piece]:
        """As LidarDecoder."""
        data, begin, stray, packets = self._left + data, 0, 0, 0
        pieces: list[Piece] = []
        points: list[Point] = []
        if not self._is_scanning:
            found = data.find(DESCRIPTOR)
            if found >= 0:
                stray, begin, self._is_scanning = found, found + len(DESCRIPTOR), True
            else:  # it may be scanning already, or the descriptor is incomplete
                begin, stray = _resynchronised(data, -1, STREAM_NODES)
                self._is_scanning = len(data) - begin >= STREAM_NODES * NODE.size
        while self._is_scanning and len(data) - begin >= NODE.size:
            if _is_node(data, begin):
                packets += 1
                first, angle, distance = NODE.unpack_from(data, begin)
                if first & 1:  # the first of a turn
                    pieces.append(Piece(points, True))
                    points = []
                points.append(Point(-math.radians((angle >> 1) / 64.0), distance / 4000.0))
                begin += NODE.size
                continue
            if len(data) - begin < BELIEVED_NODES * NODE.size + NODE.size:
                break
            begin, skipped = _resynchronised(data, begin, BELIEVED_NODES)
            stray += skipped
        self._left = data[begin:]
        self.counts = self.counts.plus(packets, stray)
        return [*pieces, Piece(points, False)] if points else pieces


def encode_rplidar(angles_deg: Sequence[float], ranges_m: Sequence[float]) -> bytes:
    """Nodes, for the simulator; angles clockwise from the front, the first of a turn is 0."""
    nodes = bytearray()
    for angle, range_m in zip(angles_deg, ranges_m, strict=True):
        quality = 47 if range_m else 0
        first = quality << 2 | (1 if angle == 0.0 else 2)
        nodes += NODE.pack(first, (round(angle * 64) % FULL_Q6) << 1 | 1, min(0xFFFF, round(4000 * range_m)))
    return bytes(nodes)


def _is_node(data: bytes, at: int) -> bool:
    first, angle, _ = NODE.unpack_from(data, at)
    return bool((first & 1) ^ (first >> 1 & 1) and angle & 1 and angle >> 1 < FULL_Q6)


def _resynchronised(data: bytes, begin: int, nodes: int) -> tuple[int, int]:
    """Position after `begin` where this number of nodes in a row is or may be valid; and the bytes skipped."""
    last, first = len(data) - nodes * NODE.size, begin + 1
    for at in range(first, last + 1):
        if all(_is_node(data, at + number * NODE.size) for number in range(nodes)):
            return at, at - max(0, begin)
    at = max(first, last + 1)
    return at, at - max(0, begin)
