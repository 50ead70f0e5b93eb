"""The filter's arithmetic against textbook formulas: derivatives by differences, Kalman's equations, Gauss–Hermite."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from robrain.algorithms.localization import pose_filter as kernels

Floats = NDArray[np.float64]
SIZE, CAPACITY = 8, 9
"""Two motes, and room for a third that must not be touched."""
WALKS = np.array((0.0004, 0.0003, 0.0002, 3e-6, 2e-6, 1e-6))
SHADOW_DB2, DECORRELATION_M = 16.0, 5.0
AT_1_M_DBM, DB_PER_FOLD, NOISE_DB2 = -60.0, 13.0, 9.0
MOTE = (3.0, -2.0)
NO_GATE = math.inf


@st.composite
def states(draw: st.DrawFn) -> tuple[Floats, Floats]:
    """Mean and covariance of any correlated states."""
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    mean = np.zeros(CAPACITY)
    mean[:SIZE] = rng.normal(0.0, (1.0, 1.0, 2.0, 0.05, 0.05, 0.05, 3.0, 3.0))
    root = rng.normal(0.0, 1.0, (SIZE, SIZE)) * np.array((0.3, 0.3, 0.1, 0.02, 0.02, 0.02, 2.0, 2.0))[:, None]
    covariance = np.zeros((CAPACITY, CAPACITY))
    covariance[:SIZE, :SIZE] = root @ root.T + np.diag(np.full(SIZE, 1e-4))
    return mean, covariance


def moved(mean: Floats, forward_m: float, left_m: float, turn_rad: float) -> Floats:
    """How a displacement moves the states: half of the turn first, then the way, then the other half."""
    x, y, yaw, scale, curve, turn = mean[:6]
    turned_rad = (1.0 + turn) * turn_rad + curve * forward_m
    middle = yaw + turned_rad / 2.0
    way = (1.0 + scale) * np.array(
        (
            forward_m * math.cos(middle) - left_m * math.sin(middle),
            forward_m * math.sin(middle) + left_m * math.cos(middle),
        )
    )
    keep = math.exp(-math.hypot(forward_m, left_m) / DECORRELATION_M)
    return np.array((x + way[0], y + way[1], yaw + turned_rad, scale, curve, turn, *(keep * mean[6:SIZE])))


@settings(deadline=None, max_examples=60)
@given(states(), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.8, 0.8))
def test_a_prediction_is_that_of_the_motion_linearised(
    state: tuple[Floats, Floats], forward_m: float, left_m: float, turn_rad: float
) -> None:
    mean, covariance = state
    step = 1e-6
    jacobian = np.column_stack(
        [
            (
                moved(mean[:SIZE] + step * unit, forward_m, left_m, turn_rad)
                - moved(mean[:SIZE] - step * unit, forward_m, left_m, turn_rad)
            )
            / (2.0 * step)
            for unit in np.eye(SIZE)
        ]
    )
    path_m = math.hypot(forward_m, left_m)
    keep = math.exp(-path_m / DECORRELATION_M)
    noise = np.diag(
        (
            *(WALKS[0] * path_m,) * 2,
            WALKS[1] * path_m + WALKS[2] * abs(turn_rad),
            *(WALKS[3:] * path_m),
            *((1.0 - keep**2) * SHADOW_DB2,) * 2,
        )
    )
    expected = jacobian @ covariance[:SIZE, :SIZE] @ jacobian.T + noise
    expected_mean = moved(mean[:SIZE], forward_m, left_m, turn_rad)
    kernels.predict(mean, covariance, SIZE, forward_m, left_m, turn_rad, WALKS, SHADOW_DB2, DECORRELATION_M)
    assert mean[:SIZE] == pytest.approx(expected_mean, abs=1e-12)
    # Rounding in the differences of the Jacobian is 1e-9 of the value.
    assert covariance[:SIZE, :SIZE] == pytest.approx(expected, rel=1e-8, abs=1e-7)
    assert np.array_equal(covariance, covariance.T)
    assert not covariance[SIZE:].any()


def kalman(mean: Floats, covariance: Floats, row: Floats, innovation: float, variance: float) -> tuple[Floats, Floats]:
    """Mean and covariance after a measurement, by the textbook."""
    expected = row @ covariance @ row + variance
    gain = covariance @ row / expected
    return mean + gain * innovation, covariance - np.outer(gain, row @ covariance)


@settings(deadline=None, max_examples=60)
@given(
    states(),
    st.integers(2, SIZE - 1),
    st.tuples(*[st.floats(-1.0, 1.0)] * 3),
    st.floats(-1.0, 1.0),
    st.floats(1e-4, 1.0),
)
def test_an_update_is_kalmans(
    state: tuple[Floats, Floats],
    third: int,
    weights: tuple[float, float, float],
    innovation: float,
    variance: float,
) -> None:
    mean, covariance = state
    row = np.zeros(SIZE)
    row[[0, 1, third]] = weights
    expected = kalman(mean[:SIZE], covariance[:SIZE, :SIZE], row, innovation, variance)
    told = row @ covariance[:SIZE, :SIZE] @ row + variance
    assert kernels.update(mean, covariance, SIZE, third, *weights, innovation, variance) == pytest.approx(told)
    assert mean[:SIZE] == pytest.approx(expected[0], abs=1e-9)
    assert covariance[:SIZE, :SIZE] == pytest.approx(expected[1], abs=1e-9)
    assert np.array_equal(covariance, covariance.T)
    assert mean[SIZE:].tolist() == [0.0]


def strength_dbm(place: Floats) -> float:
    return AT_1_M_DBM - DB_PER_FOLD * math.log(max(math.hypot(place[0] - MOTE[0], place[1] - MOTE[1]), 0.1))


def regression(mean: Floats, covariance: Floats) -> tuple[Floats, float, float]:
    """Slopes, mean and left variance of the strength over a Gaussian of x and y, by 3 × 3 Gauss–Hermite points."""
    root = np.linalg.cholesky(covariance)
    nodes = ((-math.sqrt(3.0), 1 / 6), (0.0, 2 / 3), (math.sqrt(3.0), 1 / 6))
    points, weights = [], []
    for (a, weight_a), (b, weight_b) in itertools.product(nodes, nodes):
        points.append(root @ (a, b))
        weights.append(weight_a * weight_b)
    offsets, shares = np.array(points), np.array(weights)
    values = np.array([strength_dbm(mean + offset) for offset in offsets])
    middle = float(shares @ values)
    across = offsets.T @ (shares * (values - middle))
    slopes = np.linalg.solve(covariance, across)
    return slopes, middle, float(shares @ (values - middle) ** 2 - slopes @ covariance @ slopes)


SIGNAL = (MOTE[0], MOTE[1])
RADIO = (AT_1_M_DBM, DB_PER_FOLD, NOISE_DB2)


@settings(deadline=None, max_examples=80)
@given(states(), st.floats(-95.0, -55.0), st.integers(6, SIZE - 1))
def test_a_signal_is_taken_in_by_statistical_linear_regression(
    state: tuple[Floats, Floats], rssi_dbm: float, slot: int
) -> None:
    mean, covariance = state
    slopes, middle, left = regression(mean[:2], covariance[:2, :2])
    row = np.zeros(SIZE)
    row[:2], row[slot] = slopes, 1.0
    innovation = rssi_dbm - middle - mean[slot]
    variance = row @ covariance[:SIZE, :SIZE] @ row + left + NOISE_DB2
    expected = kalman(mean[:SIZE], covariance[:SIZE, :SIZE], row, innovation, left + NOISE_DB2)
    told = kernels.update_by_signal(mean, covariance, SIZE, slot, *SIGNAL, rssi_dbm, *RADIO, NO_GATE)
    assert told == pytest.approx((innovation**2 / variance, innovation, variance), rel=1e-6)
    assert mean[:SIZE] == pytest.approx(expected[0], abs=1e-6)
    assert covariance[:SIZE, :SIZE] == pytest.approx(expected[1], abs=1e-6)


def test_a_signal_at_the_gate_is_taken_and_one_beyond_it_changes_nothing() -> None:
    for gate, is_accepted in ((100.0, True), (1.0, False)):
        mean, covariance = np.zeros(CAPACITY), np.diag(np.full(CAPACITY, 1e-2))
        before = mean.copy(), covariance.copy()
        nis, _, _ = kernels.update_by_signal(mean, covariance, SIZE, 6, *SIGNAL, -55.0, *RADIO, gate)
        assert 1.0 < nis < 100.0
        assert np.array_equal(mean, before[0]) != is_accepted
        assert np.array_equal(covariance, before[1]) != is_accepted
