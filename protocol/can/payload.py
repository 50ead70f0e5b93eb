"""What one CAN frame is on the wire: a header, then the data; a CAN FD frame is told by its size, as in SocketCAN.

| bytes | what |
|---|---|
| 0–7 | the sender's number, unsigned |
| 8–15 | stamp, ns; 0 if the sender has no clock |
| 16–19 | identifier, with the flags of SocketCAN in its three top bits |
| 20–27 | classic: up to eight bytes of data; of a remote frame, as many zeros as it asks for |
| 20, 21, 22–85 | CAN FD: its flags, its length, its data filled up to 64 bytes |

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
"""A classic frame is no longer than this."""
FD_DATA_BYTES = 64
FD_BYTES = HEADER_BYTES + 2 + FD_DATA_BYTES
"""Exactly the size of every CAN FD frame."""

_BIT_RATE_SWITCH, _ERROR_STATE = 1, 2
_FLAGS, _LENGTH, _DATA = HEADER_BYTES, HEADER_BYTES + 1, HEADER_BYTES + 2
_FD_LENGTHS = frozenset(CAN_FD_DLC)


def pack_fd(message: can.Message, node: int, stamp_ns: int, identifier: int) -> bytes:
    """A CAN FD frame as it travels.

    Args:
        message: the frame.
        node: the sender's number.
        stamp_ns: when it is sent; 0 if the sender has no clock.
        identifier: the frame's, with its flags.

    Raises:
        ValueError: there is no such CAN FD frame.

    """
    if message.is_remote_frame:
        raise ValueError("CAN FD knows no remote frames")
    data = message.data
    if len(data) not in _FD_LENGTHS:
        known = ", ".join(map(str, CAN_FD_DLC))
        raise ValueError(f"CAN FD knows no frame of {len(data)} bytes; there are {known}")
    flags = _BIT_RATE_SWITCH * message.bitrate_switch | _ERROR_STATE * message.error_state_indicator
    return HEADER.pack(node, stamp_ns, identifier) + bytes((flags, len(data))) + data.ljust(FD_DATA_BYTES, b"\0")


def is_fd(payload: bytes) -> bool:
    """Whether this is a CAN FD frame, and a possible one."""
    return (
        len(payload) == FD_BYTES
        and payload[_FLAGS] <= _BIT_RATE_SWITCH | _ERROR_STATE
        and payload[_LENGTH] in _FD_LENGTHS
        and not int.from_bytes(payload[IDENTIFIER], "little") & REMOTE
    )


def unpack(payload: bytes, channel: str) -> can.Message:
    """The frame in a payload that is a classic frame by its size, or a CAN FD frame by `is_fd`."""
    _, stamp_ns, identifier = HEADER.unpack_from(payload)
    if len(payload) == FD_BYTES:
        length, flags = payload[_LENGTH], payload[_FLAGS]
        return can.Message(
            timestamp=stamp_ns / 1e9,
            arbitration_id=identifier & ID_MASK,
            is_extended_id=bool(identifier & EXTENDED),
            is_error_frame=bool(identifier & ERROR),
            dlc=length,
            data=payload[_DATA : _DATA + length],
            is_fd=True,
            bitrate_switch=bool(flags & _BIT_RATE_SWITCH),
            error_state_indicator=bool(flags & _ERROR_STATE),
            channel=channel,
        )
    data = payload[HEADER_BYTES:]
    return can.Message(
        timestamp=stamp_ns / 1e9,
        arbitration_id=identifier & ID_MASK,
        is_extended_id=bool(identifier & EXTENDED),
        is_remote_frame=bool(identifier & REMOTE),
        is_error_frame=bool(identifier & ERROR),
        dlc=len(data),
        data=None if identifier & REMOTE else data,
        channel=channel,
    )
