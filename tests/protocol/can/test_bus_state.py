import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.can.bus_state import BusState, error_frame, state_in, state_of
from robrain.protocol.can.payload import LONGEST_GAP, SequenceCounter


@pytest.mark.parametrize(
    ("transmit", "receive", "state"),
    [
        (0, 0, BusState.ACTIVE),
        (95, 95, BusState.ACTIVE),
        (96, 0, BusState.WARNING),
        (0, 127, BusState.WARNING),
        (128, 0, BusState.PASSIVE),
        (0, 255, BusState.PASSIVE),  # a receiver never goes bus off
        (256, 0, BusState.OFF),
    ],
)
def test_error_counters_stand_for_the_states_of_iso_11898(transmit, receive, state):
    assert state_of(transmit, receive) is state


@pytest.mark.parametrize("state", list(BusState))
def test_an_error_frame_tells_its_state(state):
    frame = error_frame(state)
    assert frame.is_error_frame
    assert frame.dlc == 8  # CAN_ERR_DLC of Linux
    assert state_in(frame.arbitration_id, frame.data) is state


@pytest.mark.parametrize(
    ("identifier", "data", "state"),
    [
        (0x040, bytes(8), BusState.OFF),  # CAN_ERR_BUSOFF
        (0x004, b"\x00\x20" + bytes(6), BusState.PASSIVE),  # CAN_ERR_CRTL, TX_PASSIVE
        (0x004, b"\x00\x04" + bytes(6), BusState.WARNING),  # RX_WARNING
        (0x204, b"\x00\x40" + bytes(6), BusState.ACTIVE),  # back to active, with counters
        (0x100, bytes(8), BusState.ACTIVE),  # CAN_ERR_RESTARTED
        (0x020, bytes(8), None),  # nobody acknowledged one frame
        (0x008, bytes(8), None),  # a protocol violation
        (0x004, b"", None),  # cut short
    ],
)
def test_error_frames_as_linux_sends_them_are_understood(identifier, data, state):
    assert state_in(identifier, data) is state


@given(st.integers(0, 255), st.lists(st.booleans(), min_size=1, max_size=500))
def test_lost_frames_are_counted_by_the_gaps_they_leave(first, arrives):
    watch, lost, since, told = SequenceCounter(), 0, 0, 0
    watch.record(first)
    for number, has_arrived in enumerate(arrives, 1):
        since += 1
        if has_arrived or since > LONGEST_GAP - 1:
            told += watch.record((first + number) % 256)
            lost += since - 1
            since = 0
    assert watch.lost == lost == told
