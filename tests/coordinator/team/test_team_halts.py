"""The team is told of a halt on each halt message, and when a robot has stopped or no longer reports so."""

import pytest

from robrain.coordinator.team.halts import TeamHalts
from robrain.coordinator.team.roster import Roster
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.presence import Change


class Team:
    """A watch, and one robot that the test speaks for."""

    def __init__(self, wire: Endpoint, clock: VirtualClock) -> None:
        self.clock = clock
        self.roster = Roster()
        self.watch = TeamHalts(wire, self.roster)
        self._halts = wire.publisher(HALT)
        self.roster.record_presence(Change({"robot": "r1"}, True))

    def halt(self, by: str, *, halted: bool = True) -> None:
        self._halts.put(Halt(halted=halted, by=by))

    def say(self, *, halted: bool, team_halt_ns: int = 0, halted_by: list[str] | None = None) -> None:
        state = RobotState(robot="r1", halted=halted, team_halt_ns=team_halt_ns, halted_by=halted_by or [])
        self.roster.record_state(state, self.clock.now_ns())
        self.watch.record_state(state)


@pytest.fixture
def team(wire: Endpoint) -> Team:
    wire.clock.advance_to(to_ns(5.0))
    return Team(wire, wire.clock)


def test_without_a_halt_there_is_no_news_whatever_robots_do(team: Team) -> None:
    for halted in (False, True, False):
        team.say(halted=halted)
        assert team.watch.receive() is False
    assert team.watch.status(team.clock.now_ns()) is None


def test_each_halt_and_each_stop_of_a_robot_is_news_once(team: Team) -> None:
    team.say(halted=False)
    team.halt("ann")
    assert [team.watch.receive() for _ in range(2)] == [True, False]
    team.say(halted=True)
    assert [team.watch.receive() for _ in range(2)] == [True, False]
    team.say(halted=False)
    assert [team.watch.receive() for _ in range(2)] == [True, False]
    team.halt("bob")
    assert [team.watch.receive() for _ in range(2)] == [True, False]


def test_robot_that_has_not_heard_of_a_halt_is_told_again_ten_times_a_second(team: Team) -> None:
    team.say(halted=False)
    team.halt("ann")
    told = []
    for _ in range(100):
        team.clock.advance_to(team.clock.now_ns() + to_ns(0.02))
        team.say(halted=False)
        told.append(team.watch.receive())
    assert sum(told) == 20
    team.say(halted=True)
    assert team.watch.receive() is True
    for _ in range(10):
        team.clock.advance_to(team.clock.now_ns() + to_ns(0.02))
        assert team.watch.receive() is False
    team.say(halted=False)
    assert team.watch.receive() is True
    team.clock.advance_to(team.clock.now_ns() + to_ns(5.0))  # it is not there any more: nobody is to be told
    team.watch.receive()
    assert team.watch.receive() is False


def test_end_of_a_halt_is_news_and_what_robots_do_after_it_is_none(team: Team) -> None:
    team.say(halted=True)
    team.halt("ann")
    team.watch.receive()
    team.halt("ann", halted=False)
    assert team.watch.receive() is True
    assert not team.watch.is_halted
    team.say(halted=False)
    assert team.watch.receive() is False
    assert team.watch.status(team.clock.now_ns()).by == ["ann"]


def test_halt_that_a_robot_knows_and_the_coordinator_does_not_is_taken_over_with_its_holders(team: Team) -> None:
    team.say(halted=True, team_halt_ns=to_ns(4.0), halted_by=["ann", "bob"])
    assert team.watch.is_halted
    status = team.watch.status(team.clock.now_ns())
    assert (status.by, status.reason, status.stopped, status.not_stopped) == (
        ["ann", "bob"],
        "reported by r1",
        ["r1"],
        [],
    )
    stamp_ns = status.stamp_ns
    team.say(halted=True, team_halt_ns=stamp_ns, halted_by=["eve"])  # it is no later than what is known
    assert team.watch.status(team.clock.now_ns()).by == ["ann", "bob"]
    team.say(halted=True, team_halt_ns=stamp_ns + 1, halted_by=["eve"])
    assert team.watch.status(team.clock.now_ns()).by == ["ann", "bob", "eve"]
