"""Accuracy of a robot's poses, and whether it reports when they are wrong."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.localization.pose_accuracy import PoseAccuracyMeter, nees, position_sigma_m
from robrain.protocol.model.geometry import Pose2D

HERE = Pose2D(0.0, 0.0, 0.0)
SURE = (0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01)
"""0.1 m and 0.1 rad."""


def covariance(sigma_m, sigma_rad=0.1):
    return (sigma_m**2, 0.0, 0.0, 0.0, sigma_m**2, 0.0, 0.0, 0.0, sigma_rad**2)


def fed(*samples, step_s=0.2):
    """What a meter says after samples of (error in m, covariance, lost), `step_s` apart."""
    meter = PoseAccuracyMeter()
    for number, (error_m, told, lost) in enumerate(samples):
        meter.add(number * step_s, Pose2D(error_m, 0.0, 0.0), told, lost, HERE)
    return meter.accuracy


def test_errors_are_those_of_the_samples():
    told = fed((0.3, SURE, ""), (-0.4, SURE, ""))
    assert told.samples == 2
    assert told.rmse_m == pytest.approx(math.sqrt(0.125))
    assert told.max_error_m == pytest.approx(0.4)
    assert told.error_m == pytest.approx(0.4)
    assert told.nees == pytest.approx(12.5)
    assert told.nees_in_band == 0.0


def test_lost_robot_counts_for_the_time_that_it_is_lost_and_for_no_error():
    told = fed((0.0, SURE, ""), (9.0, SURE, "nobody knows"), (9.0, SURE, "nobody knows"), (0.1, SURE, ""))
    assert told.samples == 2
    assert told.max_error_m == pytest.approx(0.1)
    assert told.lost_s == pytest.approx(0.4)
    assert told.silent_divergence_s == 0.0
    assert not told.is_lost
    assert fed((9.0, SURE, "nobody knows")).is_lost


@pytest.mark.parametrize(
    ("error_m", "told", "is_silent"),
    [
        (0.51, SURE, True),
        (0.49, SURE, False),  # not far enough off
        (0.5, SURE, False),  # exactly at the bound
        (0.9, covariance(0.31), False),  # it says so: three standard deviations reach
        (0.9, covariance(0.29), True),
        (0.9, (0.0001, 0.0, 0.0, 0.0, 0.0961, 0.0, 0.0, 0.0, 0.01), False),  # its worst direction counts
        (0.9, (), True),  # a robot that tells no covariance says nothing
    ],
)
def test_robot_is_silently_off_if_it_is_far_off_and_does_not_say_so(error_m, told, is_silent):
    accuracy = fed((error_m, told, ""), (error_m, told, ""))
    assert accuracy.silent_divergence_s == pytest.approx(0.2 if is_silent else 0.0)
    assert accuracy.silent_for_s == accuracy.silent_divergence_s


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1))
def test_nees_is_the_squared_mahalanobis_distance(seed):
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(3, 3)) + 2.0 * np.eye(3)
    matrix, error = factor @ factor.T, rng.normal(size=3)
    found = nees(tuple(matrix.ravel().tolist()), *error.tolist())
    assert found is not None
    assert found[0] == pytest.approx(error[:2] @ np.linalg.solve(matrix[:2, :2], error[:2]), rel=1e-6)
    assert found[1] == pytest.approx(error @ np.linalg.solve(matrix, error), rel=1e-6)


@given(st.integers(0, 2**32 - 1))
def test_told_deviation_is_that_of_the_worst_direction(seed):
    factor = np.random.default_rng(seed).normal(size=(3, 3))
    matrix = factor @ factor.T
    expected_m = math.sqrt(np.linalg.eigvalsh(matrix[:2, :2])[-1])
    assert position_sigma_m(tuple(matrix.ravel().tolist())) == pytest.approx(expected_m, rel=1e-9)
