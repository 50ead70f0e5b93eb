import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization.pose_filter import DriftModel, PoseFilter
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D

STEP = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
PLACE_M = st.floats(-20.0, 20.0)
SIGNAL = st.tuples(st.integers(0, 5), PLACE_M, PLACE_M, st.floats(-120.0, 0.0))
ROW = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
MATCH = st.tuples(ROW, st.floats(-1.0, 1.0), st.floats(1e-6, 10.0))


def fresh(**options):
    return PoseFilter(Pose2D(0.0, 0.0, 0.0), 0.02, 0.01, DriftModel(), PathLoss(), **options)


def is_sound(estimate):
    covariance = estimate.whole_covariance
    return (
        np.array_equal(covariance, covariance.T)
        and np.linalg.eigvalsh(covariance).min() > 0
        and all(map(math.isfinite, (estimate.pose.x_m, estimate.pose.y_m, estimate.pose.yaw_rad)))
    )


@settings(max_examples=60, deadline=None)
@given(events=st.lists(st.one_of(STEP, SIGNAL, MATCH), max_size=60))
def test_the_covariance_stays_symmetric_and_positive_definite_whatever_is_measured(events):
    estimate = fresh(motes=3)
    for event in events:
        if len(event) == 4:
            mote, x_m, y_m, rssi_dbm = event
            estimate.receive(RssiSample(f"m{mote}", Point2D(x_m, y_m), rssi_dbm))
        elif isinstance(event[0], tuple):
            estimate.correct(*event)
        else:
            estimate.move(Twist2D(*event))
        assert is_sound(estimate)


def test_it_stays_sound_over_ten_thousand_precise_measurements():
    estimate = fresh()
    for number in range(10_000):
        estimate.move(Twist2D(0.05, 0.0, 0.02))
        estimate.correct((1.0, 0.0, 0.0) if number % 2 else (0.0, 1.0, 0.0), 0.0, 1e-8)
        estimate.receive(RssiSample("m1", Point2D(3.0, 1.0), -75.0), math.inf)
    assert is_sound(estimate)


def test_a_mote_that_always_sounds_weak_does_not_draw_the_robot_away():
    estimate = PoseFilter(Pose2D(0.0, 0.0, 0.0), 1.0, 0.1, DriftModel(), PathLoss(decorrelation_m=1e6))
    weak = RssiSample("m1", Point2D(5.0, 0.0), PathLoss().mean_dbm(5.0) - 5.0)
    for _ in range(1000):
        estimate.receive(weak)
    assert estimate.sigma_m > 0.5
    assert abs(estimate.pose.x_m) < 1.0


@pytest.mark.parametrize(
    ("mote", "square_m2"),
    [(Point2D(4.0, 6.0), 25.0), (Point2D(-2.0, 2.0), 9.0), (Point2D(1.0, -2.0), 16.0), (Point2D(1.3, 2.4), 1.0)],
)
def test_the_nearer_a_mote_is_the_more_it_matters_how_unsure_the_map_is(mote, square_m2):
    variances_db2 = []
    for map_variance_m2 in (0.0, 0.04):
        estimate = PoseFilter(Pose2D(1.0, 2.0, 0.0), 0.1, 0.01, DriftModel(), PathLoss())
        heard = estimate.receive(RssiSample("m1", mote, -70.0), math.inf, map_variance_m2=map_variance_m2)
        variances_db2.append(heard.variance_db2)
    db_per_fold = 10.0 * PathLoss().exponent / math.log(10.0)
    assert variances_db2[1] - variances_db2[0] == pytest.approx(db_per_fold**2 * 0.04 / square_m2, rel=1e-6)


def test_memory_is_bounded_however_many_motes_are_heard():
    estimate = fresh(motes=4)
    for number in range(50):
        estimate.receive(RssiSample(f"m{number}", Point2D(float(number % 7), 3.0), -75.0))
    assert estimate.whole_covariance.shape == (10, 10)
    assert is_sound(estimate)
