"""Submitting, cancelling and looking at tasks over the wire."""

import pytest

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.task_messages import (
    TASK_CANCEL,
    TASK_EXPLAIN,
    TASK_GET,
    TASK_LIST,
    TaskExplanation,
    TaskFilter,
    TaskRecord,
    TaskRequest,
)
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState


def visit(task_id="t1", x_m=6.0, y_m=4.0, **fields):
    return Task(id=task_id, kind="visit", place=Point2D(x_m, y_m), **fields)


def refused(team, task, **fields) -> CallError:
    with pytest.raises(CallError) as caught:
        team.submit(task, **fields)
    return caught.value


# -- submit ---------------------------------------------------------------------------------------------------


def test_a_submitted_task_goes_to_the_nearest_robot_and_is_done(team):
    far, near = team.robot("r1", 3.0), team.settle("r2", 7.0)
    record = team.submit(visit(priority=3.0), by="ann")
    assert (record.state, record.by, record.task.priority) == (TaskState.QUEUED, "ann", 3.0)
    team.run(0.1)
    assert [offer.task.id for offer in near.offers] == ["t1"]
    assert far.offers == []
    near.end(TaskState.DONE, "there", off_m=0.1)
    team.run(0.2)
    found = team.ask(TASK_GET, TaskRequest(id="t1"))
    assert (found.state, found.robot, found.result, found.why) == (TaskState.DONE, "r2", {"off_m": 0.1}, "there")
    assert team.ask(TASK_LIST, TaskFilter(), list[TaskRecord]) == [found]
    assert team.history("t1") == [TaskState.QUEUED, TaskState.OFFERED, TaskState.RUNNING, TaskState.DONE]


def test_the_same_submission_again_has_the_same_answer_whatever_became_of_the_task(team):
    robot = team.settle()
    first = team.submit(visit(), by="ann", deadline_in_s=60.0)
    assert team.submit(visit(), by="ann", deadline_in_s=60.0) == first
    team.run(2.0)
    assert team.submit(visit(), by="bob", deadline_in_s=60.0).state is TaskState.RUNNING  # who asks is no matter
    robot.end(TaskState.DONE)
    team.run(0.2)
    done = team.submit(visit(), deadline_in_s=60.0)
    assert (done.state, done.task) == (TaskState.DONE, first.task)
    assert len(robot.offers) == 1
    assert team.history("t1").count(TaskState.QUEUED) == 1


def test_another_task_of_the_same_id_is_refused_with_the_difference(team):
    team.submit(visit(priority=2.0))
    error = refused(team, visit(priority=2.0, y_m=5.0, needs=("camera",)))
    assert error.code is ErrorCode.REFUSED
    assert error.message == 'there is another task t1: needs is unset, not ["camera"], place.y_m is 4.0, not 5.0'
    assert refused(team, Task(id="t1", kind="explore", place=Point2D(6.0, 4.0))).message.startswith(
        "there is another task t1: "
    )
    assert team.ask(TASK_GET, TaskRequest(id="t1")).task.needs == ()


def test_what_can_never_be_done_is_refused_at_once(team):
    team.settle()
    for task, words in (
        (visit(x_m=-3.0), "task t1 is refused: (-3, 4) is outside of the map"),
        (visit(after=("t1",)), "task t1 is refused: it would wait for itself"),
        (visit(after=("t9",)), "task t1 is refused: it is to wait for task t9, and there is none of that name"),
    ):
        error = refused(team, task)
        assert error.code is ErrorCode.REFUSED
        assert error.message.startswith(words)
    assert team.states() == {}
    assert team.submit(visit()).state is TaskState.QUEUED  # a refusal leaves the name free


def test_a_task_waits_for_those_before_it_and_for_its_time(team):
    robot = team.settle()
    team.submit(visit("first"))
    team.submit(visit("second", after=("first",)))
    team.submit(visit("later"), earliest_in_s=3.0)
    team.run(1.5)
    found = team.ask(TASK_EXPLAIN, TaskRequest(id="second"), TaskExplanation)
    assert found.now == "Queued. first, which it waits for, is running."
    robot.end(TaskState.DONE)
    team.run(0.2)
    assert [offer.task.id for offer in robot.offers] == ["first", "second"]
    robot.end(TaskState.DONE)
    team.run(0.2)
    assert len(robot.offers) == 2
    team.run(2.0)
    assert robot.offers[-1].task.id == "later"


def test_those_that_wait_for_a_failed_task_are_cancelled_one_after_the_other(team):
    team.submit(visit("a"))
    team.submit(visit("b", after=("a",)))
    team.submit(visit("c", after=("b",)))
    team.ask(TASK_CANCEL, TaskRequest(id="a", by="ann"))
    team.run(0.1)
    assert set(team.states().values()) == {TaskState.CANCELLED}
    assert team.why("b") == "a, which it waits for, was not done: cancelled, cancelled by ann"
    assert refused(team, visit("d", after=("a",))).detail.startswith("a, which it waits for, was not done")


def test_that_nobody_can_do_a_task_is_told_when_it_turns_out_and_not_tried(team):
    team.submit(visit(needs=("arm",)))  # no robot has come yet
    robot = team.robot("r1")
    team.closed_room()
    team.run(3.0)
    assert robot.offers == []
    assert team.why("t1") == "no robot of the team has arm"
    assert team.history("t1") == [TaskState.QUEUED, TaskState.QUEUED]
    robot.plugins.append("arm")
    team.run(12.0)
    assert team.states() == {"t1": TaskState.RUNNING}


# -- cancel ---------------------------------------------------------------------------------------------------


def test_a_running_task_is_withdrawn_from_its_robot(team):
    robot = team.settle()
    team.submit(visit())
    team.run(1.0)
    epoch = robot.task.epoch
    team.ask(TASK_CANCEL, TaskRequest(id="t1", by="ann"))
    team.run(0.04)
    assert [(one.id, one.epoch, one.why) for one in robot.withdrawals] == [("t1", epoch, "cancelled by ann")]
    assert robot.task.state is TaskState.CANCELLED
    team.run(2.0)
    assert len(robot.withdrawals) == 1
    assert team.history("t1")[-1] is TaskState.CANCELLED


def test_what_has_ended_or_never_was_cannot_be_cancelled(team):
    robot = team.settle()
    team.submit(visit())
    team.run(0.2)
    robot.end(TaskState.DONE)
    team.run(0.2)
    with pytest.raises(CallError, match="task t1 has ended already: it is done"):
        team.ask(TASK_CANCEL, TaskRequest(id="t1"))
    with pytest.raises(CallError, match="there is no task t9"):
        team.ask(TASK_CANCEL, TaskRequest(id="t9"))
    assert team.states() == {"t1": TaskState.DONE}


# -- list, get, why -------------------------------------------------------------------------------------------


def test_why_says_how_each_robot_was_judged_and_what_happened(team):
    near, blind = team.robot("r1", 5.0), team.robot("r2", 6.0)
    blind.plugins = ["explore"]
    lost = team.settle("r3", 6.0)
    lost.speaks = False
    team.run(1.5)
    team.submit(visit(), by="ann")
    team.run(0.2)
    found = team.ask(TASK_EXPLAIN, TaskRequest(id="t1"), TaskExplanation)
    assert found.now == "Running at r1."
    assert [(verdict.robot, verdict.chosen, verdict.refusal.split(" 1.")[0]) for verdict in found.robots] == [
        ("r1", True, ""),
        ("r2", False, "has no visit"),
        ("r3", False, "lost contact"),
    ]
    assert found.robots[0].distance_m == 1.0
    assert found.decided_ns > 0
    assert [change.state for change in found.changes] == [TaskState.QUEUED, TaskState.OFFERED, TaskState.RUNNING]
    near.halted = True
    team.submit(visit("t2"))
    team.run(0.6)
    found = team.ask(TASK_EXPLAIN, TaskRequest(id="t2"), TaskExplanation)
    assert found.reason.code == "waits_for_robot"
    assert found.robots[0].refusal == "is halted"


def test_why_a_task_is_done_names_the_robot_that_did_it_and_not_the_one_that_was_chosen_last(team):
    """A robot that was lost did it all the same, and another had got it meanwhile."""
    first = team.settle("r1", 5.5)
    team.submit(visit())
    team.run(0.2)
    assert team.ask(TASK_EXPLAIN, TaskRequest(id="t1"), TaskExplanation).robots[0].chosen
    second = team.robot("r2", 8.0)
    first.speaks = False
    team.run(3.0)
    assert second.offers[-1].task.id == "t1"
    first.end(TaskState.DONE)
    first.speaks = True
    team.run(1.0)
    found = team.ask(TASK_EXPLAIN, TaskRequest(id="t1"), TaskExplanation)
    assert (found.record.state, found.record.robot) == (TaskState.DONE, "r1")
    assert [(verdict.robot, verdict.chosen, verdict.refusal) for verdict in found.robots] == [("r1", True, "")]


# -- the disk ---------------------------------------------------------------------------------------------------


def test_on_a_full_disk_new_tasks_are_refused_and_the_rest_goes_on(team, monkeypatch, caplog):
    robot = team.settle()
    team.submit(visit("before"))
    team.run(0.5)
    team.submit(visit("late"), earliest_in_s=2.0, deadline_in_s=3.0)
    journal = team.coordinator.tasks.journal

    def full(*_arguments):
        raise JournalUnwritable(None, "cannot be written: database or disk is full")

    with monkeypatch.context() as disk:
        for name in ("accept", "change", "new_epoch"):
            disk.setattr(journal, name, full)
        error = refused(team, visit("new"))
        assert error.code is ErrorCode.REFUSED
        assert "disk is full" in error.message
        robot.end(TaskState.DONE)
        team.run(5.0)
        assert team.states() == {
            "before": TaskState.RUNNING,
            "late": TaskState.QUEUED,
        }  # what is not written is not told either
        assert team.history("before")[-1] is TaskState.RUNNING
        assert len([one for one in caplog.records if "disk is full" in one.getMessage()]) == 1
        assert team.summary.robots[0].up
    team.run(0.3)
    assert team.states() == {"before": TaskState.DONE, "late": TaskState.FAILED}
    assert team.submit(visit("new")).state is TaskState.QUEUED


def test_on_a_full_disk_a_task_is_not_cancelled_and_who_asks_is_told_so(team, monkeypatch):
    robot = team.settle()
    team.submit(visit())
    team.run(0.5)

    def full(*_arguments):
        raise JournalUnwritable(None, "cannot be written: database or disk is full")

    with monkeypatch.context() as disk:
        disk.setattr(team.coordinator.tasks.journal, "change", full)
        with pytest.raises(CallError, match=r"task t1 is not cancelled: .*disk is full") as caught:
            team.ask(TASK_CANCEL, TaskRequest(id="t1"))
    assert caught.value.code is ErrorCode.REFUSED
    team.run(1.0)
    assert (team.states(), robot.withdrawals) == ({"t1": TaskState.RUNNING}, [])
    assert team.ask(TASK_CANCEL, TaskRequest(id="t1")).state is TaskState.CANCELLED
