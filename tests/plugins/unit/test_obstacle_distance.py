import itertools
import math

import pytest

from robrain.protocol.can.frames import codec
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model.geometry import Pose2D

FAR = [0.0] * 180
"""A lidar that hits nothing."""


@pytest.fixture
def robot(stage):
    """A robot whose sensors say what the test has them say."""
    one = stage()
    one.host("obstacle_distance")
    bus, count = one.bus(), itertools.count()

    def ring(*ranges_m):
        values = {f"range_{sensor}_m": range_m for sensor, range_m in enumerate(ranges_m, 1)}
        bus.send(codec("RangeRing1").pack(next(count), **values))

    one.ring = ring
    return one


def scan_with(direction_deg, range_m):
    ranges_m = list(FAR)
    ranges_m[round((direction_deg + 180) / 2) % 180] = range_m
    return ranges_m


def test_before_any_sensor_has_spoken_nothing_is_known(robot):
    robot.run(0.5)
    view = robot.call("obstacle_distance", "view")
    assert view == {"distances_m": [None] * 12, "sees": [], "nearest_m": None, "nearest_rad": None, "touched_rad": []}


def test_what_the_lidar_sees_is_in_its_direction_from_the_hull(robot):
    robot.scan(scan_with(90, 1.0))
    robot.run(0.1)
    view = robot.call("obstacle_distance", "view", 4)
    assert view["distances_m"] == [None, 0.8, None, None]
    assert (view["nearest_m"], view["sees"]) == (0.8, ["scan"])
    assert view["nearest_rad"] == pytest.approx(math.pi / 2)


def test_of_two_sensors_the_nearer_counts(robot):
    robot.scan(scan_with(0, 1.0))
    robot.ring(0.4, 2.55, 2.55, 0.9, 2.55, 2.55)
    robot.run(0.1)
    view = robot.call("obstacle_distance", "view", 6)
    assert view["distances_m"] == [0.4, None, None, 0.9, None, None]
    assert view["sees"] == ["scan", "range_sensors"]


def test_a_sensor_that_is_not_fresh_is_left_out_and_not_named(robot):
    robot.scan(scan_with(0, 1.0))
    robot.ring(0.4, *[2.55] * 5)
    robot.run(0.45)
    assert robot.call("obstacle_distance", "view")["sees"] == ["scan"]
    assert robot.call("obstacle_distance", "view")["nearest_m"] == 0.8
    robot.run(0.3)
    assert robot.call("obstacle_distance", "view")["sees"] == []
    assert robot.call("obstacle_distance", "view")["nearest_m"] is None


def test_in_the_arena_the_nearest_wall_is_found(stage, room):
    one = stage(room(4.0, 4.0), r1=Pose2D(3.0, 2.0, math.pi / 2))
    one.host("obstacle_distance")
    one.run(1.0)
    view = one.call("obstacle_distance", "view", 8)
    assert view["nearest_m"] == pytest.approx(0.7, abs=0.05)  # the wall's inside at 3.9 m, to the right
    assert view["nearest_rad"] == pytest.approx(-math.pi / 2)
    assert view["sees"] == ["scan", "range_sensors"]


@pytest.mark.parametrize("sectors", [0, -1, 361])
def test_a_number_of_sectors_that_is_none_is_refused(robot, sectors):
    with pytest.raises(CallError, match="expected 1 to 360 sectors") as refusal:
        robot.call("obstacle_distance", "view", sectors)
    assert refusal.value.code is ErrorCode.BAD_ARGUMENTS
