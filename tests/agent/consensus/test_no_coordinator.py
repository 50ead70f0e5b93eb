"""The coordinator is killed: robots do open tasks once, accept and cancel tasks, and report all of it."""

import msgspec
import pytest

from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.consensus_messages import (
    ASKED_MAX,
    ASKED_REPORTED,
    CANCELLED_MAX,
    CANCELLED_TEXT_MAX,
    CancelAcceptance,
    TaskAcceptance,
    TaskDropped,
)
from robrain.protocol.messages.tasks.task_messages import TaskRequest, TaskSubmission
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.coordinator.team_robots import LostTeam, TeamRobot

ALL = ["r1", "r2", "r3"]


def visit(name: str = "t1", **fields: object) -> TaskSubmission:
    task = Task(**{"id": name, "kind": "visit", "place": Point2D(4.0, 3.0), **fields})
    return TaskSubmission(task=task, by="ann")


def submit(robot: TeamRobot, asked: TaskSubmission) -> TaskAcceptance:
    return robot.consensus.submit(asked, robot._now_ns)


def kept(lost: LostTeam, asked: TaskSubmission, robot: int = 0) -> TaskAcceptance:
    """Submit until the task is safe."""
    for _ in range(20):
        taken = submit(lost.robots[robot], asked)
        if taken.is_kept:
            return taken
        lost.run(0.2)
    raise AssertionError(f"only {taken.known_to} has {asked.task.id}")


def halt(lost: LostTeam, *, halted: bool) -> None:
    for robot in lost.robots:
        robot.halted = halted


def why_refused(robot: TeamRobot, asked: TaskSubmission) -> str:
    with pytest.raises(CallError) as refused:
        submit(robot, asked)
    return str(refused.value)


def test_it_is_kept_once_more_than_half_of_the_team_has_it_and_is_done_once(lost: LostTeam) -> None:
    lost.kill()
    lost.run(3.0)
    first = submit(lost.robots[0], visit())
    assert (first.known_to, first.is_kept) == (["r1"], False)
    lost.run(0.6)
    again = submit(lost.robots[0], visit())
    assert (again.known_to, again.is_kept, again.task) == (ALL, True, first.task)
    lost.run(30.0)
    assert lost.done == {"t1": 1}
    lost.revive()
    lost.run(2.0)
    record = lost.journal.find("t1")
    assert (record.state, record.by) == (TaskState.DONE, "ann")
    lost.run(20.0)
    assert lost.done == {"t1": 1}
    assert not any(robot.consensus.known.asked or robot.consensus.known.done for robot in lost.robots)


def test_the_same_again_changes_nothing_and_another_of_that_name_is_refused_with_the_difference(lost: LostTeam) -> None:
    lost.kill()
    lost.run(3.0)
    taken = kept(lost, visit())
    assert submit(lost.robots[1], msgspec.structs.replace(visit(), by="bob")).task == taken.task
    why = why_refused(lost.robots[2], visit(place=Point2D(4.0, 5.0)))
    assert why == "there is another task t1: place.y_m is 3.0, not 5.0"


def test_a_robot_that_missed_the_end_is_told_again_and_does_not_begin_it(lost: LostTeam) -> None:
    lost.kill()
    lost.run(3.0)
    halt(lost, halted=True)
    kept(lost, visit())
    late = lost.robots[2]
    held = late.consensus.known.asked["t1"]
    halt(lost, halted=False)
    lost.revive()
    lost.run(20.0)
    assert not any(robot.consensus.known.asked for robot in lost.robots)
    assert lost.states()["t1"] is TaskState.DONE
    late.consensus.known.ask(held)  # as if it had heard nothing of that
    lost.run(1.0)
    assert not late.consensus.known.asked
    assert not late.consensus.known.open
    assert lost.done == {"t1": 1}


def test_a_robot_that_hears_a_coordinator_or_less_than_half_of_the_team_refuses(lost: LostTeam) -> None:
    robot = lost.robots[0]
    assert why_refused(robot, visit()).endswith("a coordinator is heard: submit it there")
    assert why_not(robot).endswith("a coordinator is heard: cancel it there")
    lost.kill()
    lost.robots[1].stopped = lost.robots[2].stopped = True
    lost.run(3.0)
    for why in (why_refused(robot, visit()), why_not(robot)):
        assert why.endswith("it hears 1 of 3 robots, which is not more than half")


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"kind": "juggle"}, "r1 has no behavior for tasks to juggle"),
        ({"kind": "explore"}, "only a coordinator makes tasks to explore"),
        ({"robots": 2}, "it takes 2 robots at a time, which only a coordinator brings together"),
        ({"deadline_ns": 1}, "its deadline was "),
    ],
)
def test_what_robots_cannot_do_by_themselves_is_refused_in_words(
    lost: LostTeam, fields: dict[str, object], why: str
) -> None:
    lost.kill()
    lost.run(3.0)
    assert why in why_refused(lost.robots[0], visit(**fields))


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        (visit("a/b"), "a/b"),
        (
            visit(needs=("camera" * 10,) * 64, after=("t" * 60,) * 64),
            r"t1: expected at most 8192 bytes of JSON, got 8\d{3}",
        ),
    ],
)
def test_a_submission_that_makes_no_sense_names_its_key(lost: LostTeam, asked: TaskSubmission, why: str) -> None:
    lost.kill()
    lost.run(3.0)
    with pytest.raises(CallError, match=why) as refused:
        submit(lost.robots[0], asked)
    assert refused.value.code is ErrorCode.BAD_ARGUMENTS


@pytest.mark.slow
def test_robots_remember_so_many_and_no_more_and_all_of_them_come_to_all(lost: LostTeam) -> None:
    lost.kill()
    lost.run(3.0)
    halt(lost, halted=True)
    names = [f"t{number}" for number in range(ASKED_MAX)]
    for name in names:
        submit(lost.robots[0], visit(name))
    assert "no more tasks until a coordinator records them" in why_refused(lost.robots[0], visit("one-more"))
    lost.run(0.2 * (ASKED_MAX / ASKED_REPORTED + 2))
    assert all(sorted(robot.consensus.known.asked) == sorted(names) for robot in lost.robots)
    lost.revive()
    lost.run(5.0)
    assert sorted(lost.states()) == sorted(names)
    assert not any(robot.consensus.known.asked for robot in lost.robots)


# -- cancelling tasks -----------------------------------------------------------------------------------------------

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
@pytest.mark.parametrize("tenths", range(20, 40, 2))
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


def test_robots_remember_so_many_and_long_words_are_cut(lost: LostTeam) -> None:
    left_alone(lost, halted=True)
    kept(lost, visit())
    known = lost.robots[0].consensus.known
    known.drop(TaskDropped(id=f"x{number}") for number in range(CANCELLED_MAX))
    assert "robots remember no more cancellations until a coordinator records them" in why_not(lost.robots[0])
    known.dropped.clear()
    cancel(lost.robots[0], TaskRequest(id="t1", why="x" * 1000))
    assert len(known.dropped["t1"].why) == CANCELLED_TEXT_MAX


# -- tasks of the coordinator ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("after_s", [0.5, 8.0, 40.0])
def test_a_coordinator_that_returns_takes_in_what_was_done_and_nothing_is_done_twice(
    lost: LostTeam, after_s: float
) -> None:
    names = lost.visits(15)
    lost.run(1.0)
    lost.kill()
    lost.run(after_s)
    done_before = set(lost.done)
    lost.revive()
    lost.run(2.0)
    states = lost.states()
    assert all(states[name] is TaskState.DONE for name in done_before)
    lost.run(80.0)
    assert lost.states() == dict.fromkeys(names, TaskState.DONE)
    assert lost.done == dict.fromkeys(names, 1)
    assert after_s < 40.0 or all(robot.done for robot in lost.robots)  # robots alone share the work


def test_running_tasks_become_those_of_the_coordinator_that_returns(lost: LostTeam) -> None:
    for robot in lost.robots:
        robot.takes_s = 20.0
    lost.visits(6)
    lost.run(1.0)
    lost.kill()
    lost.run(24.0)
    running = {robot.running: robot.name for robot in lost.robots}
    assert len(running) == 3
    lost.revive()
    lost.run(1.0)
    records = {name: lost.journal.find(name) for name in running}
    assert {name: (record.state, record.robot) for name, record in records.items()} == {
        name: (TaskState.RUNNING, robot) for name, robot in running.items()
    }
    assert not any(robot.withdrawals for robot in lost.robots)


def test_a_robot_cut_off_from_all_begins_nothing_and_goes_on_with_what_it_does(lost: LostTeam) -> None:
    for robot in lost.robots:
        robot.takes_s = 10.0
    names = lost.visits(1)
    lost.run(1.0)
    alone = next(robot for robot in lost.robots if robot.running)
    task = alone.running
    alone.isolated = True
    lost.run(30.0)
    assert alone.done == [task]
    assert not alone.consensus.is_leaderless
    alone.isolated = False
    lost.run(20.0)
    assert lost.done == dict.fromkeys(names, 1)


def test_nobody_takes_queued_tasks_while_a_mate_hears_the_coordinator(lost: LostTeam) -> None:
    for robot in lost.robots:
        robot.takes_s = 3.0
    lost.robots[0].hears_only_mates = lost.robots[1].hears_only_mates = True
    lost.run(3.0)
    lost.visits(6)
    for _ in range(100):
        lost.run(0.1)
        assert not any(robot.consensus.is_leaderless for robot in lost.robots)
    lost.kill()
    lost.run(2.0)
    assert all(robot.consensus.is_leaderless for robot in lost.robots)


def test_a_task_that_names_a_robot_is_begun_by_that_robot_alone(lost: LostTeam) -> None:
    lost.kill()
    lost.run(3.0)
    for name, needs in (("t1", ("r2",)), ("t2", ("r3",)), ("t3", ("r9",))):
        kept(lost, visit(name, needs=needs))
    lost.run(30.0)
    assert [robot.begun for robot in lost.robots] == [[], ["t1"], ["t2"]]
