"""The wire format of a CAN frame: a header, then the data. As in SocketCAN, the size marks a CAN FD frame.

| bytes | content |
|---|---|
| 0–7 | number of the sender, unsigned |
| 8–15 | stamp, ns; 0 if the sender has no clock |
| 16–19 | identifier, with SocketCAN's flags in its three top bits |
| 20–27 | classic: up to eight bytes of data; in a remote frame, as many zeros as the bytes it requests |
| 20, 21, 22–85 | CAN FD: flags, length, data padded to 64 bytes |

All numbers are little-endian.
"""

import struct

import can
from can.util import CAN_FD_DLC

HEADER = struct.Struct("<QqI")
EXTENDED, REMOTE, ERROR = 1 << 31, 1 << 30, 1 << 29
ID_MASK = (1 << 29) - 1
NODE, STAMP, IDENTIFIER = slice(0, 8), slice(8, 16), slice(16, 20)
NO_STAMP = bytes(8)
HEADER_BYTES = HEADER.size
CLASSIC_DATA_BYTES = 8
CLASSIC_BYTES = HEADER_BYTES + CLASSIC_DATA_BYTES
"""Largest size of a classic frame."""
FD_DATA_BYTES = 64
FD_BYTES = HEADER_BYTES + 2 + FD_DATA_BYTES
"""Size of every CAN FD frame."""

_BIT_RATE_SWITCH, _ERROR_STATE = 1, 2
_FLAGS, _LENGTH, _DATA = HEADER_BYTES, HEADER_BYTES + 1, HEADER_BYTES + 2
_FD_LENGTHS = frozenset(CAN_FD_DLC)


def pack_fd(message: can.Message, node: int, stamp_ns: int, identifier: int) -> bytes:
    """Encode a CAN FD frame.

    Args:
        message: the frame.
        node: number of the sender.
        stamp_ns: time of sending; 0 if the sender has no clock.
        identifier: the frame's identifier with its flags.

    Raises:
        ValueError: the frame is a remote frame or has a length that CAN FD does not allow.

    """
    if message.is_remote_frame:
        raise ValueError("CAN FD has no remote frames")
    data = message.data
    if len(data) not in _FD_LENGTHS:
        known = ", ".join(map(str, CAN_FD_DLC))
        raise ValueError(f"CAN FD has no frame of {len(data)} bytes; expected one of {known}")
    flags = _BIT_RATE_SWITCH * message.bitrate_switch | _ERROR_STATE * message.error_state_indicator
    return HEADER.pack(node, stamp_ns, identifier) + bytes((flags, len(data))) + data.ljust(FD_DATA_BYTES, b"\0")


def is_fd(payload: bytes) -> bool:
    """Whether a payload is a valid CAN FD frame."""
    return (
        len(payload) == FD_BYTES
        and payload[_FLAGS] <= _BIT_RATE_SWITCH | _ERROR_STATE
        and payload[_LENGTH] in _FD_LENGTHS
        and not int.from_bytes(payload[IDENTIFIER], "little") & REMOTE
    )


def data_in(payload: bytes) -> bytes:
    """The data in a payload that `unpack` decodes."""
    if len(payload) == FD_BYTES:
        return payload[_DATA : _DATA + payload[_LENGTH]]
    return payload[HEADER_BYTES:]


def unpack(payload: bytes, channel: str) -> can.Message:
    """Decode a payload: a CAN FD frame that passed `is_fd`, or a classic frame of at most `CLASSIC_BYTES`."""
    _, stamp_ns, identifier = HEADER.unpack_from(payload)
    is_fd_frame, data = len(payload) == FD_BYTES, data_in(payload)
    is_remote = bool(identifier & REMOTE)
    flags = payload[_FLAGS] if is_fd_frame else 0
    return can.Message(
        timestamp=stamp_ns / 1e9,
        arbitration_id=identifier & ID_MASK,
        is_extended_id=bool(identifier & EXTENDED),
        is_remote_frame=is_remote,
        is_error_frame=bool(identifier & ERROR),
        dlc=len(data),
        data=None if is_remote else data,
        is_fd=is_fd_frame,
        bitrate_switch=bool(flags & _BIT_RATE_SWITCH),
        error_state_indicator=bool(flags & _ERROR_STATE),
        channel=channel,
    )


def flagged_identifier(message: can.Message) -> int:
    """A message's identifier with SocketCAN's flags for extended, remote and error frames."""
    flags = EXTENDED * message.is_extended_id | REMOTE * message.is_remote_frame | ERROR * message.is_error_frame
    return message.arbitration_id & ID_MASK | flags


MODULUS = 256
LONGEST_GAP = 64
"""A longer step, or a step backwards, means that the sender has restarted; no frames are counted as lost."""


class SequenceCounter:
    """Follows the 8-bit counter of one kind of frame.

    Attributes:
        lost: frames that did not arrive, from the gaps in the counter.
        expected: the next counter if nothing is lost; None before the first. A reader of many frames may compare and
            increment it directly, without `record`.

    """

    def __init__(self) -> None:
        self.lost = 0
        self.expected: int | None = None

    def record(self, counter: int) -> int:
        """Record the counter of an accepted frame; return the number of frames missing before it."""
        expected, self.expected = self.expected, (counter + 1) % MODULUS
        if expected is None:
            return 0
        step = (counter + 1 - expected) % MODULUS
        missing = step - 1 if 0 < step <= LONGEST_GAP else 0
        self.lost += missing
        return missing
