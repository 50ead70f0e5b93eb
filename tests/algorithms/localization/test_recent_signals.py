import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization.mote_relocalisation import RECORDS, RecentSignals
from robrain.algorithms.localization.odometry import moved_along
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D

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


@settings(deadline=None)
@given(STEPS, st.builds(Pose2D, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-3.1, 3.1)))
def test_what_signals_are_off_by_is_counted_in_their_variance(steps, here):
    loss = PathLoss(shadowing_db=3.0, fading_db=4.0)
    signals = RecentSignals()
    for number, step in enumerate(steps):
        signals.receive(sample(number % 3, -60.0 - number))
        signals.move(step)
    seen = signals.seen_from_here()
    squares = []
    for place, mote, rssi_dbm in zip(seen.places.tolist(), seen.motes.tolist(), seen.rssi_dbm.tolist(), strict=True):
        at = here.compose(Pose2D(place[0], place[1], 0.0))
        distance_m = math.dist((at.x_m, at.y_m), seen.mote_places[mote])
        squares.append((rssi_dbm - loss.mean_dbm(distance_m)) ** 2 / 25.0)
    assert signals.nis(here, loss) == pytest.approx(float(np.mean(squares)))
