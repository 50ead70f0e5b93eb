import math

import numpy as np
import pytest

from robrain.algorithms.navigation.frontier import find_frontiers, frontier_mask
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.table.topics import ROBOT_PATH, ROBOT_STATE

TWO_ROOMS = (10.0, 4.0, (4.9, 0.0, 5.1, 1.4), (4.9, 2.6, 5.1, 4.0))


def view(host):
    return host.manager.get("mapper").plugin.view()


def status(host):
    return host.desk.status


def frontiers(host):
    seen = view(host)
    return [seen.geometry.center_of(found.row, found.column) for found in find_frontiers(seen.classes)]


@pytest.fixture
def explorer(stage, room):
    """A robot in the first of two rooms, a coordinator that speaks, and the frontier in the door."""
    one = stage(room(*TWO_ROOMS), r1=Pose2D(1.5, 2.0, 0.0))
    one.coordinator_speaks = True
    host = one.host("explore")
    one.run(1.0)
    return one, host


def test_a_robot_that_hears_a_coordinator_waits_for_an_offer(explorer):
    one, host = explorer
    one.run(10.0)
    assert status(host) is None
    assert one.truth().distance_m == 0.0
    assert host.board.behavior == "idle"


def test_an_offer_is_accepted_driven_to_and_done(explorer):
    one, host = explorer
    states, paths = one.inbox(ROBOT_STATE), one.inbox(ROBOT_PATH)
    known = np.count_nonzero(view(host).classes != UNKNOWN)
    answer = one.offer(frontiers(host)[0], epoch=3)
    assert answer.accepted, answer.why
    one.run(0.3)
    running = states.drain()[-1].message
    assert (running.task.id, running.task.epoch, running.task.state) == ("t1", 3, TaskState.RUNNING)
    assert running.behavior == "explore"
    assert paths.drain()[0].message.points
    one.run_until(lambda: status(host).state.ended, 60.0)
    assert status(host).state is TaskState.DONE
    one.run(0.2)
    assert states.drain()[-1].message.task.state is TaskState.DONE
    assert one.truth().distance_m > 0.5
    assert np.count_nonzero(view(host).classes != UNKNOWN) > known
    assert one.truth().collisions == 0


@pytest.mark.parametrize("goal", [Point2D(9.0, 0.5), Point2D(-30.0, 2.0), Point2D(4.0, 3.99 + 2.0)])
def test_an_unreachable_goal_is_refused_with_the_reason(explorer, goal):
    one, host = explorer
    answer = one.offer(goal)
    assert not answer.accepted
    assert "no way" in answer.why
    one.run(2.0)
    assert status(host) is None
    assert one.truth().distance_m == 0.0


def test_after_a_refusal_the_robot_goes_on_with_what_it_was_at(explorer):
    one, host = explorer
    goal = frontiers(host)[0]
    one.offer(goal, task="good", epoch=1)
    assert not one.offer(Point2D(-30.0, 2.0), task="bad", epoch=2).accepted
    one.run(0.3)
    assert status(host).id == "good"
    assert one.call("explore", "goal") == {"x_m": goal.x_m, "y_m": goal.y_m}
    one.run_until(lambda: status(host).state.ended, 60.0)
    assert (status(host).id, status(host).state) == ("good", TaskState.DONE)


def test_a_frontier_that_walls_hide_is_done_without_going_there(explorer):
    """As the inside of a shelf, seen through a slit: nobody who can only stand outside will see more of it."""
    one, host = explorer
    goal = Point2D(3.25, 2.05)
    row, column = view(host).geometry.cell_of(goal.x_m, goal.y_m)
    inside = np.full((5, 5), OCCUPIED, np.int8)
    inside[1:4, 1:4] = UNKNOWN
    inside[1:4:2, 1:4:2] = inside[2, 2] = FREE
    host.manager.get("explore").live_plugin()._travel.view = lambda: seen
    seen = view(host)
    seen.classes[row - 2 : row + 3, column - 2 : column + 3] = inside
    before = one.truth().pose
    assert one.offer(goal).accepted
    one.run(0.5)
    assert status(host).state is TaskState.DONE
    assert "walls hide it" in status(host).why
    assert one.truth().pose == before


def test_single_cells_that_stay_open_do_not_keep_a_robot(explorer):
    """A slit between two boards shows as one or two frontier cells, and will for ever."""
    _one, host = explorer
    explore, seen = host.manager.get("explore").live_plugin(), view(host)
    goal = Point2D(2.55, 2.05)
    assert explore._is_seen(seen, goal)
    row, column = seen.geometry.cell_of(goal.x_m, goal.y_m)
    seen.classes[row + 3, column] = UNKNOWN
    assert np.count_nonzero(frontier_mask(seen.classes[row : row + 6, column - 3 : column + 4])) == 4
    seen.classes[row + 4, column] = OCCUPIED
    assert explore._is_seen(seen, goal)
    seen.classes[row + 2 : row + 5, column - 2 : column + 3] = UNKNOWN
    assert not explore._is_seen(seen, goal)


def test_a_robot_that_stands_blocked_gives_the_task_back(stage):
    """The wheels do not turn and the lidar falls silent: a blind robot stands."""
    one = stage()
    one.coordinator_speaks = True
    grid = {"origin_x_m": -6.0, "origin_y_m": -6.0, "width_m": 12.0, "height_m": 12.0}
    host = one.host("explore", mapper=grid)
    ranges_m = [0.0 if abs(angle) < 1.0 else 2.0 for angle in np.linspace(-math.pi, math.pi, 360, endpoint=False)]
    one.run(1.0, lambda: one.scan(ranges_m, range_max_m=3.0))
    # Without a word from its wheels it maps nothing itself.
    known = np.full((50, 50), FREE)
    known[:5] = known[:, :5] = known[-5:] = OCCUPIED
    row, column = view(host).geometry.cell_of(0.0, 0.0)
    host.manager.get("mapper").plugin._atlas.merge(("known", 1), row - 25, column - 25, known, 1)
    assert one.offer(frontiers(host)[0]).accepted
    one.run(1.0, lambda: one.scan(ranges_m, range_max_m=3.0))
    assert status(host).state is TaskState.RUNNING
    lasted_s = one.run_until(lambda: status(host).state.ended, 20.0)
    assert status(host).state is TaskState.FAILED
    assert "blocked" in status(host).why
    assert lasted_s > 2.0
    assert one.call("explore", "goal") is None


def test_a_robot_whose_way_is_found_closed_gives_the_task_back(stage, room):
    """A robot that nobody knows of stands in the door, which was seen open before."""
    one = stage(room(*TWO_ROOMS[:2], (4.9, 0.0, 5.1, 1.7), (4.9, 2.3, 5.1, 4.0)), r1=Pose2D(1.5, 2.0, 0.0))
    one.coordinator_speaks = True
    host = one.host("explore")
    one.run(1.0)
    goal = max(frontiers(host), key=lambda place: place.x_m)
    assert one.offer(goal).accepted
    grid = view(host).geometry
    row, column = grid.cell_of(5.0, 2.0)
    closed = np.full((10, 3), OCCUPIED, np.int8)
    host.manager.get("mapper").plugin._atlas.merge(("known", 1), row - 5, column - 1, closed, 3_000_000)
    lasted_s = one.run_until(lambda: status(host).state.ended, 20.0)
    assert status(host).state in (TaskState.FAILED, TaskState.DONE)
    assert lasted_s < 15.0
    assert one.truth().collisions == 0


@pytest.mark.slow
def test_with_no_word_from_a_coordinator_for_three_seconds_the_robot_chooses_for_itself(stage, room):
    one = stage(room(*TWO_ROOMS), r1=Pose2D(1.5, 2.0, 0.0))
    host = one.host("explore")
    one.run(2.5)
    assert one.truth().distance_m == 0.0
    one.run(3.0)
    assert one.truth().distance_m > 0.3
    assert host.board.behavior == "explore alone"
    assert status(host) is None  # nobody gave it a task
    one.run(40.0)
    assert view(host).classes[view(host).geometry.cell_of(9.0, 2.0)] != UNKNOWN
    assert frontiers(host) == []


def test_a_robot_whose_coordinator_falls_silent_goes_on_alone(explorer):
    one, host = explorer
    one.coordinator_speaks = False
    one.run(2.5)
    assert host.board.behavior == "idle"
    one.run_until(lambda: host.board.behavior == "explore alone", 1.0)
    assert one.truth().distance_m == 0.0
    one.run(5.0)
    assert one.truth().distance_m > 1.0


def test_what_the_robot_chose_for_itself_gives_way_to_another_behavior(explorer):
    one, host = explorer
    one.coordinator_speaks = False
    one.run_until(lambda: host.board.behavior == "explore alone", 5.0)
    assert host.desk.occupy("wander")
    host.board.behavior = "wander"
    one.run(0.4)
    assert one.call("explore", "goal") is None
    one.run(5.0)
    assert (one.call("explore", "goal"), host.board.behavior) == (None, "wander")


def test_an_offer_takes_the_place_of_what_the_robot_chose_for_itself(explorer):
    one, host = explorer
    one.coordinator_speaks = False
    one.run_until(lambda: host.board.behavior == "explore alone", 5.0)
    one.run(1.0)
    one.coordinator_speaks = True
    goal = frontiers(host)[0]
    assert one.offer(goal).accepted
    assert host.board.behavior == "explore"
    assert one.call("explore", "goal") == {"x_m": goal.x_m, "y_m": goal.y_m}
    assert status(host).state is TaskState.RUNNING


def test_a_halted_robot_gives_its_task_back_refuses_offers_and_works_again_when_resumed(explorer):
    one, host = explorer
    goal = frontiers(host)[0]
    one.offer(goal)
    one.run(0.5)
    one.halt()
    one.run(0.5)
    assert status(host).state is TaskState.CANCELLED
    assert "halted" in status(host).why
    answer = one.offer(goal, task="t2", epoch=2)
    assert not answer.accepted
    assert "halted" in answer.why
    one.run(1.0)
    before = one.truth().pose
    one.halt(halted=False)
    one.run(2.0)
    assert one.truth().pose == before
    assert one.offer(goal, task="t3", epoch=3).accepted
    one.run_until(lambda: status(host).state.ended, 60.0)
    assert (status(host).id, status(host).state) == ("t3", TaskState.DONE)
