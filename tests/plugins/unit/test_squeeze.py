"""Driving through passages hardly wider than the robot, whose radius is 0.2 m."""

import math

import numpy as np
import pytest

from robrain.plugins.device.range_sensors import Bump
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.sim.maps.floor_plan import FloorPlan

CELL_M = 0.01
START = Pose2D(0.8, 1.0, 0.0)
END = Point2D(3.2, 1.0)


def two_rooms(gap_m, *, long_m=1.0, middle_m=1.0):
    """Two rooms, 2 m in y, joined by a corridor that begins at x = 1.6."""
    occupied = np.ones((round(2.0 / CELL_M), round((2.8 + long_m) / CELL_M)), np.bool_)
    edge, begin, end = round(0.05 / CELL_M), round(1.6 / CELL_M), round((1.6 + long_m) / CELL_M)
    occupied[edge:-edge, edge:-edge] = False
    occupied[:, begin:end] = True
    low, high = round((middle_m - gap_m / 2) / CELL_M), round((middle_m + gap_m / 2) / CELL_M)
    occupied[low:high, begin:end] = False
    return FloorPlan(occupied, CELL_M, 0.0, 0.0, "two rooms")


class Squeezing:
    """A robot in front of a corridor."""

    def __init__(self, stage, plan, *, yaw_rad=0.0):
        start = Pose2D(START.x_m, START.y_m, yaw_rad)
        self.stage = stage(plan, r1=start)
        self.host = self.stage.host("localisation")
        self.driver = self.host.manager.get("driver").plugin
        self.fastest_inside_m_s = self.fastest_m_s = 0.0
        self.stage.run(0.6)

    def follow(self, *places, is_narrow=True):
        localisation = self.host.manager.get("localisation").plugin
        self.driver.follow(localisation.to_odom([Point2D(*place) for place in places]), is_narrow=is_narrow)

    def run(self, duration_s):
        self.stage.run(duration_s, self._watch)

    def _watch(self):
        velocity = self.driver.velocity()
        speed_m_s = math.hypot(velocity.forward_m_s, velocity.left_m_s)
        self.fastest_m_s = max(self.fastest_m_s, speed_m_s)
        if 1.6 < self.pose.x_m < 2.6:
            self.fastest_inside_m_s = max(self.fastest_inside_m_s, speed_m_s)

    @property
    def pose(self):
        return self.stage.truth().pose

    @property
    def collisions(self):
        return self.stage.truth().collisions


@pytest.mark.slow
@pytest.mark.parametrize("yaw_rad", [1.0])
@pytest.mark.parametrize(("gap_m", "slow_m_s"), [(0.45, 0.2), (0.5, 0.4), (0.54, 0.55)])
def test_a_robot_goes_the_slower_through_a_corridor_the_narrower_it_is_and_touches_nothing(
    stage, gap_m, slow_m_s, yaw_rad
):
    one = Squeezing(stage, two_rooms(gap_m), yaw_rad=yaw_rad)
    one.follow((1.5, 1.0), (2.7, 1.0), (END.x_m, END.y_m))
    one.run(25.0)
    assert one.pose.distance_m(END) < 0.15
    assert one.collisions == 0
    assert 0.5 * slow_m_s < one.fastest_inside_m_s < slow_m_s
    assert one.fastest_m_s > 0.25, "where there is room it drives as ever"


@pytest.mark.slow
@pytest.mark.parametrize("off_m", [0.06])
def test_the_robot_keeps_to_the_middle_of_the_walls_where_its_path_does_not(stage, off_m):
    one = Squeezing(stage, two_rooms(0.45))
    one.follow((1.4, 1.0 + off_m), (1.6, 1.0 + off_m), (2.1, 1.0 + off_m), (2.7, 1.0 + off_m), (END.x_m, END.y_m))
    one.run(30.0)
    assert one.pose.distance_m(END) < 0.15
    assert one.collisions == 0


@pytest.mark.parametrize(("gap_m", "is_narrow"), [(0.45, False), (0.3, True), (0.36, True), (0.4, True)])
def test_before_a_gap_that_is_too_narrow_for_its_path_the_robot_stands_and_tells_its_width(stage, gap_m, is_narrow):
    one = Squeezing(stage, two_rooms(gap_m))
    one.follow((1.5, 1.0), *([(2.7, 1.0)] if is_narrow else []), (END.x_m, END.y_m), is_narrow=is_narrow)
    one.run(15.0)
    assert one.pose.x_m < 1.6
    assert one.driver.motion() is Motion.BLOCKED
    assert (one.driver.blocked_reason() == "the path has been too narrow") is is_narrow
    assert one.driver.gap_m() == (pytest.approx(gap_m, abs=0.03) if is_narrow else None)
    assert one.driver.squeezes() is is_narrow
    assert one.collisions == 0


@pytest.mark.slow
def test_a_robot_that_is_given_the_same_way_again_and_again_tells_that_it_is_too_narrow(stage):
    one = Squeezing(stage, two_rooms(0.4))
    told_m = set()
    for _ in range(8):
        one.follow((1.5, 1.0), (2.7, 1.0), (END.x_m, END.y_m))
        one.run(2.0)
        told_m.add(one.driver.gap_m())
    assert one.pose.x_m < 1.6
    assert max(width_m or 0.0 for width_m in told_m) == pytest.approx(0.4, abs=0.03)
    assert one.driver.blocked_s() > 2.0


@pytest.mark.slow
def test_something_in_a_narrow_place_is_no_gap_that_is_too_narrow(stage):
    plan = two_rooms(0.6)
    occupied = plan.occupied.copy()
    occupied[95:105, 200:210] = True  # a post in the middle of the corridor leaves no room on either side
    one = Squeezing(stage, FloorPlan(occupied, CELL_M, 0.0, 0.0, "post"))
    one.follow((1.5, 1.0), (2.7, 1.0), (END.x_m, END.y_m))
    one.run(15.0)
    assert one.pose.x_m < 1.85
    assert one.driver.motion() is Motion.BLOCKED
    assert one.collisions == 0


@pytest.mark.slow
def test_robot_that_was_stuck_in_a_corridor_sets_out_on_a_narrow_path_back(stage):
    plan = two_rooms(0.5)
    occupied = plan.occupied.copy()
    occupied[95:105, 200:210] = True  # a post in the corridor
    one = Squeezing(stage, FloorPlan(occupied, CELL_M, 0.0, 0.0, "post"))
    one.follow((1.5, 1.0), (END.x_m, END.y_m))
    one.run(15.0)
    assert one.driver.motion() is Motion.BLOCKED
    one.follow((START.x_m, START.y_m))
    one.run(0.1)
    motions = set()
    one.stage.run(0.5, lambda: motions.add(one.driver.motion()))
    assert motions == {Motion.DRIVING}
    one.run(15.0)
    assert one.pose.distance_m(Point2D(START.x_m, START.y_m)) < 0.15


@pytest.mark.slow
def test_the_gap_is_forgotten_with_the_next_path(stage):
    one = Squeezing(stage, two_rooms(0.36))
    one.follow((1.5, 1.0), (END.x_m, END.y_m))
    one.run(10.0)
    assert one.driver.gap_m() is not None
    one.follow((START.x_m, START.y_m), is_narrow=False)
    one.run(5.0)
    assert one.driver.gap_m() is None
    assert not one.driver.squeezes()
    assert one.pose.distance_m(Point2D(START.x_m, START.y_m)) < 0.15


def test_a_bump_in_a_narrow_place_ends_the_way_ahead(stage):
    one = Squeezing(stage, two_rooms(0.45))
    one.follow((1.5, 1.0), (2.7, 1.0), (END.x_m, END.y_m))
    one.stage.run_until(lambda: one.pose.x_m > 1.9, 20.0)
    one.driver._lookout.feel(Bump(one.stage.clock.now_ns(), (0.0,)))
    one.run(3.0)
    assert one.pose.x_m < 2.0
