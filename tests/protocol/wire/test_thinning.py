"""On a thin link, telemetry that repeats itself is left out and counted, and keeps its deadline all the same."""

import itertools

import pytest

from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.links.thinning import Thinning
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session

STATE_BYTES = 1000


@pytest.fixture
def clock():
    return VirtualClock()


def run(thinning, clock, seconds, *, size=STATE_BYTES, hz=10, key="r1"):
    """The times at which a state was sent, for some time."""
    sent_s = []
    for _ in range(round(seconds * hz)):
        clock.advance_to(clock.now_ns() + to_ns(1 / hz))
        if thinning.admits(ROBOT_STATE, key, size):
            sent_s.append(clock.now_ns() / 1e9)
    return sent_s


def test_link_that_is_too_thin_halves_the_rate_and_keeps_the_deadline(clock):
    thinning = Thinning(2 * STATE_BYTES, clock)
    sent_s = run(thinning, clock, 20.0)
    assert ROBOT_STATE.deadline_s is not None
    assert max(later - sooner for sooner, later in itertools.pairwise(sent_s)) < ROBOT_STATE.deadline_s
    assert 98 <= len(sent_s) <= 105
    assert thinning.skipped == {"robot_state": 200 - len(sent_s)}


def test_what_must_be_sent_uses_the_link_up_before_telemetry(clock):
    thinning = Thinning(10 * STATE_BYTES, clock)
    run(thinning, clock, 1.0)
    for _ in range(5):
        assert thinning.admits(ROBOT_MAP, "map", 20 * STATE_BYTES)
    assert len(run(thinning, clock, 1.0)) == 5
    assert len(run(thinning, clock, 3.0)) > 20  # what is owed is bounded


def test_a_quiet_second_is_a_burst_and_no_more(clock):
    thinning = Thinning(5 * STATE_BYTES, clock)
    clock.advance_to(to_ns(100.0))
    sent = [thinning.admits(ROBOT_STATE, "r1", STATE_BYTES) for _ in range(10)]
    assert sent == [True] * 5 + [False] * 5


def test_publisher_sends_what_is_admitted_and_numbers_it_without_gaps(clock):
    with open_lockstep_session() as session:
        wire = Endpoint(session, "t", clock, Drive.LOCKSTEP, thinning=Thinning(1.0, clock))
        inbox = Inbox(every=True)
        wire.subscribe(inbox, ROBOT_STATE)
        publisher = wire.publisher(ROBOT_STATE, robot="r1")
        for _ in range(10):
            clock.advance_to(clock.now_ns() + to_ns(0.1))
            publisher.put(RobotState(robot="r1"))
        assert [received.message.seq for received in inbox.drain()] == [0, 1, 2, 3, 4]
        wire.close()
