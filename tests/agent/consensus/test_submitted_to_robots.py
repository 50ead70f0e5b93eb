"""Tasks are submitted to robots while nobody coordinates: each is done once, and a coordinator that comes notes it."""

import msgspec
import pytest

from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.consensus_messages import ASKED_MAX, ASKED_REPORTED, TaskAcceptance
from robrain.protocol.messages.tasks.task_messages import TaskSubmission
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


def test_the_same_again_changes_nothing_and_another_of_that_name_is_refused_with_the_difference(
    lost: LostTeam,
) -> None:
    lost.kill()
    lost.run(3.0)
    taken = kept(lost, visit())
    assert submit(lost.robots[1], msgspec.structs.replace(visit(), by="bob")).task == taken.task
    why = why_refused(lost.robots[2], visit(place=Point2D(4.0, 5.0)))
    assert why == "there is another task t1: place.y_m is 3.0, not 5.0"


def test_what_can_never_be_done_fails_in_words_when_a_coordinator_notes_it(lost: LostTeam) -> None:
    lost.kill()
    lost.run(3.0)
    for robot in lost.robots:
        robot.refuses = {"t1"}
    kept(lost, visit(after=("t0",)))
    lost.revive()
    lost.coordinator.tasks.add(visit("t0").task)
    lost.coordinator.tasks.move("t0", TaskState.CANCELLED)
    lost.run(2.0)
    record = lost.journal.find("t1")
    assert record.state is TaskState.FAILED
    assert record.why == "t0, which it waits for, was not done: cancelled"


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
    assert why_refused(lost.robots[0], visit()).endswith("a coordinator is heard: submit it there")
    lost.kill()
    lost.robots[1].stopped = lost.robots[2].stopped = True
    lost.run(3.0)
    assert why_refused(lost.robots[0], visit()).endswith("it hears 1 of 3 robots, which is not more than half")


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
        (msgspec.structs.replace(visit(), deadline_in_s=-1.0), "deadline_in_s"),
        (visit(parameters={"speed": 1}), "speed"),
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
