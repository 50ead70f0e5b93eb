"""Eigenvalues against LAPACK's, and steps and held directions against plain least squares."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization import scan_match as kernels


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


def test_held_directions_are_those_with_most_information_and_say_how_far_the_scan_went_along_them():
    values, vectors = np.array((1.0, 4.0, 100.0)), np.eye(3)[:, ::-1].copy()  # yaw, y, x
    found = kernels.held_directions(2, values, vectors, (3.0, -5.0, 7.0), 20.0, 10.0)
    assert found[:2].tolist() == [[0.0, 1.0, 0.0, -0.5, 4.0], [1.0, 0.0, 0.0, 0.3, 100.0]]
    found = kernels.held_directions(3, values, vectors, (3.0, -5.0, 7.0), 20.0, 10.0)
    assert found[0].tolist() == [0.0, 0.0, 2.0, 0.7, 1.0], "a turn of 0.35 rad moves the points by 7 cells"


def test_the_lever_is_by_how_many_cells_a_turn_moves_the_points():
    assert kernels.lever_of(np.array(((3.0, 4.0),)), 10.0) == pytest.approx(50.0)
    assert kernels.lever_of(np.array(((1.0, 0.0), (0.0, -7.0))), 1.0) == pytest.approx(5.0)
