"""Driving through passages hardly wider than the robot, whose radius is 0.2 m."""

import math

import numpy as np
import pytest

from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.sim.maps.floor_plan import FloorPlan

CELL_M = 0.01
START = Pose2D(0.8, 1.0, 0.0)
END = Point2D(3.2, 1.0)


def two_rooms(gap_m, long_m=1.0, middle_m=1.0):
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
@pytest.mark.parametrize(("gap_m", "slow_m_s"), [(0.45, 0.2), (0.54, 0.55)])
def test_a_robot_goes_the_slower_through_a_corridor_the_narrower_it_is_and_touches_nothing(stage, gap_m, slow_m_s):
    one = Squeezing(stage, two_rooms(gap_m), yaw_rad=1.0)
    one.follow((1.5, 1.0), (2.7, 1.0), (END.x_m, END.y_m))
    one.run(25.0)
    assert one.pose.distance_m(END) < 0.15
    assert one.collisions == 0
    assert 0.5 * slow_m_s < one.fastest_inside_m_s < slow_m_s
    assert one.fastest_m_s > 0.25, "where there is room it drives as ever"


@pytest.mark.parametrize(("gap_m", "is_narrow"), [(0.45, False), (0.3, True), (0.4, True)])
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
