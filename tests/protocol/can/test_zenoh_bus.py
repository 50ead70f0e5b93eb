from collections.abc import Iterator

import can
import pytest

from robrain.protocol.can import zenoh_bus
from robrain.protocol.can.zenoh_bus import ZenohBus


@pytest.fixture
def nodes(session) -> Iterator[tuple[ZenohBus, ZenohBus]]:
    one = ZenohBus("r1/can0", session=session, direct=True, now_ns=lambda: 1_500_000_000)
    other = ZenohBus("r1/can0", session=session, direct=True)
    yield one, other
    one.shutdown()
    other.shutdown()


def frame(identifier=0x123, data=b"\x01\x02", **flags):
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=flags.pop("is_extended_id", False), **flags)


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


def test_a_full_queue_lets_the_oldest_frame_go_and_counts_it(session, nodes, monkeypatch):
    monkeypatch.setattr(zenoh_bus, "QUEUE_FRAMES", 3)
    with ZenohBus("r1/can0", session=session, direct=True) as slow:
        for number in range(5):
            nodes[0].send(frame(number))
        assert slow.dropped == 2
        assert [slow.recv(timeout=0).arbitration_id for _ in range(3)] == [2, 3, 4]


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


def test_a_filter_remembers_only_so_many_identifiers(session, nodes, monkeypatch):
    monkeypatch.setattr(zenoh_bus, "REMEMBERED_IDENTIFIERS", 3)
    picky = ZenohBus("r1/can0", [{"can_id": 0x000, "can_mask": 0x001}], session=session, direct=True)
    for identifier in range(16):
        nodes[0].send(frame(identifier))
    assert [picky.recv(timeout=0).arbitration_id for _ in range(8)] == list(range(0, 16, 2))
    assert picky.recv(timeout=0) is None
    picky.shutdown()
