import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.protocol.model import pose_filter_kernels as kernels
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.pose_filter import DriftModel, PoseFilter
from robrain.protocol.model.pose_mixture import PARTS_MAX, PoseMixture
from robrain.protocol.model.rssi_ranging import PathLoss, RssiSample

MOTES = [Point2D(x, y) for x in (-6.0, 0.0, 6.0) for y in (-6.0, 6.0)]
STEP = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
SIGNAL = st.tuples(st.integers(0, 5), st.floats(-120.0, 0.0))


def fresh(sigma_rad=0.01, **options):
    return PoseMixture(PoseFilter(Pose2D(0.0, 0.0, 0.0), 0.3, sigma_rad, DriftModel(), PathLoss(), motes=8), **options)


def heard(mote, rssi_dbm):
    return RssiSample(f"m{mote}", MOTES[mote], rssi_dbm)


def test_a_sure_yaw_is_one_filter_and_says_the_same_to_the_last_bit():
    one = PoseFilter(Pose2D(0.0, 0.0, 0.0), 0.3, 0.01, DriftModel(), PathLoss(), motes=8)
    mixture = fresh()
    for number in range(20):
        for each in (one, mixture):
            each.move(Twist2D(0.05, 0.0, 0.01))
        assert one.hear(heard(number % 6, -75.0)) == mixture.hear(heard(number % 6, -75.0))
    assert len(mixture) == 1
    assert (one.pose, one.biases, one.sigma_m, one.sigma_rad) == (
        mixture.pose,
        mixture.biases,
        mixture.sigma_m,
        mixture.sigma_rad,
    )
    assert np.array_equal(one.covariance, mixture.covariance)


def test_splitting_keeps_mean_and_covariance_of_all_states():
    one = PoseFilter(Pose2D(1.0, 2.0, 0.5), 0.3, 0.2, DriftModel(), PathLoss(), motes=8)
    for number in range(12):
        one.move(Twist2D(0.2, 0.0, 0.05))
        one.hear(heard(number % 6, -78.0))
    pose, covariance, biases = one.pose, one.whole_covariance, one.biases
    lower, upper = one.split(1.0575, 0.2252)
    assert lower.pose.yaw_rad < one.pose.yaw_rad < upper.pose.yaw_rad
    assert np.linalg.eigvalsh(one.whole_covariance).min() > 0
    upper.absorb(lower, 0.5)
    one.absorb(upper, 2 * 0.2252)
    assert (one.pose.x_m, one.pose.y_m, one.pose.yaw_rad) == pytest.approx((pose.x_m, pose.y_m, pose.yaw_rad))
    assert one.biases == pytest.approx(biases)
    assert one.whole_covariance == pytest.approx(covariance, abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(events=st.lists(st.one_of(STEP, SIGNAL), max_size=80), sigma_rad=st.floats(0.01, 1.0))
def test_whatever_is_measured_there_are_few_parts_and_their_covariance_is_sound(events, sigma_rad):
    mixture = fresh(sigma_rad)
    for event in events:
        if len(event) == 3:
            mixture.move(Twist2D(*event))
        else:
            mixture.hear(heard(*event))
        assert 1 <= len(mixture) <= PARTS_MAX
        covariance = mixture.covariance
        assert np.allclose(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance).min() > 0
        assert all(map(math.isfinite, (mixture.pose.x_m, mixture.pose.y_m, mixture.pose.yaw_rad)))


def test_a_yaw_that_walls_make_sure_is_one_filter_again():
    mixture = fresh(0.5)
    mixture.hear(heard(0, -80.0))
    assert len(mixture) > 1
    for _ in range(20):
        mixture.correct((0.0, 0.0, 1.0), -0.3 - mixture.pose.yaw_rad, 1e-4)
    assert len(mixture) == 1
    assert mixture.pose.yaw_rad == pytest.approx(-0.3, abs=0.02)


def test_what_is_put_somewhere_or_doubted_is_one_filter():
    for change in (lambda each: each.doubt(1.0, 1.0), lambda each: each.place(Pose2D(1.0, 0.0, 0.0), np.eye(3) / 10)):
        mixture = fresh(0.5)
        mixture.hear(heard(0, -80.0))
        assert len(mixture) > 1
        change(mixture)
        assert len(mixture) == 1


@pytest.mark.parametrize("yaw_rad", [-0.9, -0.4, 0.0, 0.5, 0.9])
def test_a_robot_that_does_not_know_its_yaw_finds_it_on_its_way(yaw_rad):
    rng = np.random.default_rng(3)
    errors, errors_of_one = [], []
    for _ in range(20):
        mixture, one = fresh(0.6), fresh(0.6, parts_max=1)
        true = Pose2D(0.0, 0.0, yaw_rad)
        for step in range(60):
            true = true.compose(Pose2D(0.1, 0.0, 0.0))
            mote = step % 6
            rssi_dbm = PathLoss().mean_dbm(true.distance_m(MOTES[mote])) + 4.0 * rng.standard_normal()
            for each in (mixture, one):
                each.move(Twist2D(0.1, 0.0, 0.0))
                each.hear(heard(mote, rssi_dbm))
        off = [[each.pose.x_m - true.x_m, each.pose.y_m - true.y_m] for each in (mixture, one)]
        errors.append(np.array(off[0]) @ np.linalg.solve(mixture.covariance[:2, :2], off[0]))
        errors_of_one.append(np.array(off[1]) @ np.linalg.solve(one.covariance[:2, :2], off[1]))
    assert np.mean(errors) < 3.0  # 2 if the covariance is right
    assert np.mean(errors) <= np.mean(errors_of_one) + 0.5


def test_the_two_most_alike_are_the_closest_pair():
    poses = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 1.0], [0.1, 0.0, 0.02], [-3.0, 1.0, -1.0]])
    covariances = np.tile(np.diag([0.1, 0.1, 0.01]), (4, 1, 1))
    first, second, loss = kernels.closest_pair(poses, covariances, np.full(4, 0.25))
    assert (first, second) == (0, 2)
    assert 0 < loss < 0.05
    assert kernels.closest_pair(poses[[0, 0]], covariances[:2], np.full(2, 0.5))[2] == pytest.approx(0.0, abs=1e-9)
