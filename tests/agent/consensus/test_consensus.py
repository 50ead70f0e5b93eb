"""One robot's part in allocation without a coordinator, with the others' words written by hand."""

from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from robrain.agent.consensus.consensus import AGAIN_NS, REPORTING, TaskClaim, _Opened
from robrain.agent.consensus.holders import GOES_ON_S
from robrain.agent.consensus.known_tasks import ENDED_MAX, TASKS_MAX, KnownTasks
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.errors import CallError
from robrain.protocol.messages.tasks import consensus_messages
from robrain.protocol.messages.tasks.consensus_messages import (
    TaskAsked,
    TaskDone,
    TaskHeld,
    TaskHeldBy,
    TaskKnown,
    TeamBallot,
)
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.task_messages import TaskSubmission
from robrain.protocol.model.ballot import Ballot, Bid, SeenBallot
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import Occupied
from tests.agent.consensus.one_robot import OneRobot, alone, free, visit


@pytest.fixture
def one() -> Iterator[OneRobot]:
    robot = OneRobot()
    yield robot
    robot.close()


def test_a_team_of_two_that_is_cut_in_half_allocates_nothing_on_either_side(one: OneRobot) -> None:
    one.run(1.0, team=("r1", "r2"))
    one.tell(visit("t1"))
    one.is_coordinated = False
    one.run(10.0)
    assert not one.consensus.is_leaderless
    assert one.begun == []


def test_five_ballots_a_second_without_a_coordinator_and_for_two_seconds_after_it_returns(one: OneRobot) -> None:
    assert one.run(2.0) == []
    alone(one)
    assert len(one.run(4.0)) == 20
    one.is_coordinated, one.says = True, {}
    told = one.run(1.9)
    assert 9 <= len(told) <= 10
    assert {ballot.receives_coordinator for ballot in told} == {True}
    one.run(0.3)
    assert one.run(3.0) == []


def test_for_a_second_after_it_returns_a_coordinator_is_told_and_not_obeyed(one: OneRobot) -> None:
    alone(one)
    one.is_coordinated = True
    one.run(0.1)
    begun_ns = one.clock.now_ns()
    assert one.consensus.offer_refusal("t1", begun_ns) == one.consensus.withdrawal_refusal(begun_ns) == REPORTING
    assert one.consensus.withdrawal_refusal(begun_ns + to_ns(1.0)) is None
    assert one.consensus.is_reporting(begun_ns + to_ns(1.0) - 1)
    assert not one.consensus.is_reporting(begun_ns + to_ns(1.0))


@pytest.mark.parametrize("missed", [False, True])
def test_a_task_that_may_have_ended_unheard_is_not_begun_before_others_would_give_it_up(one: OneRobot, missed) -> None:
    one.tell(visit("t1"))
    one.run(1.0)
    one.last_change = int(missed)  # nobody answers what it asks then
    one.run(0.1)
    one.is_coordinated, one.says = False, {"r2": {}, "r3": {}}
    one.run(2.0)
    assert free(one) == ([] if missed else ["t1"])
    one.run(GOES_ON_S + 2.0)
    assert free(one) == ["t1"]


def test_a_task_that_a_mate_does_or_has_done_is_refused_with_its_name(one: OneRobot) -> None:
    for name in ("t1", "t2"):
        one.tell(visit(name))
    alone(one, held=[TaskHeld(id="t1", epoch=4)], done=[TaskDone(id="t2", robot="r3", epoch=5)])
    now_ns = one.clock.now_ns()
    assert one.consensus.offer_refusal("t1", now_ns) == Occupied("consensus", "r2 is at it")
    assert one.consensus.offer_refusal("t2", now_ns) == Occupied("consensus", "r3 has done it")
    assert one.consensus.offer_refusal("t3", now_ns) == REPORTING


def test_the_task_of_a_robot_that_vanished_is_free_when_that_has_let_it_go(one: OneRobot) -> None:
    one.run(1.0)
    one.tell(visit("t1"), TaskState.RUNNING, "r9")
    alone(one)
    one.run(GOES_ON_S - 5.0)
    assert not one.consensus._free(one.clock.now_ns())
    one.run(9.0)
    assert [task.id for task in one.consensus._free(one.clock.now_ns())] == ["t1"]


def test_what_the_robot_could_not_do_it_does_not_bid_for_until_half_a_minute_later(one: OneRobot) -> None:
    one.tell(visit("t1"))
    alone(one)
    one.consensus._begin(visit("t1"), one.clock.now_ns())
    one.run(0.5)
    one.desk.end("t1", TaskState.FAILED, "blocked")
    one.run(0.5)
    failed_ns = one.clock.now_ns()
    assert failed_ns < one.consensus._not_mine["t1"] <= failed_ns + AGAIN_NS
    one.consensus._open({"t1": visit("t1")}, frozenset(), failed_ns)
    assert not one.consensus._negotiation.bidder.scorer._stops
    one.consensus._open({"t1": visit("t1")}, frozenset(), failed_ns + AGAIN_NS + 1)
    assert list(one.consensus._negotiation.bidder.scorer._stops) == ["t1"]


def test_a_robot_that_does_not_know_where_it_is_bids_for_nothing(one: OneRobot) -> None:
    alone(one)
    one.board.lost = "it was carried off"
    one.consensus._open({"t1": visit("t1")}, frozenset(), one.clock.now_ns())
    assert not one.consensus._negotiation.bidder.scorer._stops


@pytest.mark.parametrize(("soc", "charges"), [(0.5, ["recharge-r1-1", "recharge-r1-2"]), (0.91, [])])
def test_a_robot_for_which_there_is_nothing_charges_at_the_nearest_charger(
    one: OneRobot, soc: float, charges: list[str]
) -> None:
    one.board.battery = SimpleNamespace(soc=soc)
    one.consensus._charge()
    if charges:
        one.desk.end("recharge-r1-1", TaskState.DONE, "full")
        one.consensus._charge()
    assert one.begun == charges


def test_half_of_the_team_is_not_enough_to_keep_a_task(one: OneRobot) -> None:
    intake, asked = one.consensus._intake, TaskSubmission(task=visit("t1"))
    taken = intake.accept(asked, 5, {}, 2)
    assert (taken.known_to, taken.is_kept) == (["r1"], False)
    told = {"r2": [TaskKnown(id="t1", at_ns=5)], "r3": [TaskKnown(id="t1", at_ns=6)]}
    taken = intake.accept(asked, 9, told, 3)
    assert (taken.known_to, taken.is_kept) == (["r1", "r2"], True), "another task of that name does not count"
    assert intake.accept(asked, 9, told, 4).is_kept is False


def test_a_name_that_the_coordinator_has_given_is_refused_and_a_deadline_that_is_now(one: OneRobot) -> None:
    one.tell(visit("t1"))
    alone(one)
    with pytest.raises(CallError, match="t1 is refused: there is a task of that name"):
        one.consensus.submit(TaskSubmission(task=visit("t1")), one.clock.now_ns())
    with pytest.raises(CallError, match=r"t2 is refused: its deadline was 0.0 s ago"):
        one.consensus.submit(TaskSubmission(task=visit("t2", deadline_ns=one.clock.now_ns())), one.clock.now_ns())


# -- what it knows ------------------------------------------------------------------------------------------------


def heard(task: Task, state: TaskState = TaskState.QUEUED, robot: str = "") -> TaskEvent:
    return TaskEvent(task=task, state=state, robot=robot)


def test_a_robot_remembers_so_many_open_tasks_and_goes_on_hearing_of_those() -> None:
    known = KnownTasks()
    for number in range(TASKS_MAX + 5):
        known.receive(heard(visit(f"t{number}")))
    assert len(known.open) == TASKS_MAX
    known.receive(heard(visit("t0"), TaskState.RUNNING, "r2"))
    assert known.open["t0"].robot == "r2"
    assert not known.may_be_asked
    known.receive(heard(visit("t0"), TaskState.DONE, "r2"))
    assert known.may_be_asked


def test_what_is_too_large_to_be_told_to_others_and_tasks_of_a_coordinator_itself_are_not_remembered() -> None:
    known = KnownTasks()
    for name, count in (("t1", 10), ("t2", 64)):
        task = visit(name, needs=("camera" * 10,) * count, after=("t" * 60,) * count)
        known.ask(TaskAsked(submission=TaskSubmission(task=task), at_ns=5))
    assert list(known.asked) == ["t1"]
    known.receive(heard(visit("explore-1", kind="explore")))
    assert "explore-1" not in known.open


def test_as_many_tasks_as_large_as_robots_remember_make_no_ballot_that_is_too_large(one: OneRobot) -> None:
    alone(one)
    for number in range(consensus_messages.ASKED_MAX):
        task = visit(f"{number:060}", needs=("camera" * 10,) * 60, after=tuple(f"{other:060}" for other in range(60)))
        one.consensus.submit(TaskSubmission(task=task), one.clock.now_ns())
    for number in range(consensus_messages.ENDS_MAX):
        one.consensus.known.done[f"{number:060}"] = TaskDone(id=f"{number:060}", robot="r" * 60, epoch=2**50)
    largest = max(len(consensus_messages.ROBOT_BALLOT.payloads.write(ballot)) for ballot in one.run(3.0))
    assert 50_000 < largest < 0.8 * consensus_messages.ROBOT_BALLOT.payloads.max_bytes


def test_a_task_is_not_ready_before_its_time_nor_at_its_deadline() -> None:
    known = KnownTasks()
    known.receive(heard(visit("t1", earliest_ns=10, deadline_ns=20)))
    assert [bool(known.ready(now_ns)) for now_ns in (9, 10, 19, 20)] == [False, True, True, False]


def test_what_a_mate_knows_to_have_ended_is_open_no_more(one: OneRobot) -> None:
    one.tell(visit("t1"))
    alone(one, ended=["t1"])
    assert one.consensus.known.open == {}
    assert one.begun == []
    with pytest.raises(CallError, match="t1 is refused: there was a task of that name"):
        one.consensus.submit(TaskSubmission(task=visit("t1")), one.clock.now_ns())


def test_a_mate_that_bids_for_a_task_is_told_that_it_has_ended(one: OneRobot) -> None:
    for state in (TaskState.QUEUED, TaskState.DONE):
        one.tell(visit("t1"), state)
        one.tell(visit("t2"), state)
    alone(one)
    assert {tuple(ballot.ended) for ballot in one.run(0.4)} == {()}
    bid = Bid(task="t1", robot="r2", score=5.0)
    said = Ballot(robot="r2", number=one.clock.now_ns() // 1000 + 900, bids=(bid,))
    one._ballots["r2"].put(TeamBallot(robot="r2", ballot=said))
    one.says = {"r3": {}}
    assert {tuple(ballot.ended) for ballot in one.run(0.4)} == {("t1",)}


def test_of_tasks_that_have_ended_the_last_ones_are_remembered() -> None:
    known = KnownTasks()
    known.record_ended(f"t{number}" for number in range(ENDED_MAX + 5))
    assert not known.has_ended("t4")
    assert known.has_ended("t5")
    known.receive(heard(visit("t5")))
    assert not known.has_ended("t5"), "a coordinator gives the name again"


def test_what_was_done_is_told_until_the_coordinator_has_noted_it(one: OneRobot) -> None:
    one.tell(visit("t1"))
    alone(one, done=[TaskDone(id="t1", robot="r2", epoch=4)])
    one.is_coordinated, one.says = True, {}
    one.run(2.5)
    told = one.run(5.0)
    assert 4 <= len(told) <= 6
    assert {done.id for ballot in told for done in ballot.done} == {"t1"}
    one.tell(visit("t1"), TaskState.DONE, "r2")
    one.run(1.5)
    assert one.run(5.0) == []


def test_a_robot_stops_what_a_mate_knows_to_have_ended(one: OneRobot) -> None:
    one.tell(visit("t1"))
    alone(one)
    assert one.consensus._begin(visit("t1"), one.clock.now_ns())
    one.says["r2"] = {"ended": ["t1"]}
    one.run(0.4)
    assert one.desk.facts.task is not None
    assert one.desk.facts.task.state is TaskState.CANCELLED


def test_what_a_mate_that_vanished_had_begun_by_itself_is_free_when_that_has_let_it_go(one: OneRobot) -> None:
    one.tell(visit("t1"))
    alone(one, held=[TaskHeld(id="t1", epoch=4)])
    one.run(1.0)
    del one.says["r2"]
    one.run(GOES_ON_S)
    assert one.consensus.is_leaderless
    assert not one.consensus._free(one.clock.now_ns())
    one.run(5.0)
    assert [task.id for task in one.consensus._free(one.clock.now_ns())] == ["t1"]
    one.says["r2"] = {}
    one.run(0.3)
    assert one.consensus._holders.of("t1", one.clock.now_ns()) == ""


def test_what_a_mate_says_to_hold_no_more_is_free_at_once(one: OneRobot) -> None:
    one.tell(visit("t1"))
    alone(one, held=[TaskHeld(id="t1", epoch=4)])
    one.says["r2"] = {}
    one.run(0.3)
    assert [task.id for task in one.consensus._free(one.clock.now_ns())] == ["t1"]


# -- claims of tasks ------------------------------------------------------------------------------------------------


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
    one.clock.advance_to(one.clock.now_ns() + to_ns(0.05))  # sooner than the next ballot is due
    one.consensus.step(one.clock.now_ns(), may_begin=True)
    assert [ballot.wants for ballot in one.run(0.0)] == ["t1"]
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
        claim.record_echo(teammate, [SeenBallot(robot="r1", number=number), SeenBallot(robot="r9", number=7)])
    assert not claim.is_confirmed({"r2", "r3"}, 3)
    claim.record_echo("r2", [SeenBallot(robot="r1", number=7)])
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


# -- the majority that allocates tasks ------------------------------------------------------------------------------

NEW = {"is_new": True}


def test_a_robot_is_new_until_a_coordinator_counts_it_as_up(one: OneRobot) -> None:
    one.is_coordinated = False
    assert all(said.is_new for said in one.run(2.0))
    one.is_coordinated = True
    one.run(1.0, team=("r2",))
    assert all(said.is_new for said in one.run(1.0, team=("r2",)))
    one.run(0.2)
    one.is_coordinated = False
    one.run(2.0)
    assert not any(said.is_new for said in one.run(1.0))


@pytest.mark.parametrize(
    ("was_coordinated", "says", "is_leaderless"),
    [
        (True, {"r2": NEW, "r3": {}}, True),
        (True, {"r2": NEW, "r3": NEW}, False),  # a teammate that has just begun is not counted
        (True, {"r2": NEW}, False),  # the coordinator may have given a task to the third robot
        (True, {"r2": {}}, True),
        (False, {"r2": {}, "r3": {}}, False),
        (False, {"r2": {"allocates": True}, "r3": {}}, True),  # one that has just begun joins those that allocate
        (False, {"r2": {**NEW, "allocates": True}, "r3": {}}, False),  # and does not believe a new one
        (False, {"r2": NEW, "r3": NEW}, True),  # a new team allocates
    ],
)
def test_majority_that_allocates_without_those_that_have_just_begun(
    one: OneRobot, was_coordinated, says, is_leaderless
):
    one.run(1.0 if was_coordinated else 0.0)
    one.is_coordinated, one.says = False, says
    one.tell(visit("t1"))
    one.run(3.0)
    assert one.consensus.is_leaderless is is_leaderless
    assert all(said.allocates is is_leaderless for said in one.run(1.0))
    assert is_leaderless or one.begun == []


def test_robots_tell_which_tasks_a_coordinator_gave_to_one_that_is_silent(one: OneRobot) -> None:
    """A teammate that was cut off meanwhile takes them for queued."""
    one.tell(visit("t1"), TaskState.RUNNING, "r3")
    one.tell(visit("t2"), TaskState.RUNNING, "r2")
    one.tell(visit("t3"))
    one.run(1.0)
    one.is_coordinated = False
    one.says = {"r2": {}}
    (told,) = one.run(3.0)[-1].absent
    assert (told.id, told.robot) == ("t1", "r3")
    assert 117.0 < told.remaining_s < 120.0
    one.is_coordinated = True
    assert [said.absent for said in one.run(2.0)[-1:]] == [[]]
    one.is_coordinated = False
    assert one.run(130.0)[-1].absent == []
