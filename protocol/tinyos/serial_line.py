"""Packets on a TinyOS serial line: acknowledged ones, their acknowledgements, and those that need none.

A frame's body starts with a protocol byte. The numbers are those of `SERIAL_PROTO_*` in tos/lib/serial/Serial.h of
tinyos-main (older TinyOS had 64 to 66, as TEP 113 prints). The host sends acknowledged packets, one at a time, each
with a sequence number. The mote sends packets without acknowledgement and number (TEP 113 section 3.3;
tos/lib/serial/SerialP.nc). Nothing here reads or writes, so that it can be tested byte by byte.

A frame is HDLC's: 0x7e, the body, the CRC with its low byte first, 0x7e. Between the flags 0x7e and 0x7d are sent as
0x7d and the byte xor 0x20. The CRC has polynomial 0x1021, starts at 0 and covers the whole body. The sources are TEP
113, sections 3.2 and 3.6; tos/lib/serial/SerialP.nc, whose CRC includes the protocol byte too; RFC 1662.
"""

import binascii
from collections import deque
from enum import IntEnum

import msgspec

NUMBERS = 256

FLAG = 0x7E
ESCAPE = 0x7D
FLIP = 0x20
MAX_BODY_BYTES = 254
"""The MTU of TinyOS' own tools is 256 bytes, CRC included."""
CRC_BYTES = 2
MIN_BODY_BYTES = 2
"""An acknowledgement: protocol byte and sequence number."""
_FLAG_BYTE = bytes([FLAG])
_ESCAPE_BYTE = bytes([ESCAPE])
_ESCAPED_FLAG = bytes([ESCAPE, FLAG ^ FLIP])
_ESCAPED_ESCAPE = bytes([ESCAPE, ESCAPE ^ FLIP])
_MAX_ESCAPED_BYTES = 2 * (MAX_BODY_BYTES + CRC_BYTES)


def crc16(data: bytes) -> int:
    """The CRC of TinyOS' serial line, also known as CRC-16/XMODEM.

    >>> hex(crc16(b"123456789"))
    '0x31c3'
    """
    return binascii.crc_hqx(data, 0)


def frame(body: bytes) -> bytes:
    """A body as it goes over the line (ValueError if it is shorter than 2 bytes or longer than 254)."""
    if not MIN_BODY_BYTES <= len(body) <= MAX_BODY_BYTES:
        raise ValueError(f"expected a body of {MIN_BODY_BYTES} to {MAX_BODY_BYTES} bytes, got {len(body)}")
    whole = body + crc16(body).to_bytes(CRC_BYTES, "little")
    escaped = whole.replace(_ESCAPE_BYTE, _ESCAPED_ESCAPE).replace(_FLAG_BYTE, _ESCAPED_FLAG)
    return _FLAG_BYTE + escaped + _FLAG_BYTE


class LineCounters(msgspec.Struct):
    """Input of a line."""

    frames: int = 0
    """Bodies whose CRC was right."""
    bad_crc: int = 0
    bad_length: int = 0
    """Shorter than an acknowledgement, or longer than the MTU."""
    bad_escape: int = 0
    """Frames that ended within an escape."""
    stray_bytes: int = 0
    """Before the first flag."""


class Deframer:
    """Reads the input of a line, in pieces of any size, and returns the bodies of good frames.

    A flag always ends a frame and begins the next. A torn or noisy frame therefore loses itself and, if its flag was
    hit, the next one.
    """

    def __init__(self) -> None:
        self.counters = LineCounters()
        self._is_in_sync = False
        self._is_too_long = False
        self._waiting = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Bodies that are complete with these bytes, without their CRC."""
        *ended, rest = data.split(_FLAG_BYTE)
        bodies = []
        for piece in ended:
            body = self._end(piece)
            if body is not None:
                bodies.append(body)
        if not self._is_in_sync:
            self.counters.stray_bytes += len(rest)
        elif not self._is_too_long:
            self._waiting += rest
            if len(self._waiting) > _MAX_ESCAPED_BYTES:
                self._is_too_long, self._waiting = True, b""
        return bodies

    def _end(self, piece: bytes) -> bytes | None:
        """A flag has come, and `piece` before it."""
        if not self._is_in_sync:
            self._is_in_sync = True
            self.counters.stray_bytes += len(piece)
            return None
        escaped, self._waiting = self._waiting + piece, b""
        too_long, self._is_too_long = self._is_too_long, False
        if not escaped and not too_long:  # two flags in a row: the end of one frame and the beginning of the next
            return None
        whole = _unescaped(escaped)
        if whole is None:
            self.counters.bad_escape += 1
        elif too_long or not MIN_BODY_BYTES + CRC_BYTES <= len(whole) <= MAX_BODY_BYTES + CRC_BYTES:
            self.counters.bad_length += 1
        elif crc16(whole[:-CRC_BYTES]) != int.from_bytes(whole[-CRC_BYTES:], "little"):
            self.counters.bad_crc += 1
        else:
            self.counters.frames += 1
            return whole[:-CRC_BYTES]
        return None


def _unescaped(escaped: bytes) -> bytes | None:
    """The bytes that were sent, or None if they end within an escape."""
    first, *others = escaped.split(_ESCAPE_BYTE)
    pieces = [first]
    position = 0
    while position < len(others):
        piece = others[position]
        if piece:
            pieces += [bytes([piece[0] ^ FLIP]), piece[1:]]
        elif position + 1 < len(others):  # an escaped 0x7d that no sender had to escape: 0x7d 0x7d
            pieces += [bytes([ESCAPE ^ FLIP]), others[position + 1]]
            position += 1
        else:
            return None
        position += 1
    return b"".join(pieces)


class Proto(IntEnum):
    """Kind of a frame."""

    ACK = 67
    """Sequence number: that packet has arrived."""
    PACKET_ACK = 68
    """Sequence number, packet: acknowledge it."""
    PACKET_NOACK = 69
    """Packet."""


class SerialLineCounters(msgspec.Struct):
    """How the packets fared."""

    received: int = 0
    duplicates: int = 0
    """Sent again by the other side although they had arrived."""
    unknown: int = 0
    """Good frames of a kind that is none of `Proto`, or without a packet."""
    sent: int = 0
    """Acknowledged by the other side."""
    resent: int = 0
    unsent: int = 0
    """Given up: never acknowledged, or too many were waiting."""


class SerialLink:
    """One end of a line.

    Args:
        ack_timeout_ns: how long an acknowledgement is waited for (TinyOS' tools wait 1 s).
        resends: how often a packet is sent again before it is given up.
        capacity: packets that may wait to be sent; one more is not taken in.

    """

    def __init__(self, *, ack_timeout_ns: int, resends: int, capacity: int = 64) -> None:
        self.counters = SerialLineCounters()
        self._deframer = Deframer()
        self._ack_timeout_ns = ack_timeout_ns
        self._resends = resends
        self._capacity = capacity
        self._to_write = bytearray()
        self._waiting: deque[bytes] = deque()
        self._number = 0
        self._in_flight: bytes | None = None
        self._due_ns = 0
        self._tries = 0
        self._last_body = b""

    @property
    def line(self) -> LineCounters:
        """Input of the line."""
        return self._deframer.counters

    @property
    def is_idle(self) -> bool:
        """Whether nothing waits to be sent or to be acknowledged."""
        return self._in_flight is None and not self._waiting

    def send(self, packet: bytes) -> bool:
        """Have a packet sent until it is acknowledged; False, and counted, if too many wait already."""
        if len(self._waiting) >= self._capacity:
            self.counters.unsent += 1
            return False
        self._waiting.append(packet)
        return True

    def receive(self, data: bytes) -> list[bytes]:
        """Packets that are complete with these bytes, each once."""
        packets = []
        for body in self._deframer.feed(data):
            kind = body[0]
            if kind == Proto.ACK and len(body) == 2:
                self._acknowledged(body[1])
            elif kind == Proto.PACKET_NOACK:
                packets.append(body[1:])
            elif kind == Proto.PACKET_ACK and len(body) > 2:
                self._to_write += frame(bytes([Proto.ACK, body[1]]))
                if body == self._last_body:  # our acknowledgement was lost
                    self.counters.duplicates += 1
                else:
                    packets.append(body[2:])
                self._last_body = body
            else:
                self.counters.unknown += 1
        self.counters.received += len(packets)
        return packets

    def to_write(self, now_ns: int) -> bytes:
        """Bytes to write to the line now; call it often, as it also sends packets again."""
        if self._in_flight is not None and now_ns >= self._due_ns:
            if self._tries > self._resends:
                self.counters.unsent += 1
                self._in_flight = None
            else:
                self.counters.resent += 1
                self._write_in_flight(now_ns)
        if self._in_flight is None and self._waiting:
            self._number = (self._number + 1) % NUMBERS
            self._in_flight = frame(bytes([Proto.PACKET_ACK, self._number]) + self._waiting.popleft())
            self._tries = 0
            self._write_in_flight(now_ns)
        written, self._to_write = bytes(self._to_write), bytearray()
        return written

    def _write_in_flight(self, now_ns: int) -> None:
        assert self._in_flight is not None
        self._to_write += self._in_flight
        self._due_ns = now_ns + self._ack_timeout_ns
        self._tries += 1

    def _acknowledged(self, number: int) -> None:
        if self._in_flight is not None and number == self._number:
            self._in_flight = None
            self.counters.sent += 1
