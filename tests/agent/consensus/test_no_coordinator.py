"""The coordinator is killed: robots with consensus do what is open, each task once, and tell one that returns."""

import pytest

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.coordinator.team_robots import LostTeam


def test_orphaned_tasks_are_done_once_each(lost: LostTeam) -> None:
    names = lost.visits(12)
    lost.run(1.0)
    lost.kill()
    lost.run(60.0)
    assert lost.done == dict.fromkeys(names, 1)
    assert lost.begun == dict.fromkeys(names, 1)
    assert all(robot.done for robot in lost.robots)


@pytest.mark.slow
@pytest.mark.parametrize("after_s", [0.5, 3.0, 8.0, 14.0, 40.0])
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


def test_without_consensus_robots_drop_their_tasks_as_before(lost: LostTeam) -> None:
    from tests.coordinator.desk_robots import DeskRobot

    plain = DeskRobot(lost, "r9", 8.0)
    plain.takes_s = 30.0
    lost.run(1.0)
    lost.submit(Task(id="t0", kind="visit", place=Point2D(8.0, 4.0)))
    lost.run(1.0)
    holder = next(robot for robot in lost.robots if robot.running == "t0")
    assert holder is plain
    lost.kill()
    lost.run(2.0)
    assert plain.running == ""
