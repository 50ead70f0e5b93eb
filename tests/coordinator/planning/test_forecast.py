"""When tasks are expected to end: the plan from the present on, what robots report, and experience."""

import msgspec
import pytest

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.plan_messages import TASK_ESTIMATES
from robrain.protocol.messages.tasks.task_messages import TASK_GET, TaskRequest
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.coordinator.planning.worlds import CAPACITY_J, Worker, run


def visit(name, x_m=6.0, y_m=4.0, **fields):
    return Task(id=name, kind="visit", place=Point2D(x_m, y_m), **fields)


def estimate(team, name):
    return team.ask(TASK_GET, TaskRequest(id=name)).estimate


def report(robot, remaining_s):
    robot.task = msgspec.structs.replace(robot.task, remaining_s=remaining_s)


def test_tasks_of_a_robot_follow_each_other_from_the_end_that_it_reports(team):
    robot = team.settle("r1", 4.0)
    team.submit(visit("first", 5.0, service_s=20.0))
    team.run(0.1)
    team.submit(visit("second", 7.0, service_s=10.0))
    team.run(1.0)
    report(robot, 30.0)
    team.run(2.0)
    first, second = estimate(team, "first"), estimate(team, "second")
    assert (first.robot, second.robot) == ("r1", "r1")
    assert first.ends_in_s == pytest.approx(30.0, abs=1.1)
    assert first.arrives_in_s == pytest.approx(10.0, abs=1.1)
    assert first.starts_in_s < 0.0
    assert second.starts_in_s == pytest.approx(first.ends_in_s, abs=0.1)
    assert first.ends_in_s < second.arrives_in_s < second.ends_in_s == pytest.approx(second.arrives_in_s + 10.0)
    assert second.ends_low_s < second.ends_in_s < second.ends_high_s
    robot.end(TaskState.DONE)
    team.run(0.2)
    assert estimate(team, "first") is None
    later = estimate(team, "second")  # nothing is before it any more, so its end is less uncertain
    assert 1.5 * later.ends_high_s / later.ends_in_s < second.ends_high_s / second.ends_in_s


def test_end_of_a_robot_that_is_stuck_moves_away_within_two_seconds_and_with_it_all_later_ends(team):
    robot = team.settle("r1", 4.0)
    team.submit(visit("first"))
    team.run(0.1)
    team.submit(visit("second", 7.0))
    team.run(0.4)
    report(robot, 10.0)
    team.run(2.0)
    before = [estimate(team, name).ends_in_s for name in ("first", "second")]
    team.run(5.0)  # it reports the same as before
    after = [estimate(team, name).ends_in_s for name in ("first", "second")]
    assert after == pytest.approx(before, abs=1.1)
    report(robot, 40.0)
    team.run(2.0)
    assert estimate(team, "first").ends_in_s == pytest.approx(40.0, abs=1.1)
    assert estimate(team, "second").ends_in_s == pytest.approx(after[1] + 30.0, abs=2.1)


def test_task_waits_for_its_time_and_for_those_before_it(team):
    robot = team.settle("r1", 4.0)
    team.settle("r2", 4.0)
    team.submit(visit("first", service_s=30.0))
    team.submit(visit("after", 5.0, after=("first",)))
    team.submit(visit("later", 5.0, 3.0), earliest_in_s=100.0)
    team.run(0.5)
    report(robot, 60.0)
    team.run(1.0)
    first, after, later = (estimate(team, name) for name in ("first", "after", "later"))
    assert after.ends_in_s >= first.ends_in_s
    assert later.ends_in_s == pytest.approx(98.5, abs=0.5)
    assert later.arrives_in_s <= later.ends_in_s


def test_robot_that_takes_longer_than_planned_is_expected_to_do_so_again(team):
    robot = team.settle("r1", 4.0)
    worker = Worker(robot, remaining_j=CAPACITY_J)
    team.closed_room()
    team.submit(visit("t0", 8.0))
    team.run(0.1)
    before = estimate(team, "t0").ends_in_s
    for number in range(10):
        run(team, [worker], 60.0, until=lambda number=number: team.states()[f"t{number}"] is TaskState.DONE)
        robot.energy = msgspec.structs.replace(robot.energy, pace_m_s=1.0)  # it says so, and drives half as fast
        worker.tell = lambda: None
        team.submit(visit(f"t{number + 1}", 8.0 if number % 2 else 4.0))
        team.run(0.1)
    after = estimate(team, "t10").ends_in_s
    taken_s = team.clock.now_ns()
    run(team, [worker], 60.0, until=lambda: team.states()["t10"] is TaskState.DONE)
    taken_s = (team.clock.now_ns() - taken_s) / 1e9
    assert before == pytest.approx(taken_s, rel=0.2)
    assert after == pytest.approx(taken_s, rel=0.1)


def test_task_that_will_miss_its_deadline_is_announced_before_it_has_passed(team):
    inbox = Inbox(1000, every=True)
    team.endpoint().subscribe(inbox, TASK_ESTIMATES)
    robot = team.settle("r1", 4.0)
    team.submit(visit("t"), deadline_in_s=60.0)
    team.run(0.5)
    report(robot, 20.0)
    team.run(2.0)
    assert not estimate(team, "t").is_late
    inbox.drain()
    report(robot, 58.5)
    team.run(2.0)
    assert estimate(team, "t").is_late
    assert [one.is_late for one in inbox.drain()[-1].message.tasks] == [True]
    assert team.states() == {"t": TaskState.RUNNING}


def test_estimates_are_published_when_one_has_moved(team):
    inbox = Inbox(1000, every=True)
    team.endpoint().subscribe(inbox, TASK_ESTIMATES)
    robot = team.settle("r1", 4.0)
    team.submit(visit("t", 5.0, service_s=60.0))
    team.run(1.0)
    report(robot, 60.0)
    team.run(1.5)
    inbox.drain()
    for second in range(5):
        report(robot, 58.5 - second)
        team.run(1.0)
    assert inbox.drain() == []
    report(robot, 90.0)
    team.run(1.2)
    (received,) = inbox.drain()
    (moved,) = received.message.tasks
    assert (moved.task, moved.robot) == ("t", "r1")
    assert moved.ends_in_s == pytest.approx(90.0, abs=1.1)
    robot.end(TaskState.DONE)
    team.run(1.2)
    assert inbox.drain()[-1].message.tasks == ()


def test_robot_that_reports_impossible_energies_spoils_no_estimate(team):
    robot = team.settle("r1", 4.0)
    for number in range(6):
        team.submit(visit(f"t{number}", 8.0 if number % 2 else 4.0))
        team.run(2.0)
        before = estimate(team, f"t{number}").energy_j
        robot.pose = Pose2D(8.0 if number % 2 else 4.0, 4.0, 0.0)
        robot.end(TaskState.DONE, energy_j=1e300)
        team.run(1.2)
    assert 0.0 < before < 1e4


def test_without_plans_there_are_estimates_of_running_tasks(team):
    team.begin(None, PlanningPolicy(method="nearest"))
    robot = team.settle("r1", 4.0)
    team.submit(visit("t"))
    team.run(1.0)
    report(robot, 12.0)
    team.run(2.0)
    assert estimate(team, "t").ends_in_s == pytest.approx(12.0, abs=1.1)
