"""No task is lost, none is at two robots, none is done twice: what keeps these invariants, and what breaks them."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.coordinator.tasks.task_book import LEGAL
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.recording.invariants import task_invariants
from robrain.recording.invariants.invariant import Invariant, InvariantState, MissingEvidence
from tests.recording.invariants.team_script import TeamScript, at_task

QUEUED, OFFERED, RUNNING = TaskState.QUEUED, TaskState.OFFERED, TaskState.RUNNING
DONE, CANCELLED, LOST_CONTACT = TaskState.DONE, TaskState.CANCELLED, TaskState.LOST_CONTACT


def given_to(robot: str, task: str = "door", epoch: int = 1) -> TeamScript:
    """A task that has just been given to a robot, which does it."""
    script = TeamScript()
    script.states[robot] = {}
    script.pass_time(1.0)
    script.event(task, QUEUED)
    script.event(task, OFFERED, robot, epoch)
    script.event(task, RUNNING, robot, epoch)
    script.tasks_open = 1
    script.states[robot] = at_task(task, epoch)
    return script


def done(script: TeamScript, robot: str = "r1", task: str = "door", epoch: int = 1) -> TeamScript:
    """The same, when the robot has done it."""
    script.states[robot] = at_task(task, epoch, DONE)
    script.pass_time(0.1)
    script.event(task, DONE, robot, epoch)
    script.tasks_open = 0
    script.pass_time(1.0)
    return script


# -- lost -------------------------------------------------------------------------------------------------------


def test_a_task_that_the_coordinator_no_longer_counts_is_lost_and_named() -> None:
    script = given_to("r1", "door")
    script.pass_time(1.0)
    script.event("corner", QUEUED)
    script.tasks_open = 2
    script.pass_time(3.0)
    script.event("door", QUEUED)  # given back, and forgotten
    script.states["r1"] = {}
    script.tasks_open = 1
    script.pass_time(3.0)
    assert script.found(Invariant.TASK_KEPT) == [{"code": "tasks_forgotten", "missing": 1, "tasks": ["door"], "of": 1}]
    [breach] = script.ruling(Invariant.TASK_KEPT).breaches
    assert breach.text.endswith("the coordinator no longer knows door, which has not ended")
    assert 5.0 < breach.time_s < 7.0


def test_changes_that_may_have_gone_unheard_with_summaries_are_no_lost_tasks() -> None:
    # A recorder that takes them for messages from the future lacks both.
    def told_with(seqs: list[int]) -> TeamScript:
        script = TeamScript()
        script.send(TeamState(robots=[], tasks_open=0, seq=0))
        script.event("door", QUEUED)
        for at, seq in enumerate(seqs):
            script.now_s += 0.5
            script.send(TeamState(robots=[], tasks_open=1 if at == 0 else 0, seq=seq))
        return script

    whole, lacking = told_with(list(range(1, 12))), told_with([1, *range(9, 20)])
    assert whole.codes(Invariant.TASK_KEPT) == ["tasks_forgotten"]
    assert lacking.found(Invariant.TASK_KEPT) == []
    assert lacking.ruling(Invariant.TASK_KEPT).missing is MissingEvidence.EVENTS
    lacking.event("window", QUEUED)  # numbered without a gap: nothing was missed
    for seq in range(20, 26):
        lacking.now_s += 0.5
        lacking.send(TeamState(robots=[], tasks_open=1, seq=seq))
    assert lacking.codes(Invariant.TASK_KEPT) == ["tasks_forgotten"]


def test_a_count_that_is_late_by_a_summary_loses_no_task() -> None:
    script = given_to("r1")
    script.tasks_open = 0
    script.pass_time(0.6)
    script.tasks_open = 1
    script.pass_time(5.0)
    assert script.found(Invariant.TASK_KEPT) == []


def test_a_task_whose_robot_does_not_report_it_is_abandoned() -> None:
    script = given_to("r1", epoch=7)
    script.pass_time(3.0)
    script.states["r1"] = {}  # restarted, and the coordinator does not give the task back
    script.pass_time(9.0)
    assert script.found(Invariant.TASK_KEPT) == []
    script.pass_time(4.0)
    [found] = script.found(Invariant.TASK_KEPT)
    assert (found["task"], found["robot"], found["state"]) == ("door", "r1", RUNNING)


def test_a_task_that_ended_at_its_robot_and_not_in_the_book_is_abandoned() -> None:
    script = given_to("r1")
    script.states["r1"] = at_task("door", 1, DONE)
    script.pass_time(12.0)
    assert script.codes(Invariant.TASK_KEPT) == ["task_abandoned"]


def test_a_task_of_a_silent_robot_is_abandoned_unless_it_is_given_back() -> None:
    script = given_to("r1")
    script.pass_time(1.0)
    del script.states["r1"]
    script.up = {"r1": False}
    script.pass_time(1.5)
    script.event("door", LOST_CONTACT, "r1", 1)
    script.pass_time(15.0)
    assert script.codes(Invariant.TASK_KEPT) == ["task_abandoned"]


def test_a_held_task_is_not_abandoned() -> None:
    script = given_to("r1", "door")
    script.event("next", QUEUED)
    script.event("next", OFFERED, "r1", 2)
    script.tasks_open = 2
    script.states["r1"] |= {"next_task": TaskStatus(id="next", epoch=2, state=OFFERED)}
    script.pass_time(30.0)
    assert script.found(Invariant.TASK_KEPT) == []


def test_a_task_is_not_abandoned_while_the_coordinator_is_away() -> None:
    script = given_to("r1")
    script.pass_time(2.0)
    script.states["r1"] = {}
    script.has_coordinator = False
    script.pass_time(30.0)
    script.has_coordinator = True
    script.pass_time(1.0)
    script.event("door", QUEUED)
    script.pass_time(1.0)
    assert script.found(Invariant.TASK_KEPT) == []


@pytest.mark.parametrize(
    ("first_change", "tasks_open", "missing"),
    [
        (1, 1, None),  # from the first change of all
        (5, 3, MissingEvidence.START),  # of the other two nothing is known
    ],
)
def test_a_recording_that_begins_in_mid_run_does_not_say_whether_tasks_are_lost(
    first_change: int, tasks_open: int, missing: MissingEvidence | None
) -> None:
    script = TeamScript()
    script.event("door", QUEUED, change=first_change)
    script.tasks_open = tasks_open
    script.pass_time(5.0)
    script.tasks_open = 0 if missing else 1
    script.pass_time(5.0)
    ruling = script.ruling(Invariant.TASK_KEPT)
    assert ruling.missing is missing
    assert ruling.state is (InvariantState.NOT_JUDGED if missing else InvariantState.KEPT)


def test_changes_that_are_missing_leave_the_invariant_unjudged() -> None:
    script = given_to("r1")
    script.pass_time(1.0)
    script.event("corner", QUEUED, change=5)
    script.tasks_open = 1  # what the missing changes said is not known
    script.pass_time(5.0)
    for invariant in (Invariant.TASK_KEPT, Invariant.TASK_ONCE):
        ruling = script.ruling(invariant)
        assert (ruling.state, ruling.missing) == (InvariantState.NOT_JUDGED, MissingEvidence.EVENTS)
        assert ruling.reason


def test_without_a_coordinator_no_invariant_of_its_book_is_judged() -> None:
    ruling = TeamScript().ruling(Invariant.TASK_KEPT)
    assert (ruling.state, ruling.missing) == (InvariantState.NOT_JUDGED, MissingEvidence.SUMMARIES)
    assert TeamScript().ruling(Invariant.TASK_ONCE).missing is MissingEvidence.TASKS
    assert TeamScript().ruling(Invariant.TASK_AT_ONE).missing is MissingEvidence.ROBOTS


# -- at two robots ----------------------------------------------------------------------------------------------


def test_two_robots_may_be_at_a_task_for_a_lease_and_no_longer() -> None:
    script = given_to("r1")
    script.pass_time(3.0)
    script.states["r2"] = at_task("door", 2)
    script.pass_time(2.0)
    assert script.found(Invariant.TASK_AT_ONE) == []
    script.pass_time(1.0)
    [found] = script.found(Invariant.TASK_AT_ONE)
    assert (found["task"], found["robots"], found["epochs"]) == ("door", ("r1", "r2"), (1, 2))
    assert found["for_s"] == pytest.approx(2.1)


def test_the_time_of_a_robot_that_comes_back_begins_anew() -> None:
    script = given_to("r1")
    script.pass_time(3.0)
    script.states = {"r2": at_task("door", 2)}
    script.pass_time(10.0)
    script.states["r1"] = at_task("door", 1)  # it was stopped, and hears now that it has lost the task
    script.pass_time(1.0)
    script.states["r1"] = at_task("door", 1, CANCELLED)
    script.pass_time(5.0)
    assert script.found(Invariant.TASK_AT_ONE) == []


def test_robots_that_hold_a_task_or_have_ended_it_are_not_at_it() -> None:
    script = given_to("r1")
    script.states["r2"] = {"next_task": TaskStatus(id="door", epoch=2, state=OFFERED)}
    script.states["r3"] = at_task("door", 3, DONE)
    script.pass_time(10.0)
    assert script.found(Invariant.TASK_AT_ONE) == []


# -- twice ------------------------------------------------------------------------------------------------------


def test_a_second_end_with_a_number_of_its_own_is_a_task_done_twice() -> None:
    script = done(given_to("r1"))
    script.event("door", DONE, "r2", 5)
    [found] = script.found(Invariant.TASK_ONCE)
    assert (found["task"], found["robot"], found["changes"]) == ("door", "r2", (4, 5))


def test_a_breach_counts_although_changes_are_missing() -> None:
    script = done(given_to("r1"))
    script.event("door", DONE, "r2", 5)
    script.event("corner", QUEUED, change=9)
    ruling = script.ruling(Invariant.TASK_ONCE)
    assert (ruling.state, ruling.missing) == (InvariantState.BROKEN, MissingEvidence.EVENTS)


def test_a_coordinator_that_begins_anew_and_does_a_task_again_does_it_twice() -> None:
    script = done(given_to("r1"))
    script.pass_time(5.0)
    for change, state in enumerate((QUEUED, OFFERED, RUNNING, DONE), 1):
        script.pass_time(0.5)
        script.event("door", state, "r1" if change > 1 else "", 8 if change > 1 else 0, change=change)
    assert script.codes(Invariant.TASK_ONCE) == ["reopened", "done_again"]


def test_a_robot_may_go_on_with_a_task_that_was_done_for_a_lease_and_no_longer() -> None:
    script = given_to("r1")
    script.states["r2"] = at_task("door", 2)
    script.pass_time(0.2)
    done(script)
    script.pass_time(0.5)
    assert script.found(Invariant.TASK_ONCE) == []
    script.pass_time(5.0)
    [found] = script.found(Invariant.TASK_ONCE)
    assert (found["task"], found["robot"]) == ("door", "r2")


# -- any history ------------------------------------------------------------------------------------------------


@st.composite
def histories(draw: Any) -> list[tuple[str, TaskState]]:
    """Legal changes of some tasks, in any order."""
    states: dict[str, TaskState | None] = dict.fromkeys("abc")
    changes = []
    for _ in range(draw(st.integers(1, 25))):
        task = draw(st.sampled_from("abc"))
        legal = sorted(LEGAL[states[task]])
        if not legal:
            continue
        states[task] = draw(st.sampled_from(legal))
        changes.append((task, states[task]))
    return changes


def play(changes: list[tuple[str, TaskState]], again: set[int]) -> TeamScript:
    script = TeamScript()
    script.pass_time(0.5)
    open_tasks: set[str] = set()
    for number, (task, state) in enumerate(changes):
        script.event(task, state)
        (open_tasks.discard if state.ended else open_tasks.add)(task)
        script.tasks_open = len(open_tasks)
        if number in again:
            script.event(task, state, change=script.change)
        script.pass_time(0.5)
    return script


@pytest.mark.slow
@settings(max_examples=30)
@given(histories(), st.sets(st.integers(0, 24)))
def test_no_legal_history_breaks_an_invariant_however_often_its_changes_are_repeated(
    changes: list[tuple[str, TaskState]], again: set[int]
) -> None:
    script = play(changes, again)
    script.pass_time(5.0)
    for invariant in (Invariant.TASK_KEPT, Invariant.TASK_ONCE):
        ruling = script.ruling(invariant)
        assert ruling.state is InvariantState.KEPT, ruling.breaches
    assert script.ruling(Invariant.TASK_KEPT).cases == len({task for task, _ in changes})


@pytest.mark.slow
@settings(max_examples=30)
@given(histories(), st.integers(1, 3))
def test_any_task_that_disappears_from_the_count_is_found(changes: list[tuple[str, TaskState]], lost: int) -> None:
    script = play(changes, set())
    lost = min(lost, script.tasks_open)
    script.tasks_open -= lost
    script.pass_time(5.0)
    found = script.found(Invariant.TASK_KEPT)
    assert sum(one["missing"] for one in found) == lost


def test_what_is_remembered_of_ended_tasks_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(task_invariants, "ENDED_KEPT", 100)
    changes = task_invariants.TaskChanges()
    for number in range(150):
        task = Task(id=f"t{number}", kind="visit", place=Point2D(0.0, 0.0))
        changes.handle(TaskEvent(task=task, state=DONE, change=number + 1, stamp_ns=number), number)
    assert (len(changes.ended), changes.tasks) == (100, 150)
