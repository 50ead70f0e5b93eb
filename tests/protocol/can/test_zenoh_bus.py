import threading
import time
from collections.abc import Iterator

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.can import zenoh_bus
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.wire.session import listening_at, open_lockstep_session, open_session
from tests.waiting import PATIENCE_S


@pytest.fixture(scope="module")
def session():
    session = open_lockstep_session()
    yield session
    session.close()


@pytest.fixture
def nodes(session) -> Iterator[tuple[ZenohBus, ZenohBus]]:
    one = ZenohBus("r1/can0", session=session, direct=True, now_ns=lambda: 1_500_000_000)
    other = ZenohBus("r1/can0", session=session, direct=True)
    yield one, other
    one.shutdown()
    other.shutdown()


def frame(identifier=0x123, data=b"\x01\x02", **flags):
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=flags.pop("is_extended_id", False), **flags)


def test_two_nodes_exchange_frames(nodes):
    one, other = nodes
    one.send(frame(data=b"ping"))
    assert bytes(other.recv(timeout=0).data) == b"ping"
    other.send(frame(data=b"pong"))
    assert bytes(one.recv(timeout=0).data) == b"pong"


def test_frames_arrive_in_the_order_they_were_sent(nodes):
    one, other = nodes
    for number in range(20):
        one.send(frame(number))
    assert [other.recv(timeout=0).arbitration_id for _ in range(20)] == list(range(20))


def test_a_node_does_not_hear_itself(nodes):
    one, other = nodes
    one.send(frame())
    assert one.recv(timeout=0) is None
    assert other.recv(timeout=0) is not None


def test_nobody_hears_another_bus(session, nodes):
    elsewhere = [
        ZenohBus("r1/can1", session=session, direct=True),
        ZenohBus("r2/can0", session=session, direct=True),
        ZenohBus("r1/can0", session=session, direct=True, team="blue"),
    ]
    nodes[0].send(frame())
    assert [bus.recv(timeout=0) for bus in elsewhere] == [None, None, None]
    for bus in elsewhere:
        bus.shutdown()


def test_a_frame_bears_the_senders_time(nodes):
    nodes[0].send(frame())
    assert nodes[1].recv(timeout=0).timestamp == 1.5


@pytest.mark.parametrize(
    "sent",
    [
        frame(0x7FF, bytes(8)),  # the highest plain identifier
        frame(0x1FFFFFFF, b"\xff", is_extended_id=True),  # the highest extended one
        frame(5, b"", is_extended_id=True),  # an extended one that would fit a plain one
        frame(5, None, is_remote_frame=True, dlc=0),  # asks for nothing
        frame(5, None, is_remote_frame=True, dlc=8),  # asks for eight bytes and brings none
        frame(5, b"\x01\x02\x03", is_error_frame=True),  # tells of an error
    ],
    ids=repr,
)
def test_a_frame_arrives_with_its_flags_and_length(nodes, sent):
    nodes[0].send(sent)
    received = nodes[1].recv(timeout=0)
    assert received.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)
    assert received.dlc == sent.dlc


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8))
def test_any_frame_survives_the_bus(session, identifier, data):
    one, other = (ZenohBus("r9/can0", session=session, direct=True) for _ in range(2))
    one.send(frame(identifier, data, is_extended_id=True))
    received = other.recv(timeout=0)
    assert (received.arbitration_id, bytes(received.data)) == (identifier, data)
    one.shutdown()
    other.shutdown()


def test_filters_choose_what_is_received(session, nodes):
    with ZenohBus("r1/can0", can_filters=[{"can_id": 0x200, "can_mask": 0x7FF}], session=session, direct=True) as picky:
        nodes[0].send(frame(0x100))
        nodes[0].send(frame(0x200))
        assert picky.recv(timeout=0).arbitration_id == 0x200
        assert picky.recv(timeout=0) is None


def test_other_filters_choose_anew_also_among_frames_that_were_seen_before(session, nodes):
    picky = ZenohBus("r1/can0", [{"can_id": 0x100, "can_mask": 0x7FF}], session=session, direct=True)
    for filters, wanted in (
        ([{"can_id": 0x100, "can_mask": 0x7FF}], [0x100]),
        ([{"can_id": 0x200, "can_mask": 0x7FF}], [0x200]),
        (None, [0x100, 0x200]),
    ):
        picky.set_filters(filters)
        nodes[0].send(frame(0x100))
        nodes[0].send(frame(0x200))
        assert [picky.recv(timeout=0).arbitration_id for _ in wanted] == wanted
        assert picky.recv(timeout=0) is None
    picky.shutdown()


def test_a_filter_remembers_only_so_many_identifiers(session, nodes, monkeypatch):
    monkeypatch.setattr(zenoh_bus, "REMEMBERED_IDENTIFIERS", 3)
    picky = ZenohBus("r1/can0", [{"can_id": 0x000, "can_mask": 0x001}], session=session, direct=True)
    for identifier in range(16):
        nodes[0].send(frame(identifier))
    assert [picky.recv(timeout=0).arbitration_id for _ in range(8)] == list(range(0, 16, 2))
    assert picky.recv(timeout=0) is None
    picky.shutdown()


def test_python_can_finds_the_interface_by_its_name(session, nodes):
    with can.Bus(interface="zenoh", channel="r1/can0", session=session, direct=True, bitrate=500_000) as bus:
        assert isinstance(bus, ZenohBus)
        bus.send(frame(data=b"by name"))
        assert bytes(nodes[0].recv(timeout=0).data) == b"by name"


def test_a_can_fd_frame_is_refused_not_cut(nodes):
    with pytest.raises(can.CanOperationError, match="classic CAN frames"):
        nodes[0].send(frame(data=bytes(12), is_fd=True))
    assert nodes[1].recv(timeout=0) is None


def test_a_full_queue_lets_the_oldest_frame_go_and_counts_it(session, nodes, monkeypatch):
    monkeypatch.setattr(zenoh_bus, "QUEUE_FRAMES", 3)
    with ZenohBus("r1/can0", session=session, direct=True) as slow:
        for number in range(5):
            nodes[0].send(frame(number))
        assert slow.dropped == 2
        assert [slow.recv(timeout=0).arbitration_id for _ in range(3)] == [2, 3, 4]


@pytest.mark.parametrize("payload", [b"", b"short", bytes(19)])
def test_what_is_no_frame_is_ignored(session, nodes, payload):
    session.put("robrain/default/arena/r1/can/can0", payload)
    assert nodes[1].recv(timeout=0) is None


@pytest.mark.parametrize(
    ("channel", "why"),
    [
        ("can0", "expected ROBOT/CHANNEL, such as r1/can0"),  # no robot
        ("", "expected ROBOT/CHANNEL"),  # nothing
        ("r1/", "bad channel name"),  # no channel
        ("/can0", "bad robot name"),  # no robot, but a slash
        ("r1/*", "may not stand in a name"),  # would hear every bus
        ("r1/can0/x", "/ may not stand in a name"),  # a slash too many
        (None, "expected ROBOT/CHANNEL"),  # python-can's default
    ],
)
def test_a_bad_channel_is_refused_as_python_can_expects(session, channel, why):
    with pytest.raises(can.CanInitializationError, match=why):
        ZenohBus(channel, session=session)


def test_without_anybody_at_the_endpoint_there_is_no_bus():
    with pytest.raises(can.CanInitializationError, match=r"not an endpoint: expected something like tcp/"):
        ZenohBus("r1/can0", connect="127.0.0.1:7447")


def test_a_bus_can_be_shut_down_twice(session):
    bus = ZenohBus("r1/can0", session=session, direct=True)
    bus.shutdown()
    bus.shutdown()


def test_nothing_arrives_after_a_shutdown(session, nodes):
    gone = ZenohBus("r1/can0", session=session, direct=True)
    gone.shutdown()
    nodes[0].send(frame())
    assert gone.recv(timeout=0) is None


class LiveBus:
    """Two nodes with sessions of their own, on either side of a TCP connection."""

    def __init__(self) -> None:
        self.hub = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
        endpoint = listening_at(self.hub)[0]
        self.here = ZenohBus("r1/can0", session=self.hub)
        self.there = ZenohBus("r1/can0", connect=endpoint)

    def close(self) -> None:
        self.there.shutdown()
        self.here.shutdown()
        self.hub.close()


@pytest.fixture(scope="module")
def live():
    live = LiveBus()
    yield live
    live.close()


def meet(sender, receiver):
    """Send until the first frame has come through: declarations take a moment to cross the network."""
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        sender.send(frame(0x001))
        if receiver.recv(timeout=0.05) is not None:
            return
    pytest.fail("the nodes do not hear each other")


def next_after_meeting(receiver):
    """The first frame that is not one of those by which they met, however late these come."""
    while (message := receiver.recv(timeout=PATIENCE_S)) is not None and message.arbitration_id == 0x001:
        pass
    return message


def test_live_a_waiting_receiver_wakes_up_when_a_frame_comes(live):
    meet(live.here, live.there)
    received = []
    receiver = threading.Thread(target=lambda: received.append(next_after_meeting(live.there)))
    began_s = time.monotonic()
    receiver.start()
    live.here.send(frame(0x321, b"wake"))
    receiver.join(PATIENCE_S)
    assert time.monotonic() - began_s < PATIENCE_S / 2
    assert [message.arbitration_id for message in received] == [0x321]


def test_live_waiting_for_nothing_ends_with_nothing(live):
    assert live.there.recv(timeout=0.01) is None
