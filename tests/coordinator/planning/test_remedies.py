"""Remedies for tasks that a plan leaves out: each planted cause is named first."""

import pytest

from robrain.algorithms.mapping.occupancy_grid import OCCUPIED
from robrain.protocol.messages.tasks.task_messages import (
    TASK_DRY_RUN,
    TASK_EXPLAIN,
    RemedyKind,
    TaskDryRun,
    TaskExplanation,
    TaskRequest,
    TaskSubmission,
)
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from tests.coordinator.planning.worlds import CAPACITY_J, Worker, run


def visit(name, x_m=8.5, y_m=4.0, **fields):
    return Task(id=name, kind="visit", place=Point2D(x_m, y_m), **fields)


def worker(team, name="r1", x_m=4.0, y_m=4.0, remaining_j=CAPACITY_J):
    robot = team.robot(name, x_m, y_m)
    robot.plugins = ["visit"]
    return Worker(robot, remaining_j=remaining_j)


def remedies(team, name):
    return team.ask(TASK_EXPLAIN, TaskRequest(id=name), TaskExplanation).remedies


def dry_run(team, task, **times):
    return team.ask(TASK_DRY_RUN, TaskSubmission(task=task, **times), TaskDryRun)


@pytest.mark.parametrize("x_m", [6.3, 7.3, 8.5])
def test_low_battery_is_named(team, x_m):
    workers = [worker(team, remaining_j=0.1 * CAPACITY_J + 50.0)]
    team.closed_room()
    run(team, workers, 1.0)
    team.submit(visit("t", x_m))
    team.submit(visit("other", 4.2))
    run(team, workers, 1.0)
    first = remedies(team, "t")[0]
    assert (first.kind, first.name) == (RemedyKind.BATTERY, "r1")
    assert first.ends_in_s > (x_m - 4.0) / 0.5


@pytest.mark.parametrize("x_m", [6.3, 7.3, 8.5])
def test_robot_that_is_not_there_is_named(team, x_m):
    workers = [worker(team), worker(team, "r2", x_m - 0.3)]
    team.closed_room()
    run(team, workers, 1.0)
    workers[1].robot.halted = True
    run(team, workers, 1.0)
    team.submit(visit("other", 3.5, service_s=2.0))
    found = dry_run(team, visit("t", x_m), deadline_in_s=4.0)
    assert found.estimate is None
    assert (found.remedies[0].kind, found.remedies[0].name) == (RemedyKind.ROBOT, "r2")


@pytest.mark.parametrize("service_s", [30.0, 160.0])
def test_task_that_takes_long_is_named(team, service_s):
    workers = [worker(team)]
    team.closed_room()
    run(team, workers, 1.0)
    team.submit(visit("long", 5.0, service_s=service_s))
    run(team, workers, 2.0)
    team.submit(visit("short", 5.5, service_s=1.0))
    found = dry_run(team, visit("t", 6.0), deadline_in_s=20.0)
    assert found.estimate is None
    assert (found.remedies[0].kind, found.remedies[0].name) == (RemedyKind.TASK, "long")
    assert found.remedies[0].ends_in_s < 20.0


@pytest.mark.parametrize("x_m", [6.8, 8.45])
def test_closed_path_is_named(team, x_m):
    workers = [worker(team)]
    team.closed_room()
    team.draw(6.0, 2.0, 6.2, 6.0, OCCUPIED)
    run(team, workers, 1.0)
    team.submit(visit("t", x_m))
    team.submit(visit("here", 4.5))
    run(team, workers, 1.0)
    found = remedies(team, "t")
    assert [one.kind for one in found] == [RemedyKind.PATH]
    assert found[0].place.x_m == pytest.approx(6.1, abs=0.3)
    run(team, workers, 6.0)
    assert remedies(team, "t"), "the barrier is removed in thought alone"


def test_task_that_a_plan_includes_has_no_cause(team):
    workers = [worker(team)]
    team.closed_room()
    run(team, workers, 1.0)
    team.submit(visit("now", 4.5, service_s=30.0))
    team.submit(visit("t"))
    run(team, workers, 1.0)
    assert remedies(team, "t") == []
    assert dry_run(team, visit("u", 6.0)).remedies == []
