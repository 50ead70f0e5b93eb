"""The arithmetic of scan matching: ends of beams, searches, eigenvalues against LAPACK's, and steps."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization import scan_match as kernels
from robrain.algorithms.localization.scan_match import REACH_M, beam_ends, match_walls, search_scan
from robrain.algorithms.mapping.occupancy_grid import HIT_DEPTH_CELLS
from robrain.protocol.model.geometry import Pose2D
from tests.algorithms.mapping.lidar_floor import GEOMETRY, ROOM, ROOM_PLACES


def match_scan(log_odds, geometry, guess, points, reach_m=REACH_M):
    """A scan matched as the middles of wall cells: its beams' ends, as deep in the walls as the mapper marks them."""
    deep = points * (1.0 + HIT_DEPTH_CELLS * geometry.resolution_m / np.hypot(*points.T))[:, None]
    return match_walls(log_odds, geometry, guess, deep, reach_m)


ROOM_MAP = ROOM.mapped(*ROOM_PLACES).log_odds


def test_ends_are_those_of_the_beams_that_returned():
    ranges_m = np.array([1.0, 0.0, -1.0, 2.0, 3.0, math.inf, math.nan, 0.001])
    angles_rad = np.array([0.0, 0.0, 0.0, math.pi / 2, 0.0, 0.0, 0.0, math.pi])
    ends = beam_ends(angles_rad, ranges_m, 3.0)
    assert ends == pytest.approx(np.array([(1.0, 0.0), (0.0, 2.0), (-0.001, 0.0)]), abs=1e-12)


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


@settings(deadline=None, max_examples=150)
@given(st.integers(0, 100_000), st.sampled_from([1.0, 1e-6, 1e6]), st.integers(1, 3), st.tuples(*[st.booleans()] * 6))
def test_eigenvalues_ascend_and_their_vectors_make_the_matrix(seed, scale, rank, is_zero):
    root = np.random.default_rng(seed).normal(0.0, 1.0, (3, rank)) * (1.0, 0.1, 30.0)[:rank]
    matrix = scale * root @ root.T
    for row, column, is_none in zip(*np.triu_indices(3), is_zero, strict=True):
        if is_none:
            matrix[row, column] = matrix[column, row] = 0.0
    values, vectors = np.zeros(3), np.zeros((3, 3))
    kernels.eigen(matrix.copy(), values, vectors)
    assert values == pytest.approx(np.linalg.eigvalsh(matrix), abs=1e-12 * np.abs(matrix).max())
    assert vectors @ vectors.T == pytest.approx(np.eye(3), abs=1e-12)
    assert vectors @ np.diag(values) @ vectors.T == pytest.approx(matrix, abs=1e-12 * np.abs(matrix).max())


def equations(rows, residuals, weights):
    information, pull = np.zeros((3, 3)), np.zeros(3)
    for row, residual, weight in zip(rows.tolist(), residuals.tolist(), weights.tolist(), strict=True):
        kernels.add_residual(information, pull, *row, residual, weight)
    return information, pull


def solved(information, pull, least):
    values, vectors, step = np.zeros(3), np.zeros((3, 3)), np.ones(3)
    held, length = kernels.solve_step(information, pull, least, values, vectors, step)
    return held, length, values, vectors, step


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 100_000))
def test_a_step_goes_to_the_weighted_least_squares(seed):
    rng = np.random.default_rng(seed)
    rows, residuals, weights = rng.normal(size=(12, 3)), rng.normal(size=12), rng.uniform(0.1, 2.0, 12)
    held, length, _, _, step = solved(*equations(rows, residuals, weights), 1e-9)
    root = np.sqrt(weights)
    assert held == 3
    assert step == pytest.approx(np.linalg.lstsq(rows * root[:, None], -residuals * root, rcond=None)[0], abs=1e-9)
    assert length == pytest.approx(np.linalg.norm(step))


def test_a_direction_with_little_information_is_not_held_and_followed_slowly():
    rows, residuals = np.eye(3) * (10.0, 2.0, 1.0), np.array((10.0, -2.0, 1.0))
    for least, held_count, expected in (
        (0.9, 3, (-1.0, 1.0, -1.0)),
        (1.0, 3, (-1.0, 1.0, -1.0)),
        (2.0, 2, (-1.0, 1.0, -0.5)),
        (8.0, 1, (-1.0, 0.5, -0.125)),
        (1000.0, 0, (-0.1, 0.004, -0.001)),
    ):
        held, _, values, _, step = solved(*equations(rows, residuals, np.ones(3)), least)
        assert (held, values.tolist()) == (held_count, [1.0, 4.0, 100.0])
        assert step == pytest.approx(expected)
