"""Two nodes back to back on one bus: python-can's checks of every interface, for `zenoh`.

The subjects are those of python-can 4.6's own tests of two buses on one channel. Each test runs on nodes of a lockstep
run, on nodes that share a live session, and on nodes whose sessions are clients of one hub.
"""

import threading
import time
from collections.abc import Callable, Iterator

import can
import pytest
import zenoh

from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.wire.session import listening_at, open_session
from tests.waiting import PATIENCE_S, until

CHANNEL = "r1/can0"
Open = Callable[..., can.BusABC]


def open_bus(**options) -> can.BusABC:
    """A node as python-can's tools open it: CAN FD, and options that this interface ignores."""
    return can.Bus(
        interface="zenoh", channel=CHANNEL, **{"bitrate": 500_000, "fd": True, "single_handle": True} | options
    )


@pytest.fixture(params=["lockstep", "one_session", "clients"])
def open_node(request, hub, session) -> Iterator[Open]:
    """Opens nodes of one bus; all are shut down at the end."""
    nodes: list[can.BusABC] = []
    places = {
        "lockstep": {"session": session, "direct": True, "now_ns": time.time_ns},
        "one_session": {"session": hub},
        "clients": {"connect": listening_at(hub)[0]},
    }

    def open_one(**options) -> can.BusABC:
        nodes.append(open_bus(**places[request.param], **options))
        return nodes[-1]

    yield open_one
    for node in nodes:
        node.shutdown()


@pytest.fixture
def pair(open_node) -> tuple[can.BusABC, can.BusABC]:
    return open_node(), open_node()


@pytest.fixture
def clients(hub) -> Iterator[Open]:
    """Opens nodes that are clients of the hub."""
    nodes: list[can.BusABC] = []

    def open_one(kind=can.Bus, **options) -> can.BusABC:
        nodes.append(kind(interface="zenoh", channel=CHANNEL, connect=listening_at(hub)[0], **options))
        return nodes[-1]

    yield open_one
    for node in nodes:
        node.shutdown()


FRAMES = {
    "standard": can.Message(arbitration_id=0x100, is_extended_id=False, data=range(8)),
    "highest standard": can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b"\xff"),
    "extended": can.Message(arbitration_id=0x123456, is_extended_id=True, data=range(10, 18)),
    "highest extended": can.Message(arbitration_id=0x1FFFFFFF, is_extended_id=True, data=b"\xff"),
    "remote": can.Message(arbitration_id=0x200, is_extended_id=False, is_remote_frame=True, dlc=4),
    "error": can.Message(arbitration_id=0x004, is_extended_id=False, is_error_frame=True, data=bytes(8)),
    "empty": can.Message(),
    "shorter than eight": can.Message(arbitration_id=0x300, is_extended_id=False, data=b"abc"),
    "fd": can.Message(arbitration_id=0x56789, is_fd=True, data=b"\xff" * 64),
    "fd, short": can.Message(arbitration_id=0x56789, is_fd=True, data=b"\x01"),
    "fd, empty": can.Message(arbitration_id=0x56789, is_fd=True),
    "fd, bit rate switched": can.Message(arbitration_id=0x98765, is_fd=True, bitrate_switch=True, data=b"\xff" * 48),
    "fd, error passive": can.Message(arbitration_id=0x9, is_fd=True, error_state_indicator=True, data=bytes(12)),
}


def check_same(received: can.Message | None, sent: can.Message) -> None:
    assert received is not None
    assert received.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)
    assert received.dlc == sent.dlc
    assert received.channel == CHANNEL


@pytest.mark.parametrize("sent", FRAMES.values(), ids=FRAMES)
def test_a_frame_arrives_as_it_was_sent_in_both_directions(pair, sent):
    for sender, receiver in (pair, pair[::-1]):
        sender.send(sent)
        check_same(receiver.recv(PATIENCE_S), sent)
        assert sender.recv(0) is None


def test_a_node_that_wants_its_own_frames_gets_them_marked_as_sent(pair, open_node):
    hears_itself = open_node(receive_own_messages=True)
    sent = can.Message(arbitration_id=0x300, data=b"\x02\x01\x03")
    hears_itself.send(sent)
    own, others = hears_itself.recv(PATIENCE_S), pair[0].recv(PATIENCE_S)
    check_same(own, sent)
    check_same(others, sent)
    assert (own.is_rx, others.is_rx) == (False, True)
    pair[0].send(sent)
    assert hears_itself.recv(PATIENCE_S).is_rx


def test_many_frames_arrive_in_order(pair):
    for number in range(500):
        pair[0].send(can.Message(arbitration_id=number))
    assert [pair[1].recv(PATIENCE_S).arbitration_id for _ in range(500)] == list(range(500))


FILTERS = {
    "one identifier": ([{"can_id": 0x123, "can_mask": 0x7FF}], [0x123, 0x123]),
    "by mask": ([{"can_id": 0x120, "can_mask": 0x7F0}], [0x123, 0x123]),
    "extended only": ([{"can_id": 0x123, "can_mask": 0x7FF, "extended": True}], [0x123]),
    "either of two": ([{"can_id": 0x001, "can_mask": 0x7FF}, {"can_id": 0x2, "can_mask": 0x7FF}], [0x001, 0x002]),
    "none": (None, [0x001, 0x002, 0x123, 0x123]),
}


@pytest.mark.parametrize(("filters", "wanted"), FILTERS.values(), ids=FILTERS)
def test_filters_choose_what_is_received(pair, filters, wanted):
    last = can.Message(arbitration_id=0, is_error_frame=True)  # passes any filter: nothing else is pending
    pair[1].set_filters(filters)
    for identifier, is_extended in ((0x001, False), (0x002, True), (0x123, False), (0x123, True)):
        pair[0].send(can.Message(arbitration_id=identifier, is_extended_id=is_extended))
    pair[0].send(last)
    received = []
    while not (message := pair[1].recv(PATIENCE_S)).is_error_frame:
        received.append(message.arbitration_id)
    assert received == wanted


def test_a_shut_down_node_refuses_to_send_and_to_wait_as_python_can_says(pair):
    pair[0].shutdown()
    pair[0].shutdown()
    with pytest.raises(can.CanOperationError, match="zenoh r1/can0: is shut down"):
        pair[0].send(can.Message())
    with pytest.raises(can.CanOperationError, match="zenoh r1/can0: is shut down"):
        pair[0].recv(PATIENCE_S)


# -- what needs threads, so not in a lockstep run ---------------------------------------------------------------


@pytest.mark.parametrize("attempt", range(3))
def test_the_first_frames_after_opening_arrive_whoever_was_there_before(clients, attempt):
    del attempt
    first = clients()
    second = clients()
    first.send(can.Message(arbitration_id=1))
    second.send(can.Message(arbitration_id=2))
    third = clients()
    for number, bus in enumerate((first, second, third), 3):
        bus.send(can.Message(arbitration_id=number))
    for bus, wanted in ((first, [2, 4, 5]), (second, [1, 3, 5]), (third, [3, 4])):  # of different senders in any order
        assert sorted(bus.recv(PATIENCE_S).arbitration_id for _ in wanted) == wanted


def test_the_first_frames_between_a_lockstep_run_and_another_process_arrive(hub):
    for _ in range(3):
        inside = ZenohBus(CHANNEL, session=hub, direct=True, now_ns=lambda: 5_000_000_000)
        outside = ZenohBus(CHANNEL, connect=listening_at(hub)[0])
        inside.send(can.Message(arbitration_id=1))
        assert outside.recv(PATIENCE_S).timestamp == 5.0  # the sender's own time, where it has one
        outside.send(can.Message(arbitration_id=2))
        deadline_s = time.monotonic() + PATIENCE_S
        while (received := inside.recv(0)) is None and time.monotonic() < deadline_s:
            time.sleep(0.001)
        assert received.arbitration_id == 2
        assert received.timestamp == 5.0  # the receiver's, where the sender has none
        outside.shutdown()
        inside.shutdown()


def test_a_node_opens_beside_one_that_hangs(clients, monkeypatch):
    monkeypatch.setattr("robrain.protocol.can.zenoh_bus.MEET_TIMEOUT_S", 0.2)
    first = clients()
    release = threading.Event()
    hung = clients()
    hung._session.declare_queryable(  # answers nothing while it hangs
        hung._key, zenoh.handlers.Callback(lambda query: release.wait(PATIENCE_S), indirect=True)
    )
    try:
        late = clients()

        def heard():  # when the opening was cut short, a busy machine may not have told of the first node yet
            late.send(can.Message(arbitration_id=7))
            return first.recv(0.05)

        assert until(heard).arbitration_id == 7
    finally:
        release.set()


def test_nothing_is_sent_after_a_node_was_shut_down(clients):
    sender = clients()
    sending = threading.Thread(target=lambda: [sender.send(can.Message(arbitration_id=1)) for _ in range(10**9)])
    refused = []
    before, threading.excepthook = threading.excepthook, lambda args: refused.append(args.exc_value)
    try:
        sending.start()
        sender.shutdown()
        sending.join(PATIENCE_S)
    finally:
        threading.excepthook = before
    (error,) = refused
    assert isinstance(error, can.CanOperationError)


def test_a_thread_that_waits_for_a_frame_ends_with_its_bus(clients):
    bus = clients()
    ended: list[str] = []
    waits = threading.Event()

    def wait() -> None:
        waits.set()
        try:
            bus.recv()
        except can.CanOperationError as error:
            ended.append(str(error))

    waiting = threading.Thread(target=wait, daemon=True)
    waiting.start()
    waits.wait(PATIENCE_S)
    time.sleep(0.05)
    bus.shutdown()
    waiting.join(PATIENCE_S)
    assert ended == ["zenoh r1/can0: is shut down"]


# -- options ----------------------------------------------------------------------------------------------------


def test_an_unknown_option_is_refused_with_those_that_there_are(session):
    with pytest.raises(can.CanInitializationError, match=r"unknown option baud, rx_own: .*receive_own_messages.*fd"):
        open_bus(session=session, direct=True, rx_own=True, baud=9600)


def test_a_classic_node_neither_sends_nor_receives_can_fd(session):
    classic = ZenohBus(CHANNEL, session=session, direct=True)
    modern = ZenohBus(CHANNEL, session=session, direct=True, fd=True)
    with pytest.raises(can.CanOperationError, match="it was opened without fd"):
        classic.send(FRAMES["fd"])
    modern.send(FRAMES["fd"])
    assert classic.recv(0) is None
    assert classic.refused == 1
    classic.shutdown()
    modern.shutdown()


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (can.Message(arbitration_id=1, data=bytes(9)), "at most 8 bytes"),  # python-can itself does not check this
        (can.Message(arbitration_id=1, is_remote_frame=True, dlc=15), "at most 8 bytes"),
        (can.Message(arbitration_id=1 << 29), "identifier of 29 bits"),
        (can.Message(arbitration_id=-1), "identifier of 29 bits"),
        (can.Message(arbitration_id=1, is_fd=True, data=bytes(9)), "CAN FD has no frame of 9 bytes"),
        (can.Message(arbitration_id=1, is_fd=True, data=bytes(65)), "CAN FD has no frame of 65 bytes"),
        (can.Message(arbitration_id=1, is_fd=True, is_remote_frame=True), "CAN FD has no remote frames"),
    ],
)
def test_a_frame_that_no_bus_can_carry_is_refused(session, bad, why):
    with (
        ZenohBus(CHANNEL, session=session, direct=True, fd=True) as bus,
        pytest.raises(can.CanOperationError, match=why),
    ):
        bus.send(bad)


HEADER = bytes(16)
FORGED = {
    "nothing": b"",
    "shorter than a header": bytes(19),
    "longer than a classic frame": HEADER + bytes(4) + bytes(9),
    "longer than any frame": HEADER + bytes(4) + bytes(100_000),
    "fd of a length that there is not": HEADER + bytes(4) + bytes([0, 63]) + bytes(64),
    "fd with unknown flags": HEADER + bytes(4) + bytes([0x80, 8]) + bytes(64),
    "fd that asks for data": HEADER + (1 << 30).to_bytes(4, "little") + bytes([0, 8]) + bytes(64),
}


@pytest.mark.parametrize("payload", FORGED.values(), ids=FORGED)
def test_a_forged_frame_is_counted_and_not_received(session, payload):
    with ZenohBus(CHANNEL, session=session, direct=True, fd=True) as bus:
        session.put("robrain/default/arena/r1/can/can0", payload)
        assert bus.recv(0) is None
        assert bus.refused == 1


def test_a_node_can_be_shut_down_after_its_session(hub):
    session = open_session(connect=listening_at(hub)[:1])
    bus = ZenohBus(CHANNEL, session=session)
    session.close()  # type: ignore[no-untyped-call]
    with pytest.raises(can.CanOperationError, match="its session is closed"):
        bus.send(can.Message())
    bus.shutdown()


def test_a_bus_that_cannot_be_opened_leaves_no_session_behind(hub):
    before = len(hub.info.peers_zid())
    for _ in range(3):
        with pytest.raises(can.CanInitializationError, match=r"can_filters: expected .*can_id"):
            ZenohBus(CHANNEL, can_filters=[{"mask": 1}], connect=listening_at(hub)[0])  # type: ignore[list-item]
    assert len(hub.info.peers_zid()) == before
