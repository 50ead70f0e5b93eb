"""What waits at a bridge: halts do not go for telemetry."""

from collections import deque

from hypothesis import given
from hypothesis import strategies as st

from robrain.deploy.bridge.waiting import Message, Waiting
from robrain.protocol.wire.topic import Urgency
from robrain.protocol.wire.topics import HALT, ROBOT_MAP, ROBOT_STATE

ORDER = list(Urgency)
TOPICS = (HALT, ROBOT_STATE, ROBOT_MAP)


def message(topic, number):
    return Message(topic, topic.pattern, str(number).encode(), b"")


def test_a_halt_stays_when_states_come_faster_than_they_are_carried():
    waiting = Waiting(3)
    assert not waiting.put(message(HALT, 0))
    assert [waiting.put(message(ROBOT_STATE, number)) for number in range(5)] == [False, False, True, True, True]
    assert [one.payload for one in waiting.take()] == [b"0", b"3", b"4"]
    assert waiting.take() == []


def test_what_is_least_urgent_goes_itself_when_all_else_is_more_urgent():
    waiting = Waiting(1)
    waiting.put(message(HALT, 0))
    assert waiting.put(message(ROBOT_MAP, 1))
    assert [one.topic for one in waiting.take()] == [HALT]


@given(st.lists(st.sampled_from(TOPICS), max_size=40), st.integers(1, 8))
def test_as_many_are_kept_as_there_is_room_for_and_each_kind_in_order(topics, most):
    waiting, dropped = Waiting(most), 0
    for number, topic in enumerate(topics):
        dropped += waiting.put(message(topic, number))
    kept = waiting.take()
    assert len(kept) == min(most, len(topics))
    assert dropped == len(topics) - len(kept)
    ranks = [ORDER.index(one.topic.urgency) for one in kept]
    assert ranks == sorted(ranks)
    for topic in TOPICS:
        said = deque(number for number, one in enumerate(topics) if one is topic)
        last = [int(one.payload) for one in kept if one.topic is topic]
        assert last == list(said)[len(said) - len(last) :]
