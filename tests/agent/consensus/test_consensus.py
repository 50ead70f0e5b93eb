"""One robot's part in allocation without a coordinator, with the others' words written by hand."""

from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from robrain.agent.consensus.consensus import AGAIN_NS, REPORTING
from robrain.agent.consensus.holders import GOES_ON_S
from robrain.agent.consensus.known_tasks import ENDED_MAX, TASKS_MAX, KnownTasks
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError
from robrain.protocol.messages.tasks.consensus_messages import (
    ASKED_MAX,
    ENDS_MAX,
    TaskAsked,
    TaskDone,
    TaskHeld,
    TaskKnown,
    TeamBallot,
)
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.task_messages import TaskSubmission
from robrain.protocol.model.ballot import Ballot, Bid
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import Occupied
from robrain.protocol.table.topics import ROBOT_BALLOT
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
    assert one.consensus.offer_refusal("t1", begun_ns) == REPORTING
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


# -- what tasks are worth ------------------------------------------------------------------------------------------


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


def test_tasks_that_a_coordinator_makes_for_itself_are_not_remembered() -> None:
    known = KnownTasks()
    known.receive(heard(visit("explore-1", kind="explore")))
    assert known.open == {}


def test_what_is_too_large_to_be_told_to_others_is_not_remembered() -> None:
    known = KnownTasks()
    for name, count in (("t1", 10), ("t2", 64)):
        task = visit(name, needs=("camera" * 10,) * count, after=("t" * 60,) * count)
        known.ask(TaskAsked(submission=TaskSubmission(task=task), at_ns=5))
    assert list(known.asked) == ["t1"]


def test_as_many_tasks_as_large_as_robots_remember_make_no_ballot_that_is_too_large(one: OneRobot) -> None:
    alone(one)
    for number in range(ASKED_MAX):
        task = visit(f"{number:060}", needs=("camera" * 10,) * 60, after=tuple(f"{other:060}" for other in range(60)))
        one.consensus.submit(TaskSubmission(task=task), one.clock.now_ns())
    for number in range(ENDS_MAX):
        one.consensus.known.done[f"{number:060}"] = TaskDone(id=f"{number:060}", robot="r" * 60, epoch=2**50)
    largest = max(len(ROBOT_BALLOT.payloads.write(ballot)) for ballot in one.run(3.0))
    assert 50_000 < largest < 0.8 * ROBOT_BALLOT.payloads.max_bytes


def test_a_task_is_not_ready_before_its_time_nor_at_its_deadline() -> None:
    known = KnownTasks()
    known.receive(heard(visit("t1", earliest_ns=10, deadline_ns=20)))
    assert [bool(known.ready(now_ns)) for now_ns in (9, 10, 19, 20)] == [False, True, True, False]


def test_a_task_is_not_ready_before_what_comes_before_it_is_known_to_have_ended() -> None:
    known = KnownTasks()
    known.receive(heard(visit("t2", after=("t1",))))
    assert known.ready(0) == [], "a robot that began later has never heard of t1"
    known.receive(heard(visit("t1")))
    assert [task.id for task in known.ready(0)] == ["t1"]
    known.record_done([TaskDone(id="t1", robot="r2", epoch=1)])
    assert [task.id for task in known.ready(0)] == ["t2"]
    known.receive(heard(visit("t1"), TaskState.DONE))
    assert [task.id for task in known.ready(0)] == ["t2"]


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
