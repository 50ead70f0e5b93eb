"""Reports of CAN controllers about their bus: error states, and error frames in Linux's format.

The states and their limits are those of ISO 11898-1 (fault confinement). A node is error active, from 128 errors
counted error passive, and from 256 transmit errors bus off; 96 is the usual warning. Error frames are laid out as in
Linux's `include/uapi/linux/can/error.h`, which python-can's `socketcan` hands on and other interfaces imitate.
"""

from enum import IntEnum

import can

WARNING_ERRORS = 96
PASSIVE_ERRORS = 128
BUS_OFF_ERRORS = 256
MOST_ERRORS = 255
"""Flags in a byte of a frame."""

_CONTROLLER, _BUS_OFF, _RESTARTED = 0x004, 0x040, 0x100
"""Bits of an error frame's identifier."""
_WARNING, _PASSIVE = 0x0C, 0x30
"""Bits of its data[1], receiving or sending."""
_FRAME_BYTES = 8


class BusState(IntEnum):
    """State of a node on its bus, numbered as in the DBC file."""

    ACTIVE = 0
    WARNING = 1
    PASSIVE = 2
    """It may not interrupt others any more; it still sends and receives."""
    OFF = 3
    """It has left the bus."""


def state_of(transmit_errors: int, receive_errors: int) -> BusState:
    """The state that error counters stand for."""
    if transmit_errors >= BUS_OFF_ERRORS:
        return BusState.OFF
    most = max(transmit_errors, receive_errors)
    if most >= PASSIVE_ERRORS:
        return BusState.PASSIVE
    return BusState.WARNING if most >= WARNING_ERRORS else BusState.ACTIVE


def error_frame(state: BusState) -> can.Message:
    """The error frame by which a controller reports to its host that it is in this state now."""
    data = bytearray(_FRAME_BYTES)
    identifier = {BusState.OFF: _BUS_OFF, BusState.ACTIVE: _RESTARTED}.get(state, _CONTROLLER)
    if identifier == _CONTROLLER:
        data[1] = _PASSIVE if state is BusState.PASSIVE else _WARNING
    return can.Message(arbitration_id=identifier, data=data, is_error_frame=True, is_extended_id=False)


def state_in(identifier: int, data: bytes | bytearray) -> BusState | None:
    """The state that an error frame reports; None if it reports another condition.

    Args:
        identifier: the frame's, without flags.
        data: its bytes.

    """
    if identifier & _BUS_OFF:
        return BusState.OFF
    if identifier & _RESTARTED:
        return BusState.ACTIVE
    if identifier & _CONTROLLER and len(data) > 1:
        if data[1] & _PASSIVE:
            return BusState.PASSIVE
        return BusState.WARNING if data[1] & _WARNING else BusState.ACTIVE
    return None
