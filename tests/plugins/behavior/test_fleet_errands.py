"""Deliver, sweep, follow and guard, by a robot in a room of 6 x 4 m with a pillar."""

import pytest

from robrain.protocol.model.energy_model import CARRY_J_PER_KG_M
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState

pytestmark = pytest.mark.slow
SHELF, DOCK = Point2D(4.8, 3.2), Point2D(1.0, 3.0)


def point(place):
    return {"x_m": place.x_m, "y_m": place.y_m}


def test_a_delivery_ends_where_its_item_goes(errands):
    run = errands("deliver")
    task = Task(id="d", kind="deliver", place=SHELF, service_s=2.0, parameters={"to": point(DOCK), "payload_kg": 4.0})
    work = run.plugin("deliver").work(task, run.plugin("deliver").task_parameters(to=DOCK, payload_kg=4.0))
    assert work.ends_at == DOCK
    assert work.wait_s == 4.0
    assert work.carried_kg_m == pytest.approx(4.0 * work.path_m)
    assert 3.5 < work.path_m < 5.0
    empty = run.plugin("energy").estimate(work.__class__(path_m=work.path_m, wait_s=4.0))
    loaded = run.plugin("energy").estimate(work)
    assert loaded.mean_j - empty.mean_j == pytest.approx(CARRY_J_PER_KG_M * work.carried_kg_m)
    status = run.finish(task)
    assert (status.state, status.result["delivered"]) == (TaskState.DONE, 1)
    assert run.pose().distance_m(DOCK) < 0.2


def test_items_share_a_trip_within_the_capacity(errands):
    run = errands("deliver")
    parameters = {
        "to": point(DOCK),
        "payload_kg": 4.0,
        "items": [{"pick_up": point(Point2D(4.8, 1.0)), "to": point(Point2D(1.0, 1.0)), "payload_kg": 5.0}],
    }
    status = run.finish(Task(id="d", kind="deliver", place=SHELF, parameters=parameters))
    assert status.result["delivered"] == 2
    assert run.path_m() < 13.5, "both picked up first; one after the other is 16 m"


def test_a_delivery_that_is_interrupted_continues_with_its_item_on_board(errands):
    run = errands("deliver")
    task = Task(id="d", kind="deliver", place=SHELF, parameters={"to": point(DOCK)})
    assert run.offer(task).accepted
    run.run_until(lambda: run.status().carries, 60.0, 0.2)
    run.run_until(lambda: run.pose().distance_m(DOCK) < 2.5, 60.0, 0.2)
    run.withdraw("d")
    gone_m = run.path_m()
    assert run.finish(task).state is TaskState.DONE
    assert run.pose().distance_m(DOCK) < 0.2
    assert run.path_m() - gone_m < 4.0, "not to the shelf again"


def test_an_item_above_the_capacity_is_refused_with_both_weights(errands):
    run = errands("deliver")
    answer = run.offer(Task(id="d", kind="deliver", place=SHELF, parameters={"to": point(DOCK), "payload_kg": 40.0}))
    assert not answer.accepted
    assert answer.why == "r1 carries at most 10 kg, not 40 kg"


def test_a_sweep_covers_its_area_around_a_pillar(errands):
    run = errands("sweep")
    area = [Point2D(2.2, 1.0), Point2D(4.2, 1.0), Point2D(4.2, 3.2), Point2D(2.2, 3.2)]
    task = Task(id="s", kind="sweep", place=Point2D(2.2, 1.0), parameters={"area": [*map(point, area)], "width_m": 0.5})
    run.finish(Task(id="look", kind="sweep", place=Point2D(4.8, 3.2), parameters=task.parameters), 240.0)
    status = run.finish(task, 240.0)
    assert status.state is TaskState.DONE
    assert status.result["covered_share"] > 0.97
    assert run.arena.collisions == 0


def test_a_robot_follows_another_and_keeps_its_distance(errands):
    run = errands("follow", "visit", starts={"r2": Pose2D(3.5, 1.0, 0.0)})
    run.run(1.0)
    task = Task(id="f", kind="follow", place=Point2D(2.0, 1.5), parameters={"robot": "r2", "duration_s": 45.0})
    assert run.offer(task).accepted
    assert run.offer(Task(id="v", kind="visit", place=SHELF), "r2").accepted
    run.run(8.0)
    assert run.offer(Task(id="w", kind="visit", place=DOCK), "r2").accepted
    run.run_until(lambda: run.status().state.ended, 60.0, 0.2)
    assert run.status().state is TaskState.DONE
    assert run.status().result["near_share"] > 0.7
    assert 0.5 < run.pose().distance_m(DOCK) < 2.5
    assert run.arena.collisions == 0


def test_a_point_that_is_moved_is_followed(errands):
    run = errands("follow")
    task = Task(id="f", kind="follow", place=Point2D(2.0, 1.5), parameters={"duration_s": 25.0, "distance_m": 0.5})
    assert run.offer(task).accepted
    run.run(6.0)
    run.call("follow", "point", 4.8, 1.5)
    run.run_until(lambda: run.status().state.ended, 60.0, 0.2)
    assert run.status().state is TaskState.DONE
    assert run.pose().distance_m(Point2D(4.8, 1.5)) < 1.0


def test_a_robot_that_is_not_there_cannot_be_followed(errands):
    run = errands("follow")
    task = Task(id="f", kind="follow", place=Point2D(2.0, 1.5), parameters={"robot": "r9", "duration_s": 90.0})
    status = run.finish(task)
    assert status.state is TaskState.FAILED
    assert status.why == "r9 was not heard for 20 s"


def test_a_guard_stands_where_the_area_is_seen(errands):
    run = errands("guard")
    area = [Point2D(1.0, 2.6), Point2D(5.0, 2.6), Point2D(5.0, 3.6), Point2D(1.0, 3.6)]
    parameters = {"area": [*map(point, area)], "duration_s": 6.0, "interval_s": 3.0}
    status = run.finish(Task(id="g", kind="guard", place=Point2D(2.0, 2.0), parameters=parameters))
    assert status.state is TaskState.DONE
    assert status.result["seen_share"] > 0.9
    assert status.result["rounds"] == 2
    assert status.result["changes"] == 0
