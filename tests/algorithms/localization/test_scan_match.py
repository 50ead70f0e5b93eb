import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization.scan_match import beam_ends, search_scan
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.mapping.ray_cast import cast_rays
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from tests.algorithms.localization.test_scan_match_kernels import match_scan

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 120, 80)
ANGLES_RAD = np.linspace(-math.pi, math.pi, 180, endpoint=False)
RANGE_M = 6.0
NOBODY = np.empty((0, 3))


def walls(*boxes):
    solid = np.zeros(GEOMETRY.shape, np.bool_)
    for x0, y0, x1, y1 in boxes:
        solid[round(y0 * 10) : round(y1 * 10), round(x0 * 10) : round(x1 * 10)] = True
    return solid


ROOM = walls((0, 0, 8, 0.2), (0, 0, 0.2, 6), (7.8, 0, 8, 6), (0, 5.8, 8, 6), (3, 2, 3.7, 2.6), (5.5, 3.4, 6.4, 4))
CORRIDOR = walls((0, 2.8, 12, 3), (0, 5, 12, 5.2))


def seen(solid, pose):
    return cast_rays(solid, GEOMETRY, pose, ANGLES_RAD, RANGE_M, NOBODY)


def mapped(solid, *places):
    grid = OccupancyGrid(GEOMETRY)
    for stamp, place in enumerate(places):
        grid.integrate_scan(place, ANGLES_RAD, seen(solid, place), RANGE_M, stamp, NOBODY)
    return grid.log_odds


ROOM_MAP = mapped(ROOM, *(Pose2D(x, y, 0.1 * x) for x in (1.0, 2.0, 4.5, 7.0) for y in (1.0, 3.1, 5.0)))
CORRIDOR_MAP = mapped(CORRIDOR, *(Pose2D(float(x), 4.0, 0.0) for x in range(1, 12)))


def offset(fit):
    """The least offset that has what the directions say: x, y, yaw."""
    rows = np.array([direction.row for direction in fit.directions])
    return np.linalg.lstsq(rows, [direction.offset_m for direction in fit.directions], rcond=None)[0]


@settings(max_examples=60, deadline=None)
@given(
    x_m=st.floats(0.6, 2.6),
    y_m=st.floats(0.6, 5.2),
    yaw_rad=st.floats(-3.1, 3.1),
    dx_m=st.floats(-0.2, 0.2),
    dy_m=st.floats(-0.2, 0.2),
    turn_rad=st.floats(-0.08, 0.08),
)
@example(x_m=2.25, y_m=0.75, yaw_rad=0.0, dx_m=-0.1875, dy_m=0.0, turn_rad=-0.0625)  # seems degenerate from the guess
def test_a_wrong_guess_in_a_room_is_found_out(x_m, y_m, yaw_rad, dx_m, dy_m, turn_rad):
    true = Pose2D(x_m, y_m, yaw_rad)
    guess = Pose2D(x_m - dx_m, y_m - dy_m, yaw_rad - turn_rad)
    fit = match_scan(ROOM_MAP, GEOMETRY, guess, beam_ends(ANGLES_RAD, seen(ROOM, true), RANGE_M))
    assert len(fit.directions) == 3
    assert fit.fit > 0.9
    assert offset(fit) == pytest.approx((dx_m, dy_m, turn_rad), abs=0.05)
    for direction in fit.directions:
        wanted = float(np.dot(direction.row, (dx_m, dy_m, turn_rad)))
        assert direction.offset_m == pytest.approx(wanted, abs=0.05 * max(1.0, float(np.linalg.norm(direction.row))))


@settings(max_examples=60, deadline=None)
@given(
    x_m=st.floats(3.0, 9.0),
    y_m=st.floats(3.5, 4.5),
    yaw_rad=st.floats(-3.1, 3.1),
    dx_m=st.floats(-0.2, 0.2),
    dy_m=st.floats(-0.2, 0.2),
    turn_rad=st.floats(-0.08, 0.08),
)
def test_nowhere_in_a_corridor_is_the_way_along_it_believed(x_m, y_m, yaw_rad, dx_m, dy_m, turn_rad):
    true = Pose2D(x_m, y_m, yaw_rad)
    guess = Pose2D(x_m - dx_m, y_m - dy_m, yaw_rad - turn_rad)
    fit = match_scan(CORRIDOR_MAP, GEOMETRY, guess, beam_ends(ANGLES_RAD, seen(CORRIDOR, true), RANGE_M))
    assert len(fit.directions) == 2
    assert all(abs(direction.row[0]) < 0.1 for direction in fit.directions)
    assert offset(fit)[1] == pytest.approx(dy_m, abs=0.04)


def test_a_scan_from_elsewhere_fits_badly():
    ends = beam_ends(ANGLES_RAD, seen(ROOM, Pose2D(6.9, 1.0, 0.0)), RANGE_M)
    assert match_scan(ROOM_MAP, GEOMETRY, Pose2D(1.0, 5.0, 1.0), ends).fit < 0.6


def test_a_robot_beyond_the_map_is_no_crash():
    ends = beam_ends(ANGLES_RAD, np.full(180, 2.0), RANGE_M)
    assert match_scan(ROOM_MAP, GEOMETRY, Pose2D(-50.0, 300.0, 0.0), ends).beams == 0
    assert search_scan(ROOM_MAP, GEOMETRY, Pose2D(-50.0, 300.0, 0.0), ends, within_m=1.0, within_rad=0.1) is None


def test_a_map_of_another_shape_is_refused():
    with pytest.raises(ValueError, match="expected a map"):
        match_scan(ROOM_MAP[1:], GEOMETRY, Pose2D(0, 0, 0), np.ones((30, 2)))
    with pytest.raises(ValueError, match="angles and ranges"):
        beam_ends(ANGLES_RAD, np.ones(3), RANGE_M)


@pytest.mark.parametrize(("short_m", "agrees"), [(0.1, True), (0.15, True), (0.3, False), (1.0, False)])
def test_the_fit_is_the_share_of_beams_that_end_within_two_decimetres_of_a_wall(short_m, agrees):
    true = Pose2D(2.1, 3.0, 0.4)
    ranges_m = seen(ROOM, true)
    ranges_m[::4] -= short_m
    fit = match_scan(ROOM_MAP, GEOMETRY, true, beam_ends(ANGLES_RAD, ranges_m, RANGE_M))
    assert fit.fit == pytest.approx(1.0 if agrees else 0.75, abs=0.06)


@pytest.mark.parametrize("turns", [-10, 10, 0])
@pytest.mark.parametrize(("columns", "rows"), [(-9, 0), (9, 0), (0, -9), (0, 9), (9, 9), (-9, -9)])
def test_a_place_at_the_very_end_of_what_is_searched_is_found(columns, rows, turns):
    true = Pose2D(2.15, 3.05, 0.4)
    guess = Pose2D(true.x_m - 0.1 * columns, true.y_m - 0.1 * rows, true.yaw_rad - 0.035 * turns)
    points = beam_ends(ANGLES_RAD, seen(ROOM, true), RANGE_M)
    found = search_scan(ROOM_MAP, GEOMETRY, guess, points, within_m=0.9, within_rad=0.35)
    assert found is not None
    assert found.distance_m(true) < 0.06
    assert found.yaw_rad == pytest.approx(true.yaw_rad, abs=0.02)
