import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.border.border import Border
from robrain.protocol.links.inbox import LARGE_BYTES, Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, ROBOT_LOG, LogRecord
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.team.team_messages import HALT, Halt
from tests.interruption import before_line_of

LOG_KEY = ROBOT_LOG.key("t", robot="r1")


def log(text):
    return msgspec.json.encode(LogRecord(robot="r1", level="info", source="test", text=str(text)))


def state(robot, seq):
    return ROBOT_STATE, ROBOT_STATE.key("t", robot=robot), msgspec.json.encode(RobotState(robot=robot, seq=seq))


def test_samples_come_out_decoded_in_order_of_arrival():
    inbox = Inbox()
    for number in range(3):
        inbox.append(ROBOT_LOG, LOG_KEY, log(number))
    received = inbox.drain()
    assert [item.message.text for item in received] == ["0", "1", "2"]
    assert received[0].topic is ROBOT_LOG
    assert received[0].names == {"team": "t", "robot": "r1"}
    assert len(inbox) == 0
    assert inbox.drain() == []


def test_a_full_inbox_lets_the_oldest_go_and_counts_it():
    inbox = Inbox(capacity=3)
    for number in range(5):
        inbox.append(ROBOT_LOG, LOG_KEY, log(number))
    assert (len(inbox), inbox.dropped, inbox.received) == (3, 2, 5)
    assert [item.message.text for item in inbox.drain()] == ["2", "3", "4"]


def test_of_the_latest_only_the_last_of_each_key_stays():
    inbox = Inbox()
    for robot, seq in [("r2", 1), ("r1", 1), ("r2", 2), ("r1", 2), ("r1", 3)]:
        inbox.append(*state(robot, seq))
    assert [(item.names["robot"], item.message.seq) for item in inbox.drain()] == [("r1", 3), ("r2", 2)]
    assert inbox.dropped == 0


def test_the_latest_are_bounded_too():
    inbox = Inbox(capacity=2)
    for robot in ("r1", "r2", "r3"):
        inbox.append(*state(robot, 1))
    inbox.append(*state("r1", 2))
    assert (len(inbox), inbox.dropped) == (2, 1)
    assert [(item.names["robot"], item.message.seq) for item in inbox.drain()] == [("r1", 2), ("r2", 1)]


def test_what_counts_singly_comes_before_the_latest():
    inbox = Inbox()
    inbox.append(*state("r1", 1))
    inbox.append(HALT, HALT.key("t"), msgspec.json.encode(Halt(halted=True, by="me")))
    assert [item.topic for item in inbox.drain()] == [HALT, ROBOT_STATE]


@pytest.mark.parametrize(
    "payload",
    [
        b"",  # nothing
        b"\x00\x01",  # no JSON
        b'{"robot": "r1"',  # cut
        b'{"robot": 1, "level": "info", "source": "x", "text": "y"}',  # a wrong type
        b'{"level": "info", "source": "x", "text": "y"}',  # a field is missing
        b'{"robot": "r\xff", "level": "info", "source": "x", "text": "y"}',  # no UTF-8
    ],
)
def test_malformed_samples_are_counted_and_left_out(payload):
    inbox = Inbox()
    inbox.append(ROBOT_LOG, LOG_KEY, payload)
    inbox.append(ROBOT_LOG, LOG_KEY, log("good"))
    assert [item.message.text for item in inbox.drain()] == ["good"]
    assert inbox.refused == 1


def test_what_is_nested_too_deep_is_malformed_and_harms_nobody():
    inbox = Inbox()
    bomb = b'{"robot": "r1", "plugin": "p", "event": "e", "value": ' + b"[" * 100_000 + b"]" * 100_000 + b"}"
    inbox.append(ROBOT_EVENT, ROBOT_EVENT.key("t", robot="r1", plugin="p", event="e"), bomb)
    assert inbox.drain() == []
    assert inbox.refused == 1


@given(
    st.integers(1, 5),
    st.lists(st.one_of(st.just("drain"), st.tuples(st.booleans(), st.sampled_from("abcdefg"))), max_size=40),
)
def test_nothing_is_lost_without_being_counted(capacity, actions):
    inbox = Inbox(capacity)
    seen = waiting = replaced = 0
    latest: set[str] = set()
    for action in actions:
        if action == "drain":
            seen += len(inbox.drain_raw())
            latest.clear()
            continue
        is_latest, robot = action
        before = len(inbox)
        if is_latest:
            inbox.append(*state(robot, 0))
            replaced += robot in latest
            if len(inbox) > before:
                latest.add(robot)
        else:
            inbox.append(ROBOT_LOG, ROBOT_LOG.key("t", robot=robot), log(""))
        assert len(inbox) <= 2 * capacity
    waiting = len(inbox)
    assert inbox.received == seen + waiting + replaced + inbox.dropped


@pytest.mark.parametrize("line", range(1, 8))
def test_an_owner_that_drains_in_the_midst_of_an_append_harms_nothing(line):
    inbox, drained = Inbox(capacity=1), []
    inbox.append(ROBOT_LOG, LOG_KEY, log("first"))
    with before_line_of(Inbox.append, line, lambda: drained.extend(inbox.drain())):
        inbox.append(ROBOT_LOG, LOG_KEY, log("second"))
    drained += inbox.drain()
    assert drained[-1].message.text == "second"
    assert inbox.received == 2


def test_large_samples_are_bounded_by_their_bytes_and_small_ones_by_their_number():
    inbox = Inbox(1000, border=Border(), max_bytes=3 * LARGE_BYTES)
    large = b"x" * (LARGE_BYTES + 1)
    for number in range(5):
        inbox.append(ROBOT_EVENT, f"k{number}", large)
        inbox.append(ROBOT_EVENT, "small", b"{}")
    assert inbox.dropped == 3
    assert [len(payload) for _, _, payload in inbox.drain_raw()].count(len(large)) == 2
    assert inbox.append(ROBOT_EVENT, "k", large)  # there is room again
    assert inbox.received == 11


def test_large_sample_that_replaces_another_takes_its_room():
    inbox = Inbox(border=Border(), max_bytes=3 * LARGE_BYTES)
    large = b"x" * (LARGE_BYTES + 1)
    for _ in range(50):
        assert inbox.append(ROBOT_STATE, "r1", large)
    assert inbox.append(ROBOT_STATE, "r2", large)
    assert not inbox.append(ROBOT_STATE, "r3", large)
    assert inbox.append(ROBOT_STATE, "r1", large)
    assert (inbox.dropped, len(inbox)) == (1, 2)
