"""Agents that are restarted while their robots are somewhere else."""

import numpy as np
import pytest

from robrain.algorithms.mapping.local_map import OwnMap
from robrain.protocol.model.geometry import IDENTITY, Point2D, Pose2D
from robrain.protocol.model.grid_geometry import OCCUPIED
from robrain.protocol.table.topics import ROBOT_EVENT

START = Pose2D(1.0, 1.0, 0.0)
BLOCKS = ((2.8, 2.2, 3.6, 2.8), (5.6, 2.1, 6.2, 3.4), (7.8, 0.0, 8.1, 1.6), (0.0, 3.6, 1.5, 3.8))


def view(host):
    return host.manager.get("mapper").plugin.view()


def ghosts(host, plan, *, body=None, moved=IDENTITY):
    """Places that a map calls occupied though no wall is within 0.2 m, nor a robot's `body`.

    `moved` is how the frame of the map lies in the arena.
    """
    seen, found = view(host), []
    for row, column in np.argwhere(seen.classes == OCCUPIED):
        middle = seen.geometry.center_of(int(row), int(column))
        place = moved.compose(Pose2D(middle.x_m, middle.y_m, 0.0))
        cell = plan.cell_of(place.x_m, place.y_m)
        is_body = body is not None and body.distance_m(Pose2D(place.x_m, place.y_m, 0.0)) < 0.4
        if plan.holds_cell(*cell) and plan.clearance_m[cell] > 0.2 and not is_body:
            found.append((place.x_m, place.y_m))
    return found


def drive(one, host, *places, robot="r1"):
    localisation = host.manager.get("localisation").plugin
    for place in places:
        host.manager.get("driver").plugin.follow(localisation.to_odom([Point2D(*place)]))
        one.run_until(lambda place=place: one.truth(robot).pose.distance_m(Pose2D(*place, 0.0)) < 0.15, 30.0)
    one.run(1.0)


def stroll(one, host, *places, robot="r1"):
    """Drive a robot that does not know where it is: places in the arena, by the truth."""
    driver = host.manager.get("driver").plugin
    for place in places:
        T_odom_arena = driver.pose().compose(one.truth(robot).pose.inverse())
        target = T_odom_arena.compose(Pose2D(*place, 0.0))
        driver.follow([Point2D(target.x_m, target.y_m)])
        one.run_until(lambda place=place: one.truth(robot).pose.distance_m(Pose2D(*place, 0.0)) < 0.15, 30.0)
    one.run(3.0)


@pytest.fixture
def restarted(stage, room):
    """A stage, its plan, the host of r1 that restarted 5 m from its start, and that of r2, which saw all of it."""
    plan = room(10.0, 5.0, *BLOCKS)
    one = stage(plan, r1=START, r2=Pose2D(1.0, 2.5, 0.0))
    first, mate = (one.host("mapper", "localisation", robot=robot) for robot in ("r1", "r2"))
    drive(one, first, (4.6, 1.0), (4.6, 3.9), (6.8, 4.2), (4.6, 3.9))
    one.hosts.remove(first)
    first.close()
    one.run(0.5)
    events = one.inbox(ROBOT_EVENT, robot="r1", plugin="localisation", event="diverged")
    again = one.host("mapper", "localisation")
    return one, plan, again, mate, events


@pytest.mark.slow
def test_a_robot_begun_anew_away_from_its_start_says_at_once_that_it_is_lost_and_finds_itself(restarted):
    one, _, again, _, events = restarted
    assert again.manager.get("localisation").plugin.pose().distance_m(one.truth().pose) > 4.0
    one.run(1.0)
    assert again.board.lost
    stroll(one, again, (4.6, 2.6), (4.2, 3.6))
    said = [received.message.value for received in events.drain()]
    assert [each["is_lost"] for each in said] == [True, False]
    assert "on the map of the others" in said[0]["why"]
    found = again.manager.get("localisation").plugin.pose()
    assert found.distance_m(one.truth().pose) < 0.1
    assert found.yaw_rad == pytest.approx(one.truth().pose.yaw_rad, abs=0.05)


@pytest.mark.slow
def test_a_robot_begun_anew_away_from_its_start_spoils_nobodys_map(restarted):
    one, plan, again, mate, _ = restarted
    for _ in range(50):
        one.run(0.1)
        # A robot whose agent is gone is an obstacle to the others, until it has moved on.
        assert ghosts(mate, plan, body=one.truth().pose) == []
    stroll(one, again, (4.6, 2.6), (4.6, 3.9))
    assert again.board.lost == ""
    drive(one, again, (6.8, 4.2), (4.6, 3.9), (4.6, 1.0))
    assert (ghosts(again, plan), ghosts(mate, plan)) == ([], [])


@pytest.mark.slow
def test_a_robot_whose_start_is_not_known_is_lost_until_the_walls_on_its_teams_map_find_it(stage, room):
    plan = room(10.0, 5.0, *BLOCKS)
    one = stage(plan, r1=START, r2=Pose2D(6.8, 4.2, -1.0))
    first = one.host("mapper", "localisation")
    drive(one, first, (4.6, 1.0), (4.6, 3.9), (4.6, 1.0))
    late = one.host("mapper", "localisation", robot="r2", localisation={"start_known": False, "x_m": 5.0, "y_m": 2.5})
    assert "where it starts" in late.board.lost
    one.run(1.0)
    assert ghosts(first, plan, body=one.truth("r2").pose) == []
    stroll(one, late, (5.2, 4.2), (4.6, 3.0), (4.4, 3.6), robot="r2")
    assert late.board.lost == ""
    assert late.board.shared(OwnMap).local_pose.trajectory == 1, "its map begins where it was found"
    assert late.board.pose.distance_m(one.truth("r2").pose) < 0.15
    assert ghosts(late, plan, body=one.truth("r1").pose) == []
