"""Frames on a TinyOS serial line: HDLC's flags and escapes around a body and its CRC.

A frame is 0x7e, the body, the CRC with its low byte first, 0x7e; between the flags 0x7e and 0x7d are sent as 0x7d and
the byte xor 0x20. The CRC has polynomial 0x1021 and starts at 0; it covers the whole body (TEP 113, sections 3.2
and 3.6; tos/lib/serial/SerialP.nc, whose CRC takes in the protocol byte too; RFC 1662).
"""

import binascii

import msgspec

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
    """What a line has brought."""

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
    """Takes what arrives on a line, in whatever pieces, and gives the bodies of good frames.

    A flag always ends a frame and begins the next, so one that is torn or noisy costs itself and, if its flag was
    hit, the one after it.
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
        elif position + 1 < len(others):  # an escaped 0x7d that nobody had to send so: 0x7d 0x7d
            pieces += [bytes([ESCAPE ^ FLIP]), others[position + 1]]
            position += 1
        else:
            return None
        position += 1
    return b"".join(pieces)
