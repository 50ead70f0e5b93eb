"""The protocol of LDROBOT's LD06 and LD19: packets of twelve points, 230,400 baud, nothing to be written.

Source: LDROBOT, *LD19 development manual*, V2.3: "Communication protocol". A packet has 47 bytes, all little-endian:

| bytes | content |
|---|---|
| 0 | 0x54 |
| 1 | 0x2C: version 1, twelve points |
| 2–3 | speed, °/s |
| 4–5 | angle of the first point, 0.01° |
| 6–41 | twelve times distance (mm, 2 bytes) and intensity (1 byte) |
| 42–43 | angle of the last point, 0.01° |
| 44–45 | time stamp, ms, up to 30,000 |
| 46 | CRC-8, polynomial 0x4D, of the bytes before |

Angles grow clockwise, seen from above.
"""

import math
import struct
from collections.abc import Sequence
from functools import cache

from robrain.protocol.serial.points import LineCounts, Piece, Point

HEADER = b"\x54\x2c"
POINTS = 12
_LAYOUT = struct.Struct("<2sHH" + POINTS * "HB" + "HHB")
PACKET_BYTES = _LAYOUT.size
FULL_CDEG = 36_000
"""A full turn in hundredths of a degree."""
STAMP_MODULUS = 30_000
SPAN_MAX_CDEG = 4_500
"""Twelve points span less than this at any speed; more is no packet."""


class Ld19Decoder:
    """See LidarDecoder; resynchronises on the next header with a right checksum."""

    def __init__(self) -> None:
        self.counts = LineCounts()
        self._left = b""
        self._last_cdeg: float | None = None

    def feed(self, data: bytes) -> list[Piece]:
        """As LidarDecoder."""
        pieces: list[Piece] = []
        data, begin = self._left + data, 0
        packets = bad = stray = 0
        while True:
            found = data.find(HEADER, begin)
            if found < 0:
                keep = 1 if data[-1:] == HEADER[:1] and len(data) > begin else 0
                stray += len(data) - keep - begin
                begin = len(data) - keep
                break
            stray += found - begin
            begin = found
            if len(data) - begin < PACKET_BYTES:
                break
            packet = data[begin : begin + PACKET_BYTES]
            if crc8(packet[:-1]) != packet[-1]:
                bad += 1
                stray += 1
                begin += 1  # a header among the data may have been meant
                continue
            begin += PACKET_BYTES
            packets += 1
            pieces += self._read_packet(packet)
        self._left = data[begin:]
        self.counts = self.counts.plus(packets, stray, bad)
        return pieces

    def ask_again(self) -> None:
        """As LidarDecoder: it measures by itself."""

    def to_write(self) -> bytes:
        """As LidarDecoder: nothing."""
        return b""

    def _read_packet(self, packet: bytes) -> list[Piece]:
        _, _speed_deg_s, first, *values, last, _stamp, _crc = _LAYOUT.unpack(packet)
        span = (last - first) % FULL_CDEG
        if first >= FULL_CDEG or last >= FULL_CDEG or span > SPAN_MAX_CDEG:
            return []
        pieces: list[Piece] = []
        points: list[Point] = []
        for number in range(POINTS):
            cdeg = (first + span * number / (POINTS - 1)) % FULL_CDEG
            if self._last_cdeg is not None and cdeg < self._last_cdeg - FULL_CDEG / 2:  # past the front
                pieces.append(Piece(points, True))
                points = []
            self._last_cdeg = cdeg
            points.append(Point(-math.radians(cdeg / 100.0), values[2 * number] / 1000.0))
        return [*pieces, Piece(points, False)]


def encode_ld19(first_deg: float, step_deg: float, ranges_m: Sequence[float], speed_deg_s: int, stamp_ms: int) -> bytes:
    """One packet, for the simulator.

    Args:
        first_deg: angle of the first point, clockwise from the front.
        step_deg: between two points.
        ranges_m: twelve of them; 0 if nothing came back.
        speed_deg_s: how fast the sensor turns.
        stamp_ms: time of the packet; wraps.

    """
    values: list[int] = []
    for range_m in ranges_m:
        values += (min(0xFFFF, round(1000 * range_m)), 200 if range_m else 0)
    first = round(100 * first_deg) % FULL_CDEG
    last = round(100 * (first_deg + (POINTS - 1) * step_deg)) % FULL_CDEG
    body = _LAYOUT.pack(HEADER, speed_deg_s, first, *values, last, stamp_ms % STAMP_MODULUS, 0)[:-1]
    return body + bytes((crc8(body),))


def crc8(data: bytes) -> int:
    """CRC-8 with the polynomial 0x4D, from 0.

    >>> hex(crc8(b"123456789"))
    '0xc3'
    """
    table, register = _table(), 0
    for byte in data:
        register = table[register ^ byte]
    return register


@cache
def _table() -> tuple[int, ...]:
    def shifted(register: int) -> int:
        for _ in range(8):
            register = ((register << 1) ^ 0x4D if register & 0x80 else register << 1) & 0xFF
        return register

    return tuple(map(shifted, range(256)))
