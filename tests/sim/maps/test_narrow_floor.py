"""Whole runs on floors with passages hardly wider than the robots, or narrower."""

import json

import msgspec
import pytest

from robrain import Scenario
from robrain.protocol.model.geometry import Point2D
from robrain.sim.maps.drawing import Block, FloorDrawing
from robrain.sim.robot.robot_hardware import RobotHardware
from robrain.sim.world.referee import GapTooNarrow

pytestmark = pytest.mark.slow

ROOM_M = 4.0
HEIGHT_M = 4.4


def two_rooms(gap_m, *, long_m=2.0, low_m=2.0, resolution_m=0.05):
    """Two rooms of 4 × 4.4 m, joined by a corridor."""
    return FloorDrawing(
        size_m=(2 * ROOM_M + long_m, HEIGHT_M),
        resolution_m=resolution_m,
        blocks=(
            Block(ROOM_M, 0.0, long_m, low_m),
            Block(ROOM_M, low_m + gap_m, long_m, HEIGHT_M - low_m - gap_m),
        ),
    )


def scenario(floor, *, robots=2, seed=1, radius_m=0.2):
    return Scenario(
        name="two rooms",
        floor=floor,
        robots=robots,
        near=Point2D(2.0, 2.0),
        seed=seed,
        hardware=RobotHardware(radius_m=radius_m),
        until_explored=0.99,
        time_limit_s=120.0,
    )


def test_two_rooms_joined_by_forty_five_centimetres_are_explored_without_touching_a_wall():
    result = scenario(two_rooms(0.45, low_m=1.95), seed=2).run()
    assert result.ended == "explored"
    assert result.collisions == 0
    assert result.floor_left == []


def test_floor_behind_a_gap_that_no_robot_fits_through_is_not_asked_of_them_and_is_named():
    """Robots 0.46 m in diameter in front of the same corridor."""
    result = scenario(two_rooms(0.45), radius_m=0.23).run()
    assert result.ended == "explored"
    (left,) = result.floor_left
    assert left.place.x_m > ROOM_M
    assert left.area_m2 == pytest.approx(16.0, rel=0.1)
    assert left.why == GapTooNarrow(gap_m=pytest.approx(0.45, abs=0.03), needed_m=0.5)
    assert left.words.endswith("m wide, robots need 0.50 m")
    told = json.loads(msgspec.json.encode(result))["floor_left"][0]
    assert told["why"]["code"] == "gap_too_narrow"
