"""Thin walls with rooms on both sides: each side is a surface of its own, whichever way the wall runs."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization.surface_match import match_surface
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam.loop_closure import moved
from robrain.protocol.model.geometry import Pose2D
from tests.algorithms.mapping.lidar_floor import (
    ANGLES_RAD,
    CORRIDOR,
    CORRIDOR_PLACES,
    GEOMETRY,
    NOBODY,
    RANGE_M,
    ROOM,
    ROOM_PLACES,
    LidarFloor,
)

ROOM_MAP = ROOM.mapped(*ROOM_PLACES, drift=(0.04, 0.0025))
CORRIDOR_MAP = CORRIDOR.mapped(*CORRIDOR_PLACES)


@settings(deadline=None, max_examples=60)
@given(
    x_m=st.floats(0.8, 2.6),
    y_m=st.floats(0.8, 5.2),
    yaw_rad=st.floats(-3.1, 3.1),
    dx_m=st.floats(-0.15, 0.15),
    dy_m=st.floats(-0.15, 0.15),
    turn_rad=st.floats(-0.08, 0.08),
)
def test_in_a_room_a_wrong_guess_is_put_right_to_a_centimetre_and_a_third_of_a_degree(
    x_m, y_m, yaw_rad, dx_m, dy_m, turn_rad
):
    true = Pose2D(x_m, y_m, yaw_rad)
    guess = Pose2D(x_m - dx_m, y_m - dy_m, yaw_rad - turn_rad)
    fit, _ = match_surface(ROOM_MAP, guess, ROOM.points(true))
    assert len(fit.directions) == 3
    assert fit.fit > 0.9
    found = moved(guess, fit)
    assert found.distance_m(true) < 0.01
    assert math.remainder(found.yaw_rad - yaw_rad, math.tau) == pytest.approx(0.0, abs=math.radians(0.3))


def test_along_a_corridor_nothing_is_held():
    true, guess = Pose2D(6.0, 4.0, 0.1), Pose2D(6.1, 3.93, 0.06)
    fit, _ = match_surface(CORRIDOR_MAP, guess, CORRIDOR.points(true))
    assert len(fit.directions) == 2
    assert all(abs(direction.row[0]) < 0.05 for direction in fit.directions)
    found = moved(guess, fit)
    assert found.x_m == pytest.approx(guess.x_m, abs=0.01)
    assert (found.y_m, found.yaw_rad) == pytest.approx((true.y_m, true.yaw_rad), abs=0.01)


def test_an_empty_map_and_one_out_of_reach_hold_nothing():
    points = ROOM.points(Pose2D(2.1, 3.0, 0.4))
    fit, drift = match_surface(OccupancyGrid(GEOMETRY, surfaces=True), Pose2D(2.1, 3.0, 0.4), points)
    assert (fit.directions, fit.beams, drift) == ([], 0, (0.0, 0.0))
    fit, _ = match_surface(ROOM_MAP, Pose2D(500.0, -300.0, 0.4), points)
    assert (fit.directions, fit.beams) == ([], 0)


UPRIGHT = LidarFloor((5.92, 3.4, 6.06, 4.6), (0, 0, 12, 0.2), (0, 7.8, 12, 8))
LEVEL = LidarFloor((5.4, 3.92, 6.6, 4.06), (0, 0, 0.2, 8), (11.8, 0, 12, 8))
BOTH_SIDES = {
    "upright": (UPRIGHT, (1.0, 0.0), [Pose2D(3.9, 4.0, 0.0), Pose2D(8.1, 4.0, 0.0)]),
    "level": (LEVEL, (0.0, 1.0), [Pose2D(6.0, 1.9, 0.0), Pose2D(6.0, 6.1, 0.0)]),
}
"""Floor, direction across the wall, and a place on either side of it."""
CASES = [
    ("upright", Pose2D(4.2, 4.1, 0.3)),
    ("upright", Pose2D(7.9, 3.9, -2.3)),
    ("level", Pose2D(6.1, 2.2, 1.3)),
    ("level", Pose2D(5.9, 5.9, -0.3)),
]


def mapped(floor: LidarFloor, places: list[Pose2D]) -> OccupancyGrid:
    """What a robot has mapped that was on both sides of the wall, one after the other, several times."""
    grid = OccupancyGrid(GEOMETRY, surfaces=True)
    for stamp_ms, place in enumerate(places * 2, 1):
        grid.integrate_scan(place, ANGLES_RAD, floor.ranges_m(place), RANGE_M, stamp_ms, NOBODY)
    return grid


MAPS = {name: mapped(floor, places) for name, (floor, _, places) in BOTH_SIDES.items()}


@pytest.mark.parametrize(("name", "true"), CASES)
@pytest.mark.parametrize("across_m", [-0.1, -0.06, 0.03, 0.06, 0.1])
def test_a_scan_lies_on_the_side_of_a_thin_wall_that_it_has_seen(name: str, true: Pose2D, across_m: float) -> None:
    floor, (by_x, by_y), _ = BOTH_SIDES[name]
    guess = Pose2D(true.x_m + across_m * by_x, true.y_m + across_m * by_y, true.yaw_rad)
    fit, _ = match_surface(MAPS[name], guess, floor.points(true))
    found = moved(guess, fit)
    assert len(fit.directions) >= 2
    assert by_x * (found.x_m - true.x_m) + by_y * (found.y_m - true.y_m) == pytest.approx(0.0, abs=0.01)
