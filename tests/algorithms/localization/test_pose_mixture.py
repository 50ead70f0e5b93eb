import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization.pose_filter import DriftModel, PoseFilter
from robrain.algorithms.localization.pose_mixture import PARTS_MAX, PoseMixture
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D

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
        assert one.receive(heard(number % 6, -75.0)) == mixture.receive(heard(number % 6, -75.0))
    assert len(mixture) == 1
    assert (one.pose, one.biases, one.sigma_m, one.sigma_rad) == (
        mixture.pose,
        mixture.biases,
        mixture.sigma_m,
        mixture.sigma_rad,
    )
    assert np.array_equal(one.covariance, mixture.covariance)


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(events=st.lists(st.one_of(STEP, SIGNAL), max_size=80), sigma_rad=st.floats(0.01, 1.0))
def test_whatever_is_measured_there_are_few_parts_and_their_covariance_is_sound(events, sigma_rad):
    mixture = fresh(sigma_rad)
    for event in events:
        if len(event) == 3:
            mixture.move(Twist2D(*event))
        else:
            mixture.receive(heard(*event))
        assert 1 <= len(mixture) <= PARTS_MAX
        covariance = mixture.covariance
        assert np.allclose(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance).min() > 0
        assert all(map(math.isfinite, (mixture.pose.x_m, mixture.pose.y_m, mixture.pose.yaw_rad)))


class SumOfThree:
    """A Gaussian sum of three parts, by the textbook: each filtered by itself, weighed by its likelihoods."""

    def __init__(self, filter):
        self.parts = [filter, *filter.split(1.0575, 0.2252)]
        self.weights = np.array((1.0 - 2 * 0.2252, 0.2252, 0.2252))

    @property
    def mean(self):
        return self.weights @ np.array([part.mean for part in self.parts])

    @property
    def covariance(self):
        offs = np.array([part.mean for part in self.parts])[:, :3] - self.mean[:3]
        each = [part.covariance + np.outer(off, off) for part, off in zip(self.parts, offs, strict=True)]
        return np.einsum("k,kij->ij", self.weights, np.array(each))

    def receive(self, sample, gate, map_variance_m2):
        heard = [part.receive(sample, gate, map_variance_m2=map_variance_m2) for part in self.parts]
        offs = np.array([each.innovation_db for each in heard])
        variances = np.array([each.variance_db2 for each in heard])
        mean = self.weights @ offs
        variance = self.weights @ (variances + offs**2) - mean**2
        self._weigh(np.exp(-0.5 * np.minimum([each.nis for each in heard], gate)) / np.sqrt(variances))
        return mean**2 / variance, mean, variance, any(each.is_accepted for each in heard)

    def correct(self, row, innovation, variance):
        row, mean = np.array(row), self.mean[:3]
        nis = innovation**2 / (row @ self.covariance @ row + variance)
        likelihoods = []
        for part in self.parts:
            own = innovation - row @ (part.mean[:3] - mean)
            expected = row @ part.covariance @ row + variance
            likelihoods.append(math.exp(-0.5 * own**2 / expected) / math.sqrt(expected))
            part.correct(tuple(row.tolist()), own, variance)
        self._weigh(np.array(likelihoods))
        return nis

    def _weigh(self, likelihoods):
        self.weights = self.weights * likelihoods / (self.weights @ likelihoods)


def assert_as(mixture, expected):
    assert len(mixture) == 3
    pose = mixture.pose
    assert (pose.x_m, pose.y_m, pose.yaw_rad) == pytest.approx(expected.mean[:3], abs=1e-9)
    assert mixture.biases == pytest.approx(expected.mean[3:], abs=1e-9)
    assert mixture.covariance == pytest.approx(expected.covariance, abs=1e-9)
    assert mixture.sigma_m == pytest.approx(math.sqrt(np.linalg.eigvalsh(expected.covariance[:2, :2])[-1]))
    assert mixture.sigma_rad == pytest.approx(math.sqrt(expected.covariance[2, 2]))


def wide():
    drift = DriftModel(scale=0.3, turn=0.2)
    filter = PoseFilter(Pose2D(0.0, 0.0, 0.0), 0.3, 0.5, drift, PathLoss(), motes=8)
    for _ in range(10):
        filter.move(Twist2D(0.3, 0.05, 0.05))
    return filter


@pytest.mark.parametrize("row", [(1.0, 0.0, 0.0), (0.6, 0.8, 0.0), (0.3, -0.2, 0.5)])
@pytest.mark.parametrize(("mote", "rssi_dbm", "gate"), [(2, -80.0, 10.83), (1, -70.0, 10.83), (1, -60.0, 1.0)])
def test_a_mixture_is_a_sum_of_gaussians_weighed_by_what_was_measured(row, mote, rssi_dbm, gate):
    mixture, expected = PoseMixture(wide()), SumOfThree(wide())
    told = mixture.receive(heard(mote, rssi_dbm), gate, map_variance_m2=0.5)
    nis, mean, variance, is_accepted = expected.receive(heard(mote, rssi_dbm), gate, 0.5)
    assert (told.nis, told.innovation_db, told.variance_db2) == pytest.approx((nis, mean, variance))
    assert told.is_accepted == is_accepted
    assert_as(mixture, expected)
    mixture.move(Twist2D(0.2, 0.1, 0.1))
    for part in expected.parts:
        part.move(Twist2D(0.2, 0.1, 0.1))
    assert_as(mixture, expected)
    assert mixture.correct(row, 0.1, 0.04) == pytest.approx(expected.correct(row, 0.1, 0.04))
    assert_as(mixture, expected)
    mixture.add((0.1, 0.2, 0.01))
    mixture.at_least((2.0, 0.0, 0.0))
    for part in expected.parts:
        part.add((0.1, 0.2, 0.01))
        part.at_least((2.0, 0.0, 0.0))
    assert_as(mixture, expected)
    mixture.shift(Pose2D(1.0, 2.0, 0.3))
    for part in expected.parts:
        part.shift(Pose2D(1.0, 2.0, 0.3))
    assert_as(mixture, expected)


PLACE_M = st.floats(-20.0, 20.0)
FAR_SIGNAL = st.tuples(st.integers(0, 5), PLACE_M, PLACE_M, st.floats(-120.0, 0.0))
ROW = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
MATCH = st.tuples(ROW, st.floats(-1.0, 1.0), st.floats(1e-6, 10.0))


def fresh_pose_filter(**options):
    return PoseFilter(Pose2D(0.0, 0.0, 0.0), 0.02, 0.01, DriftModel(), PathLoss(), **options)


def is_sound(estimate):
    covariance = estimate.whole_covariance
    return (
        np.array_equal(covariance, covariance.T)
        and np.linalg.eigvalsh(covariance).min() > 0
        and all(map(math.isfinite, (estimate.pose.x_m, estimate.pose.y_m, estimate.pose.yaw_rad)))
    )


@settings(max_examples=60, deadline=None)
@given(events=st.lists(st.one_of(STEP, FAR_SIGNAL, MATCH), max_size=60))
def test_the_covariance_stays_symmetric_and_positive_definite_whatever_is_measured(events):
    estimate = fresh_pose_filter(motes=3)
    for event in events:
        if len(event) == 4:
            mote, x_m, y_m, rssi_dbm = event
            estimate.receive(RssiSample(f"m{mote}", Point2D(x_m, y_m), rssi_dbm))
        elif isinstance(event[0], tuple):
            estimate.correct(*event)
        else:
            estimate.move(Twist2D(*event))
        assert is_sound(estimate)


def test_a_mote_that_always_sounds_weak_does_not_draw_the_robot_away():
    estimate = PoseFilter(Pose2D(0.0, 0.0, 0.0), 1.0, 0.1, DriftModel(), PathLoss(decorrelation_m=1e6))
    weak = RssiSample("m1", Point2D(5.0, 0.0), PathLoss().mean_dbm(5.0) - 5.0)
    for _ in range(1000):
        estimate.receive(weak)
    assert estimate.sigma_m > 0.5
    assert abs(estimate.pose.x_m) < 1.0


def test_memory_is_bounded_however_many_motes_are_heard():
    estimate = fresh_pose_filter(motes=4)
    for number in range(50):
        estimate.receive(RssiSample(f"m{number}", Point2D(float(number % 7), 3.0), -75.0))
    assert estimate.whole_covariance.shape == (10, 10)
    assert is_sound(estimate)


def test_what_is_put_somewhere_or_doubted_is_one_filter():
    for change in (lambda each: each.doubt(1.0, 1.0), lambda each: each.place(Pose2D(1.0, 0.0, 0.0), np.eye(3) / 10)):
        mixture = fresh(0.5)
        mixture.receive(heard(0, -80.0))
        assert len(mixture) > 1
        change(mixture)
        assert len(mixture) == 1


@pytest.mark.parametrize("begun", [lambda: fresh(0.1), lambda: PoseMixture(wide())])
def test_measurements_along_orthogonal_rows_are_corrected_one_by_one_by_what_the_others_have_left(begun):
    rows = np.array([(0.6, 0.8, 0.0), (-0.8, 0.6, 0.0), (0.0, 0.0, 1.0)])
    offsets, variances = np.array([0.2, -0.1, 0.05]), np.array([0.01, 0.02, 0.001])
    mixture, expected = begun(), begun()
    for each in (mixture, expected):
        each.receive(heard(2, -80.0))
        each.move(Twist2D(0.5, 0.0, 0.3))
    mixture.correct_along(rows, offsets, variances)
    start = expected.pose
    for row, offset, variance in zip(rows.tolist(), offsets.tolist(), variances.tolist(), strict=True):
        now = expected.pose
        done = np.dot(row, (now.x_m - start.x_m, now.y_m - start.y_m, now.yaw_rad - start.yaw_rad))
        expected.correct(tuple(row), offset - float(done), variance)
    assert mixture.covariance == pytest.approx(expected.covariance)
    assert mixture.covariances == pytest.approx(expected.covariance.ravel().tolist())
    assert (mixture.pose.x_m, mixture.pose.y_m) == pytest.approx((expected.pose.x_m, expected.pose.y_m))
    assert mixture.pose.yaw_rad == pytest.approx(expected.pose.yaw_rad)
