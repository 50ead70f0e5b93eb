import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robrain.algorithms.slam.robots_in_scan import MARGIN_M, REACH_M, robot_circles, sees_through, wall_ends
from robrain.protocol.model.geometry import Pose2D
from tests.algorithms.mapping.lidar_floor import ANGLES_RAD, RANGE_M, LidarFloor

RADIUS_M = 0.2
WALLS = (
    (0.0, 0.0, 12.0, 0.2),
    (0.0, 7.8, 12.0, 8.0),
    (0.0, 0.0, 0.2, 8.0),
    (11.8, 0.0, 12.0, 8.0),
)
HALL = LidarFloor(*WALLS)
SENSOR = Pose2D(5.0, 4.0, 0.4)


def circle(x_m, y_m, radius_m=RADIUS_M):
    return np.array([(x_m, y_m, radius_m)])


def circles_for(told, ranges_m, sensor=SENSOR):
    return robot_circles(ANGLES_RAD, ranges_m, RANGE_M, sensor, told)


def left_of(circles, ranges_m, sensor=SENSOR):
    """(n, 2) ends of beams, arena frame, that are taken for walls."""
    points = wall_ends(ANGLES_RAD, ranges_m, RANGE_M, sensor, circles)
    cos, sin = math.cos(sensor.yaw_rad), math.sin(sensor.yaw_rad)
    return np.column_stack(
        (sensor.x_m + cos * points[:, 0] - sin * points[:, 1], sensor.y_m + sin * points[:, 0] + cos * points[:, 1])
    )


def nearest_m(points, x_m, y_m):
    return float(np.hypot(points[:, 0] - x_m, points[:, 1] - y_m).min())


@settings(deadline=None, max_examples=60)
@given(bearing_rad=st.floats(-2.7, 2.7), away_m=st.floats(0.6, 2.4))
def test_a_mate_where_it_says_is_no_wall(bearing_rad, away_m):
    x_m = SENSOR.x_m + away_m * math.cos(SENSOR.yaw_rad + bearing_rad)
    y_m = SENSOR.y_m + away_m * math.sin(SENSOR.yaw_rad + bearing_rad)
    ranges_m = HALL.ranges_m(SENSOR, circle(x_m, y_m))
    left = left_of(circles_for(circle(x_m, y_m), ranges_m), ranges_m)
    assert nearest_m(left, x_m, y_m) > RADIUS_M + MARGIN_M
    assert len(left) > 150


@settings(deadline=None, max_examples=60)
@given(
    bearing_rad=st.floats(-2.7, 2.7), away_m=st.floats(0.8, 2.4), off_m=st.floats(0.3, 0.7), to_rad=st.floats(-3.1, 3.1)
)
def test_a_mate_that_is_not_quite_where_it_says_is_known_by_its_shape(bearing_rad, away_m, off_m, to_rad):
    x_m = SENSOR.x_m + away_m * math.cos(SENSOR.yaw_rad + bearing_rad)
    y_m = SENSOR.y_m + away_m * math.sin(SENSOR.yaw_rad + bearing_rad)
    ranges_m = HALL.ranges_m(SENSOR, circle(x_m, y_m))
    told = circle(x_m + off_m * math.cos(to_rad), y_m + off_m * math.sin(to_rad))
    circles = circles_for(told, ranges_m)
    assert len(circles) == 2
    assert circles[1] == pytest.approx((x_m, y_m, RADIUS_M + MARGIN_M), abs=0.08)
    assert nearest_m(left_of(circles, ranges_m), x_m, y_m) > RADIUS_M + 0.05


def test_a_pillar_of_a_mates_size_far_from_the_mate_stays_a_wall():
    pillar = (6.5, 4.0)
    ranges_m = HALL.ranges_m(SENSOR, circle(*pillar))
    circles = circles_for(circle(pillar[0], pillar[1] + REACH_M + 0.2), ranges_m)
    assert len(circles) == 1
    assert nearest_m(left_of(circles, ranges_m), *pillar) < RADIUS_M + 0.05


@pytest.mark.parametrize(
    "box",
    [
        (6.2, 3.4, 6.3, 4.6),  # a board, wider than the mate
        (6.3, 3.95, 6.4, 4.05),  # a post, much thinner
        (6.2, 2.0, 6.9, 7.8),  # a wall that goes on
    ],
)
def test_what_is_not_round_or_not_of_the_mates_size_stays_a_wall(box):
    floor = LidarFloor(*WALLS, box)
    ranges_m = floor.ranges_m(SENSOR)
    circles = circles_for(circle(6.4, 4.9), ranges_m)
    assert len(circles) == 1


def goes_through(told, ranges_m, sensor=SENSOR):
    return sees_through(ANGLES_RAD, ranges_m, RANGE_M, sensor, told)


@settings(deadline=None, max_examples=60)
@given(bearing_rad=st.floats(-math.pi, math.pi), away_m=st.floats(0.8, 2.4), yaw_rad=st.floats(-math.pi, math.pi))
@example(bearing_rad=0.0, away_m=1.0, yaw_rad=-5e-324)
def test_a_place_that_beams_go_through_is_that_of_no_mate(bearing_rad, away_m, yaw_rad):
    sensor = Pose2D(SENSOR.x_m, SENSOR.y_m, yaw_rad)
    x_m, y_m = sensor.x_m + away_m * math.cos(bearing_rad), sensor.y_m + away_m * math.sin(bearing_rad)
    assert goes_through(circle(x_m, y_m), HALL.ranges_m(sensor), sensor)
    assert not goes_through(circle(x_m, y_m), HALL.ranges_m(sensor, circle(x_m, y_m)), sensor)


def test_what_is_hidden_is_not_seen_through():
    told = circle(5.0, 6.0)
    assert goes_through(told, HALL.ranges_m(SENSOR))
    assert not goes_through(told, HALL.ranges_m(SENSOR, circle(5.0, 5.0, 0.4))), "another robot stands before it"
    assert not goes_through(circle(5.0, 7.6), HALL.ranges_m(SENSOR)), "a wall is just behind it"
    assert not goes_through(circle(5.0, 9.0), HALL.ranges_m(SENSOR)), "it is behind a wall"
