import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization.surface_match import match_surface
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam.loop_closure import moved
from robrain.protocol.model.geometry import Pose2D
from tests.algorithms.mapping.lidar_floor import (
    CORRIDOR,
    CORRIDOR_PLACES,
    GEOMETRY,
    ROOM,
    ROOM_PLACES,
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


def test_eight_beams_are_enough():
    true = Pose2D(2.1, 3.0, 0.4)
    for count in (7, 8):
        points = ROOM.points(true)[:: len(ROOM.points(true)) // 8][:count]
        assert match_surface(ROOM_MAP, true, points)[0].beams == (8 if count == 8 else 0)


def test_an_empty_map_and_one_out_of_reach_hold_nothing():
    points = ROOM.points(Pose2D(2.1, 3.0, 0.4))
    fit, drift = match_surface(OccupancyGrid(GEOMETRY, surfaces=True), Pose2D(2.1, 3.0, 0.4), points)
    assert (fit.directions, fit.beams, drift) == ([], 0, (0.0, 0.0))
    fit, _ = match_surface(ROOM_MAP, Pose2D(500.0, -300.0, 0.4), points)
    assert (fit.directions, fit.beams) == ([], 0)
