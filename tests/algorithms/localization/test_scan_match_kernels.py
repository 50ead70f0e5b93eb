"""The arithmetic of scan matching against plain definitions: all distances, and derivatives."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from robrain.algorithms.localization import scan_match as kernels
from robrain.algorithms.localization.scan_match import (
    AMBIGUOUS,
    DEGENERATE,
    REACH_M,
    SEARCH_STEP_RAD,
    beam_ends,
    match_walls,
    points_in_view,
    search_scan,
)
from robrain.algorithms.mapping.occupancy_grid import HIT_DEPTH_CELLS
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from tests.algorithms.mapping.lidar_floor import CORRIDOR, CORRIDOR_PLACES, GEOMETRY, ROOM, ROOM_PLACES


def match_scan(log_odds, geometry, guess, points, reach_m=REACH_M):
    """A scan matched as the middles of wall cells: its beams' ends, as deep in the walls as the mapper marks them."""
    deep = points * (1.0 + HIT_DEPTH_CELLS * geometry.resolution_m / np.hypot(*points.T))[:, None]
    return match_walls(log_odds, geometry, guess, deep, reach_m)


PER_M = 1.0 / GEOMETRY.resolution_m
ROOM_MAP = ROOM.mapped(*ROOM_PLACES).log_odds
CORRIDOR_MAP = CORRIDOR.mapped(*CORRIDOR_PLACES).log_odds


def walls_of(seed, share=0.05, shape=(20, 26)):
    rng = np.random.default_rng(seed)
    return rng.choice(np.array((50, -50, 0), np.int8), shape, p=(share, 0.6, 0.4 - share))


def distances(log_odds, first_row, first_column, rows, columns, reach):
    """From each cell of a window to the nearest wall, by scipy's distance transform."""
    margin = 100
    free = np.ones((log_odds.shape[0] + 2 * margin, log_odds.shape[1] + 2 * margin), np.bool_)
    free[margin:-margin, margin:-margin] = log_odds <= 0
    field = distance_transform_edt(free) if not free.all() else np.full(free.shape, math.inf)
    row, column = first_row + margin, first_column + margin
    return np.minimum(field[row : row + rows, column : column + columns], reach)


@settings(deadline=None, max_examples=40)
@given(
    st.integers(0, 1000),
    st.integers(-8, 22),
    st.integers(-8, 28),
    st.integers(1, 30),
    st.integers(1, 30),
    st.integers(1, 5),
)
def test_the_distance_is_that_to_the_nearest_wall(seed, first_row, first_column, rows, columns, reach):
    log_odds = walls_of(seed, 0.02)
    found = kernels.distance_window(log_odds, first_row, first_column, rows, columns, reach)
    assert found == pytest.approx(distances(log_odds, first_row, first_column, rows, columns, reach), abs=1e-5)


def ends_of(sensor, points):
    """Where the points lie, in cells from the grid's origin."""
    cos, sin = math.cos(sensor.yaw_rad), math.sin(sensor.yaw_rad)
    return PER_M * (np.array((sensor.x_m, sensor.y_m)) + points @ np.array([[cos, sin], [-sin, cos]]))


@settings(deadline=None, max_examples=30)
@given(st.floats(-1.0, 13.0), st.floats(-1.0, 9.0), st.floats(-3.1, 3.1), st.integers(0, 1000))
def test_a_point_is_in_view_if_there_is_floor_just_before_it(x_m, y_m, yaw_rad, seed):
    sensor = Pose2D(x_m, y_m, yaw_rad)
    rng = np.random.default_rng(seed)
    bearings_rad, ranges_m = rng.uniform(-math.pi, math.pi, 60), rng.uniform(0.05, 4.0, 60)
    points = np.column_stack((ranges_m * np.cos(bearings_rad), ranges_m * np.sin(bearings_rad)))
    expected = []
    for point, range_m in zip(points, ranges_m.tolist(), strict=True):
        is_seen = False
        for before_m in (0.2, 0.3):
            ((column, row),) = np.floor(ends_of(sensor, point[None] * max(range_m - before_m, 0.0) / range_m)).astype(
                int
            )
            is_seen = is_seen or (GEOMETRY.contains(row, column) and ROOM_MAP[row, column] < 0)
        if is_seen:
            expected.append(point.tolist())
    assert points_in_view(ROOM_MAP, GEOMETRY, sensor, points).tolist() == expected


SMALL = GridGeometry(0.1, -0.4, 0.7, 26, 20)


def scores_of(log_odds, guess, points, within_m, within_rad):
    """Score of each turn and offset in cells about the guess: 1 for each beam that ends in a wall, a half beside it."""
    steps, turns = math.ceil(within_m * 10), math.ceil(within_rad / SEARCH_STEP_RAD)
    deep = points * (1.0 + 0.1 * HIT_DEPTH_CELLS / np.hypot(*points.T))[:, None]
    margin = 60
    field = distances(log_odds, -margin, -margin, 20 + 2 * margin, 26 + 2 * margin, 2)
    found = {}
    for turn in range(-turns, turns + 1):
        angle = guess.yaw_rad + turn * SEARCH_STEP_RAD
        cos, sin = math.cos(angle), math.sin(angle)
        at = 10.0 * (np.array((guess.x_m + 0.4, guess.y_m - 0.7)) + deep @ np.array([[cos, sin], [-sin, cos]]))
        columns, rows = np.floor(at).astype(int).T
        for i in range(-steps, steps + 1):
            for j in range(-steps, steps + 1):
                found[turn, i, j] = float(np.sum(1.0 - field[rows + i + margin, columns + j + margin] / 2.0))
    return found


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.sampled_from([(0.3, 0.1), (0.55, 0.07), (0.1, 0.3)]))
def test_a_search_finds_the_best_place_and_says_nothing_if_another_is_nearly_as_good(seed, within):
    rng = np.random.default_rng(seed)
    log_odds = walls_of(seed, 0.08)
    cells = np.argwhere(log_odds > 0)[rng.permutation(np.count_nonzero(log_odds > 0))[:30]]
    true = Pose2D(*rng.uniform((0.3, 1.2), (1.5, 2.2)).tolist(), float(rng.uniform(-3.0, 3.0)))
    at = 0.1 * (cells[:, ::-1] + 0.5) + (-0.4, 0.7) - (true.x_m, true.y_m)
    cos, sin = math.cos(true.yaw_rad), math.sin(true.yaw_rad)
    points = at @ np.array([[cos, -sin], [sin, cos]])
    points = points[np.hypot(*points.T) > 0.05]
    guess = Pose2D(true.x_m + 0.1, true.y_m - 0.05, true.yaw_rad + 0.02)
    if len(points) < 20:
        return
    scores = scores_of(log_odds, guess, points, *within)
    best = max(scores, key=scores.__getitem__)
    others = [
        score
        for place, score in scores.items()
        if abs(place[0] - best[0]) > 8 or max(abs(place[1] - best[1]), abs(place[2] - best[2])) > 5
    ]
    found = search_scan(log_odds, SMALL, guess, points, within_m=within[0], within_rad=within[1])
    if scores[best] < 0.7 * len(points) or max(others, default=0.0) > AMBIGUOUS * scores[best]:
        assert found is None
        return
    assert found is not None
    turn = round((found.yaw_rad - guess.yaw_rad) / SEARCH_STEP_RAD)
    place = turn, round(10 * (found.y_m - guess.y_m)), round(10 * (found.x_m - guess.x_m))
    assert scores[place] == pytest.approx(scores[best])
    assert found.yaw_rad == pytest.approx(guess.yaw_rad + turn * SEARCH_STEP_RAD)


def bilinear(field, at):
    """Value between the middles of cells; (column, row) in cells."""
    column, row = np.floor(at - 0.5).astype(int)
    right, up = at - 0.5 - (column, row)
    low = field[row, column] * (1 - right) + field[row, column + 1] * right
    high = field[row + 1, column] * (1 - right) + field[row + 1, column + 1] * right
    return low * (1 - up) + high * up


def pulls(log_odds, sensor, points):
    """Information and gradient of half the sum of squared distances by x, y (cells) and yaw · lever, by differences."""
    margin, reach = 80, 4
    field = distances(log_odds, -margin, -margin, 80 + 2 * margin, 120 + 2 * margin, reach)
    deep = points * (1.0 + 0.1 * HIT_DEPTH_CELLS / np.hypot(*points.T))[:, None]
    lever = PER_M * math.sqrt(np.mean(np.sum(deep**2, axis=1)))
    step = 1e-6
    information, gradient = np.zeros((3, 3)), np.zeros(3)
    used = 0
    nudges = [Pose2D(0.1 * step, 0.0, 0.0), Pose2D(0.0, 0.1 * step, 0.0), Pose2D(0.0, 0.0, step / lever)]
    places = [ends_of(sensor, deep)] + [
        ends_of(Pose2D(sensor.x_m + n.x_m, sensor.y_m + n.y_m, sensor.yaw_rad + n.yaw_rad), deep) for n in nudges
    ]
    for each in np.stack(places, axis=1) + margin:
        here, *beside = (bilinear(field, at) for at in each)
        if here >= reach - 1:
            continue
        used += 1
        row = (np.array(beside) - here) / step
        weight = 1.0 / max(here, 1.0)
        information += weight * np.outer(row, row)
        gradient += weight * here * row
    return information, gradient, used, lever


def moved_by(guess, fit):
    rows = np.array([direction.row for direction in fit.directions])
    offsets_m = [direction.offset_m for direction in fit.directions]
    x_m, y_m, yaw_rad = np.linalg.lstsq(rows, offsets_m, rcond=None)[0].tolist()
    return Pose2D(guess.x_m + x_m, guess.y_m + y_m, guess.yaw_rad + yaw_rad)


@pytest.mark.parametrize(
    ("log_odds", "floor", "true"),
    [
        (ROOM_MAP, ROOM, Pose2D(1.2, 1.3, 0.3)),
        (ROOM_MAP, ROOM, Pose2D(2.4, 4.7, -2.0)),
        (ROOM_MAP, ROOM, Pose2D(6.9, 5.0, 3.0)),
        (CORRIDOR_MAP, CORRIDOR, Pose2D(5.4, 4.2, 0.1)),
    ],
)
@pytest.mark.parametrize("wrong", [(0.06, -0.04, 0.03), (-0.09, 0.02, -0.05)])
def test_at_the_place_found_the_distances_pull_nowhere_that_the_walls_hold(log_odds, floor, true, wrong):
    guess = Pose2D(true.x_m + wrong[0], true.y_m + wrong[1], true.yaw_rad + wrong[2])
    fit = match_scan(log_odds, GEOMETRY, guess, floor.points(true))
    place = moved_by(guess, fit)
    information, gradient, used, lever = pulls(log_odds, place, floor.points(true))
    values = np.linalg.eigvalsh(information)
    assert len(fit.directions) == np.count_nonzero(values >= DEGENERATE * used)
    for direction, value in zip(fit.directions, values[3 - len(fit.directions) :], strict=True):
        assert direction.information == pytest.approx(value, rel=0.1 if floor is CORRIDOR else 0.05)
        vector = np.array((*direction.row[:2], direction.row[2] * PER_M / lever))
        assert np.linalg.norm(vector) == pytest.approx(1.0, rel=1e-6)
        assert information @ vector == pytest.approx(value * vector, abs=0.1 * values[-1])
        assert vector @ gradient / value == pytest.approx(0.0, abs=0.05)


def test_a_point_beside_the_map_or_on_unknown_floor_far_from_walls_is_not_compared():
    log_odds = np.zeros(GEOMETRY.shape, np.int8)
    log_odds[40, 20:100] = 50
    log_odds[39, 20:60] = -50
    bearings_rad = np.linspace(0.4, math.pi - 0.4, 200)
    points = np.column_stack((np.cos(bearings_rad), np.sin(bearings_rad))) * (1.0 / np.sin(bearings_rad))[:, None]
    fit = match_scan(log_odds, GEOMETRY, Pose2D(6.0, 3.0, 0.0), points)
    assert fit.beams == 200
    assert fit.fit == 1.0
    beyond = np.vstack((points, points + np.array((0.0, 3.0)), points - np.array((20.0, 0.0))))
    fit = match_scan(log_odds, GEOMETRY, Pose2D(6.0, 3.0, 0.0), beyond)
    assert fit.beams == 200
    known = log_odds.copy()
    known[65:75] = -50
    fit = match_scan(known, GEOMETRY, Pose2D(6.0, 3.0, 0.0), beyond)
    assert (fit.beams, fit.fit) == (400, 0.5)


@pytest.mark.parametrize("count", [19, 20])
def test_a_match_takes_twenty_beams(count):
    true = Pose2D(2.4, 4.7, -2.0)
    points = ROOM.points(true)[:: len(ROOM.points(true)) // count][:count]
    fit = match_scan(ROOM_MAP, GEOMETRY, true, points, REACH_M)
    assert bool(fit.beams) == (count == 20)
    assert bool(fit.directions) == (count == 20)
    found = search_scan(ROOM_MAP, GEOMETRY, true, points, within_m=0.1, within_rad=0.035)
    assert (found is not None) == (count == 20)


def test_ends_are_those_of_the_beams_that_returned():
    ranges_m = np.array([1.0, 0.0, -1.0, 2.0, 3.0, math.inf, math.nan, 0.001])
    angles_rad = np.array([0.0, 0.0, 0.0, math.pi / 2, 0.0, 0.0, 0.0, math.pi])
    ends = beam_ends(angles_rad, ranges_m, 3.0)
    assert ends == pytest.approx(np.array([(1.0, 0.0), (0.0, 2.0), (-0.001, 0.0)]), abs=1e-12)


def test_where_the_maps_origin_is_makes_no_difference():
    moved = GridGeometry(0.1, 3.0, -2.0, *GEOMETRY.shape[::-1])
    true = Pose2D(2.4, 4.7, -2.0)
    there = Pose2D(true.x_m + 3.0, true.y_m - 2.0, true.yaw_rad)
    points = ROOM.points(true)
    assert np.array_equal(
        points_in_view(ROOM_MAP, moved, there, points), points_in_view(ROOM_MAP, GEOMETRY, true, points)
    )
    one, other = match_scan(ROOM_MAP, moved, there, points), match_scan(ROOM_MAP, GEOMETRY, true, points)
    assert (one.fit, one.beams) == (other.fit, other.beams)
    for a, b in zip(one.directions, other.directions, strict=True):
        assert a.row == pytest.approx(b.row, abs=1e-6)
        assert a.offset_m == pytest.approx(b.offset_m, abs=1e-6)


def test_a_robot_beyond_the_map_is_no_crash():
    ends = ROOM.points(Pose2D(2.1, 3.0, 0.4))
    assert match_scan(ROOM_MAP, GEOMETRY, Pose2D(-50.0, 300.0, 0.0), ends).beams == 0
    assert search_scan(ROOM_MAP, GEOMETRY, Pose2D(-50.0, 300.0, 0.0), ends, within_m=1.0, within_rad=0.1) is None


@pytest.mark.parametrize("turns", [-10, 10, 0])
@pytest.mark.parametrize(("columns", "rows"), [(-9, 0), (9, 0), (0, -9), (0, 9), (9, 9), (-9, -9)])
def test_a_place_at_the_very_end_of_what_is_searched_is_found(columns, rows, turns):
    true = Pose2D(2.15, 3.05, 0.4)
    guess = Pose2D(true.x_m - 0.1 * columns, true.y_m - 0.1 * rows, true.yaw_rad - 0.035 * turns)
    found = search_scan(ROOM_MAP, GEOMETRY, guess, ROOM.points(true), within_m=0.9, within_rad=0.35)
    assert found is not None
    assert found.distance_m(true) < 0.06
    assert found.yaw_rad == pytest.approx(true.yaw_rad, abs=0.02)
