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
@given(events=st.lists(st.one_of(STEP, SIGNAL, MATCH), max_size=60), spread=st.sampled_from([0.0, math.sqrt(3.0)]))
def test_the_covariance_stays_symmetric_and_positive_definite_whatever_is_measured(events, spread):
    estimate = fresh(motes=3, spread=spread, relinearisations=1)
    for event in events:
        if len(event) == 4:
            mote, x_m, y_m, rssi_dbm = event
            estimate.hear(RssiSample(f"m{mote}", Point2D(x_m, y_m), rssi_dbm))
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
        estimate.hear(RssiSample("m1", Point2D(3.0, 1.0), -75.0), math.inf)
    assert is_sound(estimate)


def test_without_measurements_it_is_dead_reckoning_and_grows_less_sure():
    estimate = fresh()
    sigmas_m = []
    for _ in range(100):
        estimate.move(Twist2D(0.1, 0.0, 0.0))
        sigmas_m.append(estimate.sigma_m)
    assert (estimate.pose.x_m, estimate.pose.y_m) == pytest.approx((10.0, 0.0))
    assert sigmas_m == sorted(sigmas_m)
    # 3 % of the way ahead, and 0.03 rad/m · (10 m)² / 2 aside.
    assert estimate.sigma_m == pytest.approx(1.5, rel=0.1)


def test_the_prediction_agrees_with_a_cloud_of_robots():
    drift = DriftModel()
    rng = np.random.default_rng(2)
    scale, curve, turn = (rng.normal(0.0, sigma, 40_000) for sigma in (drift.scale, drift.curve_rad_per_m, drift.turn))
    x, y, yaw = (rng.normal(0.0, sigma, 40_000) for sigma in (0.02, 0.02, 0.01))
    estimate = fresh()
    for _ in range(40):
        estimate.move(Twist2D(0.1, 0.02, 0.03))
        turned = 0.03 * (1 + turn) + 0.1 * curve
        turned = turned + rng.normal(
            0, math.hypot(0.005 * math.sqrt(math.hypot(0.1, 0.02)), 0.01 * math.sqrt(0.03)), 40_000
        )
        middle = yaw + turned / 2
        x += (1 + scale) * (np.cos(middle) * 0.1 - np.sin(middle) * 0.02)
        y += (1 + scale) * (np.sin(middle) * 0.1 + np.cos(middle) * 0.02)
        yaw += turned
    cloud = np.cov(np.stack((x, y, yaw)))
    assert estimate.covariance == pytest.approx(cloud, rel=0.1, abs=2e-3)


@pytest.mark.slow
def test_errors_of_the_odometry_are_learned_from_what_walls_say():
    estimate = fresh()
    true = Pose2D(0.0, 0.0, 0.0)
    for _ in range(400):
        # The wheels are 2 % larger than believed, and the robot curves by 0.02 rad/m without noticing.
        true = true.compose(Pose2D(0.051 * math.cos(0.0005), 0.051 * math.sin(0.0005), 0.001))
        estimate.move(Twist2D(0.05, 0.0, 0.0))
        pose = estimate.pose
        for row, off in (((1.0, 0, 0), true.x_m - pose.x_m), ((0, 1.0, 0), true.y_m - pose.y_m)):
            estimate.correct(row, off, 0.02**2)
    scale, curve, _ = estimate.biases
    assert scale == pytest.approx(0.02, abs=0.006)
    assert curve == pytest.approx(0.02, abs=0.006)
    assert estimate.pose.distance_m(true) < 0.05


def test_a_signal_that_cannot_be_right_is_refused_and_changes_nothing():
    estimate = fresh()
    before = estimate.pose, estimate.covariance
    heard = estimate.hear(RssiSample("m1", Point2D(2.0, 0.0), -120.0))
    assert not heard.is_taken
    assert heard.nis > 10.83
    assert estimate.pose == before[0]
    assert np.array_equal(estimate.covariance, before[1])


def test_a_mote_that_always_sounds_weak_does_not_draw_the_robot_away():
    estimate = PoseFilter(Pose2D(0.0, 0.0, 0.0), 1.0, 0.1, DriftModel(), PathLoss(decorrelation_m=1e6))
    weak = RssiSample("m1", Point2D(5.0, 0.0), PathLoss().mean_dbm(5.0) - 5.0)
    for _ in range(1000):
        estimate.hear(weak)
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
        heard = estimate.hear(RssiSample("m1", mote, -70.0), math.inf, map_variance_m2=map_variance_m2)
        variances_db2.append(heard.variance_db2)
    db_per_fold = 10.0 * PathLoss().exponent / math.log(10.0)
    assert variances_db2[1] - variances_db2[0] == pytest.approx(db_per_fold**2 * 0.04 / square_m2, rel=1e-6)


def test_memory_is_bounded_however_many_motes_are_heard():
    estimate = fresh(motes=4)
    for number in range(50):
        estimate.hear(RssiSample(f"m{number}", Point2D(float(number % 7), 3.0), -75.0))
    assert estimate.whole_covariance.shape == (10, 10)
    assert is_sound(estimate)


@pytest.mark.parametrize("key", DriftModel.__struct_fields__)
def test_a_negative_drift_is_refused_by_name(key):
    with pytest.raises(ValueError, match=key):
        DriftModel(**{key: -0.1})
