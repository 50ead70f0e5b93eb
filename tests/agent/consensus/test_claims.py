"""A robot without a coordinator begins what more than half of the team has heard that it wants to begin."""

from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from robrain.agent.consensus.consensus import TaskClaim, _Opened
from robrain.agent.consensus.holders import GOES_ON_S
from robrain.protocol.clock import VirtualClock
from robrain.protocol.messages.tasks.consensus_messages import TaskHeldBy
from robrain.protocol.model.ballot import Ballot, Heard
from tests.agent.consensus.one_robot import OneRobot, alone, free, visit


@pytest.fixture
def one() -> Iterator[OneRobot]:
    robot = OneRobot()
    yield robot
    robot.close()


class Agreed:
    """A negotiation in which all have agreed that the robot does some tasks."""

    is_agreed = is_over = True
    round = 1
    term = 0

    def __init__(self, clock: VirtualClock, path: list[str]) -> None:
        self.path, self._number = path, clock.now_ns()
        self.bidder = SimpleNamespace(begun=())

    def may_begin(self, _task: str) -> bool:
        return True

    def begin(self, task: str) -> None:
        self.path.remove(task)

    def receive(self, _ballot: Ballot) -> bool:
        return True

    def ballot(self) -> Ballot:
        self._number += 1
        return Ballot(robot="r1", number=self._number)


def test_a_task_is_begun_when_more_than_half_of_the_team_has_heard_that_the_robot_wants_it(one: OneRobot) -> None:
    one.tell(visit("t1"))
    alone(one, receives=())
    one.says["r3"] = {"receives": ()}
    one.consensus._negotiation = Agreed(one.clock, ["t1"])
    one.consensus._opened = _Opened(one.clock.now_ns(), 1, frozenset({"r2", "r3"}), frozenset({"t1"}))
    one.run(0.2)
    told = one.run(3.0)
    assert one.consensus.is_leaderless
    assert {ballot.wants for ballot in told} == {"t1"}
    assert one.begun == []
    one.says["r2"] = {}
    one.run(0.5)
    assert one.begun == ["t1"]
    assert one.run(1.0)[-1].wants == ""


def test_an_echo_of_a_ballot_without_the_claim_does_not_count() -> None:
    claim = TaskClaim("r1")
    claim.record_sent(6)
    assert claim.want("t1")
    claim.record_sent(7)
    for teammate, number in (("r2", 6), ("r3", 8)):
        claim.record_echo(teammate, [Heard(robot="r1", number=number), Heard(robot="r9", number=7)])
    assert not claim.is_confirmed({"r2", "r3"}, 3)
    claim.record_echo("r2", [Heard(robot="r1", number=7)])
    assert claim.is_confirmed({"r2", "r3"}, 3)
    assert not claim.is_confirmed({"r3"}, 3), "it is not heard any more"
    assert not claim.is_confirmed({"r2", "r3"}, 4)
    assert not claim.want("t1")
    assert claim.want("t2")
    assert not claim.is_confirmed({"r2", "r3"}, 3)
    assert not claim.want("")
    assert not claim.is_confirmed(set(), 1)


def test_what_a_mate_wanted_before_it_was_cut_off_is_not_free_and_the_others_are_told(one: OneRobot) -> None:
    one.tell(visit("t1"))
    alone(one, wants="t1")
    del one.says["r2"]
    told = one.run(3.0)[-1]
    assert [(held.id, held.robot) for held in told.absent] == [("t1", "r2")]
    assert GOES_ON_S - 3.0 < told.absent[0].remaining_s < GOES_ON_S
    assert one.consensus.is_leaderless
    assert free(one) == []


def test_what_others_say_of_an_absent_robot_counts_for_as_long_as_they_say_and_not_of_one_that_is_there(
    one: OneRobot,
) -> None:
    for name in ("t1", "t2"):
        one.tell(visit(name))
    absent = [TaskHeldBy(id="t1", robot="r9", remaining_s=4.0), TaskHeldBy(id="t2", robot="r3", remaining_s=4.0)]
    alone(one, absent=absent)
    assert free(one) == ["t2"]
    one.says["r2"] = {}
    one.run(3.5)
    assert free(one) == ["t2"]
    one.run(1.0)
    assert free(one) == ["t1", "t2"]


def test_a_robot_that_was_out_for_a_moment_still_belongs_to_the_team_of_which_more_than_half_is_needed(
    one: OneRobot,
) -> None:
    one.run(1.0)
    one.run(2.0, team=("r1",))
    one.is_coordinated = False
    one.run(3.0)
    assert not one.consensus.is_leaderless
    one.is_coordinated = True
    one.run(GOES_ON_S, team=("r1",))
    one.is_coordinated = False
    one.run(3.0)
    assert one.consensus.is_leaderless
