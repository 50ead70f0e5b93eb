"""Tasks are cancelled at robots while nobody coordinates: none begins them, and a coordinator that comes notes it."""

import pytest

from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.consensus_messages import (
    CANCELLED_MAX,
    CANCELLED_TEXT_MAX,
    CancelAcceptance,
    TaskDropped,
)
from robrain.protocol.messages.tasks.task_messages import TaskRequest
from robrain.protocol.model.tasks.task import TaskState
from tests.agent.consensus.test_submitted_to_robots import ALL, halt, kept, visit, why_refused
from tests.coordinator.team_robots import LostTeam, TeamRobot

ASKED = TaskRequest(id="t1", by="ann", why="not needed")


def cancel(robot: TeamRobot, asked: TaskRequest = ASKED) -> CancelAcceptance:
    return robot.consensus.cancel(asked, robot._now_ns)


def why_not(robot: TeamRobot, asked: TaskRequest = ASKED) -> str:
    with pytest.raises(CallError) as refused:
        cancel(robot, asked)
    assert refused.value.code is ErrorCode.REFUSED
    return str(refused.value)


def cancelled(lost: LostTeam, asked: TaskRequest = ASKED, robot: int = 0) -> CancelAcceptance:
    """Cancel until no group of robots begins the task."""
    for _ in range(20):
        taken = cancel(lost.robots[robot], asked)
        if taken.is_kept:
            return taken
        lost.run(0.2)
    raise AssertionError(f"only {taken.known_to} knows of it")


def left_alone(lost: LostTeam, *, halted: bool) -> None:
    lost.kill()
    lost.run(3.0)
    halt(lost, halted=halted)


def test_it_is_kept_once_more_than_half_of_the_team_knows_and_no_robot_begins_it(lost: LostTeam) -> None:
    left_alone(lost, halted=True)
    task = kept(lost, visit()).task
    first = cancel(lost.robots[0])
    assert (first.known_to, first.is_kept) == (["r1"], False)
    lost.run(0.6)
    again = cancel(lost.robots[0])
    assert (again.known_to, again.is_kept, again.task) == (ALL, True, task)
    halt(lost, halted=False)
    lost.run(20.0)
    assert not lost.begun
    lost.revive()
    lost.run(3.0)
    record = lost.journal.find("t1")
    assert (record.state, record.by) == (TaskState.CANCELLED, "ann")
    assert (record.reason.values["by"], record.why) == ("ann", "cancelled by ann: not needed")
    assert not any(robot.consensus.known.dropped or robot.consensus.known.open for robot in lost.robots)
    lost.run(20.0)
    assert not lost.begun


@pytest.mark.parametrize("asked_of", [0, 1, 2])
def test_a_running_one_is_ended_at_whatever_robot_it_is_cancelled(lost: LostTeam, asked_of: int) -> None:
    for robot in lost.robots:
        robot.takes_s = 20.0
    left_alone(lost, halted=False)
    kept(lost, visit())
    lost.run(2.0)
    at_it = next(robot for robot in lost.robots if robot.running == "t1")
    cancelled(lost, robot=asked_of)
    lost.run(0.5)
    status = at_it.desk.status
    assert (status.id, status.state, status.why) == ("t1", TaskState.CANCELLED, "not needed")
    lost.run(30.0)
    assert (lost.begun, lost.done) == ({"t1": 1}, {})
    lost.revive()
    lost.run(3.0)
    assert lost.states()["t1"] is TaskState.CANCELLED


@pytest.mark.slow
@pytest.mark.parametrize("tenths", range(20, 40))
def test_one_that_is_done_at_that_moment_is_either_cancelled_or_done_as_the_client_is_told(
    lost: LostTeam, tenths: int
) -> None:
    for robot in lost.robots:
        robot.takes_s = 1.0
    left_alone(lost, halted=False)
    kept(lost, visit())
    lost.run(tenths / 10 - 1.0)
    other = next(number for number, robot in enumerate(lost.robots) if "t1" not in robot.begun)
    told, why = TaskState.CANCELLED, ""
    try:
        cancelled(lost, robot=other)
    except CallError as refused:
        told, why = TaskState.DONE, str(refused)
    assert why in ("", "task t1 has ended already: it is done")
    lost.run(5.0)
    assert lost.done["t1"] == (told is TaskState.DONE)
    lost.revive()
    lost.run(3.0)
    assert lost.states()["t1"] is told


def test_robots_refuse_an_offer_of_it_and_tell_a_coordinator_that_missed_it(lost: LostTeam) -> None:
    left_alone(lost, halted=True)
    kept(lost, visit())
    cancelled(lost)
    for robot in lost.robots:
        robot.consensus._publisher.put, robot.put_before = lambda _message: None, robot.consensus._publisher.put
    lost.revive()
    lost.coordinator.tasks.add(visit().task)
    halt(lost, halted=False)
    lost.run(4.0)
    assert not lost.begun
    assert lost.states()["t1"] is not TaskState.CANCELLED
    for robot in lost.robots:
        robot.consensus._publisher.put = robot.put_before
    lost.coordinator.tasks.republish_change(lost.journal.find("t1"))
    lost.run(1.0)
    assert lost.states()["t1"] is TaskState.CANCELLED
    assert not lost.begun


def test_a_task_that_waits_for_it_is_not_begun_and_fails_at_the_coordinator(lost: LostTeam) -> None:
    left_alone(lost, halted=True)
    kept(lost, visit())
    kept(lost, visit("t2", after=("t1",)))
    cancelled(lost)
    halt(lost, halted=False)
    lost.run(20.0)
    assert not lost.begun
    lost.revive()
    lost.run(5.0)
    assert lost.states() == {"t1": TaskState.CANCELLED, "t2": TaskState.FAILED}


def test_what_is_done_or_unknown_is_not_cancelled_and_what_is_cancelled_is_not_submitted(lost: LostTeam) -> None:
    left_alone(lost, halted=False)
    assert why_not(lost.robots[0]) == "r1 knows of no open task t1"
    kept(lost, visit())
    lost.run(20.0)
    assert lost.done == {"t1": 1}
    assert why_not(lost.robots[0]) == "task t1 has ended already: it is done"
    halt(lost, halted=True)
    kept(lost, visit("t2"))
    cancelled(lost, TaskRequest(id="t2"))
    assert why_refused(lost.robots[0], visit("t2")) == "task t2 is refused: it was cancelled"


def test_a_robot_that_hears_a_coordinator_or_less_than_half_of_the_team_refuses(lost: LostTeam) -> None:
    assert why_not(lost.robots[0]).endswith("a coordinator is heard: cancel it there")
    lost.kill()
    lost.robots[1].stopped = lost.robots[2].stopped = True
    lost.run(3.0)
    assert why_not(lost.robots[0]).endswith("it hears 1 of 3 robots, which is not more than half")


def test_robots_remember_so_many_and_long_words_are_cut(lost: LostTeam) -> None:
    left_alone(lost, halted=True)
    kept(lost, visit())
    known = lost.robots[0].consensus.known
    known.drop(TaskDropped(id=f"x{number}") for number in range(CANCELLED_MAX))
    assert "robots remember no more cancellations until a coordinator records them" in why_not(lost.robots[0])
    known.dropped.clear()
    cancel(lost.robots[0], TaskRequest(id="t1", why="x" * 1000))
    assert len(known.dropped["t1"].why) == CANCELLED_TEXT_MAX
