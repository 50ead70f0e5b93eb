"""The fixed-order linear algebra agrees with NumPy's to rounding, on well and badly conditioned matrices."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.numeric.elementary_functions import arctan2, exp, log, log10
from robrain.algorithms.numeric.small_linear_algebra import (
    covariance_of,
    dot,
    innovation_squared,
    inverse,
    inverse_form,
    is_semidefinite,
    least_solution,
    quadratic_form,
    times_vector,
)

seeds, sizes = st.integers(0, 2**32 - 1), st.integers(1, 6)


def drawn(seed: int, *shape: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) * 10.0 ** rng.uniform(-2, 2, size=shape)


def positive_definite(seed: int, size: int) -> np.ndarray:
    root = drawn(seed, size, size)
    return root @ root.T + 1e-3 * np.eye(size)


@given(seeds, sizes, sizes)
def test_products_are_those_of_numpy(seed: int, rows: int, columns: int) -> None:
    matrix, vector = drawn(seed, rows, columns), drawn(seed + 1, columns)
    scale = np.abs(matrix) @ np.abs(vector)
    np.testing.assert_array_less(np.abs(times_vector(matrix, vector) - matrix @ vector), 1e-13 * scale + 1e-300)
    assert dot(matrix[0], vector) == pytest.approx(matrix[0] @ vector, abs=1e-13 * float(scale[0]))


@given(seeds, sizes, sizes)
def test_covariance_of_rows_is_that_of_numpy(seed: int, rows: int, columns: int) -> None:
    matrix, covariance = drawn(seed, rows, columns), positive_definite(seed + 1, columns)
    found, wanted = covariance_of(matrix, covariance), matrix @ covariance @ matrix.T
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12 * float(np.abs(wanted).max()))
    assert quadratic_form(covariance, matrix[0]) == pytest.approx(wanted[0, 0], rel=1e-9)


@given(seeds, sizes)
def test_inverse_form_is_that_of_a_solved_system(seed: int, size: int) -> None:
    matrix, vector = positive_definite(seed, size), drawn(seed + 1, size)
    assert inverse_form(matrix, vector) == pytest.approx(
        float(vector @ np.linalg.solve(matrix, vector)), rel=1e-14 * float(np.linalg.cond(matrix)) + 1e-12
    )


@pytest.mark.parametrize("matrix", [np.zeros((2, 2)), np.diag([1.0, -1.0]), np.ones((2, 2)), np.full((2, 2), np.nan)])
def test_inverse_form_of_what_is_not_positive_definite_is_infinite(matrix: np.ndarray) -> None:
    assert inverse_form(matrix, np.array([1.0, 2.0])) == math.inf


@given(seeds, st.integers(1, 3))
def test_innovation_squared_is_that_of_a_state_seen_through_rows_with_noise(seed: int, count: int) -> None:
    rows, offsets, covariance = drawn(seed, count, 3), drawn(seed + 1, count), positive_definite(seed + 2, 3)
    variances = drawn(seed + 3, count) ** 2 + 0.1
    expected = rows @ covariance @ rows.T + np.diag(variances)
    assert innovation_squared(rows, covariance, offsets, variances) == pytest.approx(
        float(offsets @ np.linalg.solve(expected, offsets)), rel=1e-13 * float(np.linalg.cond(expected)) + 1e-12
    )


@given(seeds, st.integers(1, 3))
def test_least_solution_is_the_shortest_that_solves(seed: int, count: int) -> None:
    rows, values = drawn(seed, count, 3), drawn(seed + 1, count)
    wanted = np.linalg.lstsq(rows, values, rcond=None)[0]
    error = np.linalg.norm(least_solution(rows, values) - wanted)
    assert error <= 1e-14 * np.linalg.cond(rows) ** 2 * max(1.0, float(np.linalg.norm(wanted)))


@given(seeds)
def test_the_inverse_by_the_adjugate_is_that_of_numpy(seed: int) -> None:
    matrix = positive_definite(seed, 3)
    lifted = matrix + np.eye(3) * (1e-9 * np.trace(matrix) + 1e-12)
    found, wanted = inverse(matrix), np.linalg.inv(lifted)
    np.testing.assert_array_less(np.abs(found - wanted), 1e-12 * np.linalg.cond(lifted) ** 2 * np.abs(wanted).max())
    np.testing.assert_array_equal(found, found.T)


@given(seeds, st.integers(1, 3), st.floats(-3, 3))
def test_a_matrix_is_semidefinite_if_no_eigenvalue_is_negative(seed: int, rank: int, least: float) -> None:
    rng = np.random.default_rng(seed)
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    values = np.array((5.0, 5.0 * (rank > 1), 5.0 * (rank > 2)))
    assert is_semidefinite((axes * values) @ axes.T)
    assert is_semidefinite((axes * (5.0, 4.0, least)) @ axes.T) == (least >= 0) or abs(least) < 1e-6


values = st.lists(st.floats(-700.0, 700.0), min_size=1, max_size=20)


@given(values)
def test_each_entry_is_what_math_makes_of_it(given_values: list[float]) -> None:
    whole = np.array(given_values)
    above = np.abs(whole) + 1e-9
    assert exp(whole).tolist() == [math.exp(value) for value in given_values]
    assert log(above).tolist() == [math.log(value) for value in above.tolist()]
    assert log10(above).tolist() == [math.log10(value) for value in above.tolist()]
    assert arctan2(whole, above).tolist() == [math.atan2(*each) for each in zip(given_values, above, strict=True)]
