"""Where a robot is by its motes, against the posterior computed plainly."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization.mote_relocalisation import RECORDS, RecentSignals, Signals, find_robot
from robrain.algorithms.localization.odometry import moved_along
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D

LOSS = PathLoss(shadowing_db=3.0, fading_db=2.0)
CLEAR = PathLoss(shadowing_db=1.0, fading_db=1.0)
MOTES = np.array([(x, y) for x in (2.0, 9.0, 17.0) for y in (3.0, 10.0, 18.0)])
WAY = np.array([(0.12 * k - 6.0, 2.0 * math.sin(k / 8)) for k in range(60)])


def heard(true, seed=8, motes=MOTES, way=WAY, loss=LOSS):
    """Signals of a robot that is there now and has come this way, seen from there."""
    rng = np.random.default_rng(seed)
    numbers = rng.integers(0, len(motes), len(way))
    shadows_db = loss.shadowing_db * rng.standard_normal(len(motes))
    rssi_dbm = [
        loss.mean_dbm(math.dist(place, motes[mote])) + shadows_db[mote] + loss.fading_db * rng.standard_normal()
        for place, mote in zip(
            arena_places(np.array([(true.x_m, true.y_m, true.yaw_rad)]), way)[0], numbers, strict=True
        )
    ]
    return Signals(way, numbers, motes, np.array(rssi_dbm))


def arena_places(poses, places):
    """(P, N, 2): places seen from each of the poses (P, 3), in the arena."""
    cos, sin = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x, y = places.T
    return np.stack((poses[:, :1] + cos * x - sin * y, poses[:, 1:2] + sin * x + cos * y), axis=2)


def log_likelihoods(poses, signals, loss):
    """A Gaussian in dB for each mote: its shadowing is the same for all of its signals."""
    poses = np.array([(pose.x_m, pose.y_m, pose.yaw_rad) for pose in poses])
    away = arena_places(poses, signals.places) - signals.mote_places[signals.motes]
    distances_m = np.maximum(np.hypot(away[..., 0], away[..., 1]), 0.1)
    offs = signals.rssi_dbm - (loss.rssi_at_1_m_dbm - 10.0 * loss.exponent * np.log10(distances_m))
    total = np.zeros(len(poses))
    for mote in set(signals.motes.tolist()):
        own = offs[:, signals.motes == mote]
        covariance = loss.fading_db**2 * np.eye(own.shape[1]) + loss.shadowing_db**2
        total -= 0.5 * np.einsum("pi,ij,pj->p", own, np.linalg.inv(covariance), own)
    return total


@pytest.mark.parametrize(
    ("true", "seed", "loss"),
    [
        (Pose2D(12.0, 7.0, 1.3), 7, LOSS),
        (Pose2D(5.0, 12.0, -2.0), 2, LOSS),
        (Pose2D(-3.4, 6.0, 0.4), 3, CLEAR),  # beyond the motes
        (Pose2D(22.5, 20.0, 3.1), 4, CLEAR),
    ],
)
def test_the_answer_is_mean_and_covariance_of_the_posterior(true, seed, loss):
    signals = heard(true, seed, loss=loss)
    found = find_robot(signals, loss)
    assert found is not None
    pose, covariance = found
    sigmas = np.sqrt(np.diag(covariance))
    steps = np.linspace(-4.0, 4.0, 13)
    offsets = np.array([(x, y, yaw) for x in steps for y in steps for yaw in steps]) * sigmas
    places = offsets + np.array((pose.x_m, pose.y_m, pose.yaw_rad))
    logs = log_likelihoods([Pose2D(*place) for place in places.tolist()], signals, loss)
    shares = np.exp(logs - logs.max())
    shares /= shares.sum()
    mean = shares @ offsets
    spread = (offsets - mean).T @ (shares[:, None] * (offsets - mean))
    assert np.abs(mean / sigmas).max() < 0.15
    # It says how coarse its own grid is, too.
    for i in range(3):
        assert 0.85 * spread[i, i] < covariance[i, i] < 1.4 * spread[i, i]
        for j in range(i):
            assert covariance[i, j] == pytest.approx(spread[i, j], abs=0.15 * sigmas[i] * sigmas[j])


STEPS = st.lists(st.builds(Twist2D, *[st.floats(-1.0, 1.0)] * 3), min_size=1, max_size=12)


def sample(mote, rssi_dbm=-70.0):
    return RssiSample(f"m{mote}", Point2D(float(mote), 2.0 * mote), rssi_dbm)


def full(records, motes):
    signals = RecentSignals()
    for number in range(records):
        signals.receive(sample(number % motes))
    return signals


@pytest.mark.parametrize(
    ("records", "motes", "path_m", "is_enough"),
    [(24, 4, 2.01, True), (23, 4, 2.01, False), (24, 3, 2.01, False), (24, 4, 2.0, False), (64, 9, 50.0, True)],
)
def test_a_robot_can_be_looked_for_after_24_signals_of_four_motes_over_two_metres(records, motes, path_m, is_enough):
    assert full(records, motes).can_find(path_m) is is_enough


def test_memory_is_bounded_and_the_latest_count():
    signals = RecentSignals()
    for number in range(RECORDS + 10):
        signals.receive(sample(0, -float(number)))
    assert len(signals) == RECORDS
    assert signals.seen_from_here().rssi_dbm.tolist() == [-float(number) for number in range(10, RECORDS + 10)]


@settings(deadline=None)
@given(STEPS)
def test_places_are_where_the_robot_was_seen_from_where_it_is(steps):
    signals, pose, heard_at = RecentSignals(), Pose2D(3.0, -2.0, 1.0), []
    for number, step in enumerate(steps):
        signals.receive(sample(number % 3, -60.0 - number))
        heard_at.append(pose)
        pose = moved_along(pose, step)
        signals.move(step)
    seen = signals.seen_from_here()
    for place, at in zip(seen.places.tolist(), heard_at, strict=True):
        back = pose.compose(Pose2D(place[0], place[1], 0.0))
        assert (back.x_m, back.y_m) == pytest.approx((at.x_m, at.y_m), abs=1e-9)
    for number, mote in enumerate(seen.motes.tolist()):
        assert seen.mote_places[mote].tolist() == [float(number % 3), 2.0 * (number % 3)]
    assert seen.rssi_dbm.tolist() == [-60.0 - number for number in range(len(steps))]
