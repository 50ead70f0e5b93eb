import math

import numpy as np
import pytest
from robrain.protocol.model.map_anchors import TILES_MAX, MapAnchors

from robrain.protocol.model.divergence_watch import DivergenceWatch, WatchSpec
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.localiser import Localiser, LocaliserSpec
from robrain.protocol.model.mote_relocalisation import Signals, find_robot
from robrain.protocol.model.odometry import moved_along
from robrain.protocol.model.rssi_ranging import PathLoss, RssiSample

MOTES = [Point2D(float(x), float(y)) for x in (2, 9, 17) for y in (3, 10, 18)]
LOSS = PathLoss()


class Walk:
    """A robot that drives in rounds; its odometry is exact, its motes have 3 dB of noise."""

    def __init__(self) -> None:
        self.true = Pose2D(10.0, 6.0, 0.0)
        self.localiser = Localiser(self.true, 0.05, 0.02, LocaliserSpec())
        self._rng = np.random.default_rng(4)
        self._step = 0

    def go(self, seconds: float, *, deaf: bool = False) -> None:
        for _ in range(round(10 * seconds)):
            self._step += 1
            by = Twist2D(0.05, 0.0, 0.012)
            self.true = moved_along(self.true, by)
            self.localiser.move(by)
            if self._step % 4 == 0 and not deaf:
                mote = MOTES[self._step // 4 % len(MOTES)]
                rssi_dbm = LOSS.mean_dbm(self.true.distance_m(mote)) + 3.0 * self._rng.standard_normal()
                self.localiser.hear(RssiSample(f"{mote}", mote, rssi_dbm))

    @property
    def error_m(self) -> float:
        return self.true.distance_m(self.localiser.pose)


def test_motes_keep_a_robot_found_and_their_covariance_tells_how_well():
    walk = Walk()
    walk.go(120.0)
    assert walk.localiser.lost == ""
    assert walk.error_m < 3 * walk.localiser.sigma_m < 3.0


def test_a_robot_that_is_carried_off_says_so_and_finds_itself_again():
    walk = Walk()
    walk.go(40.0)
    walk.true = Pose2D(walk.true.x_m + 5.0, walk.true.y_m + 4.0, walk.true.yaw_rad + 2.0)
    said_after_s = 0
    while not walk.localiser.lost:
        walk.go(1.0)
        said_after_s += 1
        assert said_after_s < 60
    assert walk.localiser.sigma_m > 3.0
    while walk.localiser.lost:
        walk.go(1.0)
        said_after_s += 1
        assert said_after_s < 180
    walk.go(20.0)
    assert walk.localiser.lost == ""
    assert walk.error_m < 1.5
    assert math.remainder(walk.true.yaw_rad - walk.localiser.pose.yaw_rad, math.tau) == pytest.approx(0.0, abs=0.4)


def test_without_sources_nothing_is_said_but_the_uncertainty_grows():
    walk = Walk()
    walk.go(60.0, deaf=True)
    assert walk.localiser.lost == ""
    assert walk.error_m < 1e-9
    assert walk.localiser.sigma_m > 0.5


def test_a_watch_is_quiet_as_long_as_innovations_are_as_expected():
    watch = DivergenceWatch(WatchSpec(), 10.83)
    squares = np.random.default_rng(1).standard_normal(20_000) ** 2
    assert not any(watch.heard(float(nis)) for nis in squares)
    assert watch.mean_nis == pytest.approx(1.0, abs=0.6)


def test_a_watch_tells_too_large_and_too_often_refused_apart():
    large, refused = DivergenceWatch(WatchSpec(), 10.83), DivergenceWatch(WatchSpec(), 10.83)
    assert "times the variance" in [large.heard(4.0) for _ in range(32)][-1]
    whys = [refused.heard(50.0 if number % 3 == 0 else 0.5) for number in range(32)]
    assert "cannot be right" in whys[-1]
    assert refused.refused == 11


def test_a_watch_forgives_a_bad_scan_but_not_eight_in_a_row():
    watch = DivergenceWatch(WatchSpec(), 10.83)
    assert not any(watch.saw(0.1 if number % 8 else 0.9) for number in range(40))
    assert "do not fit the map" in [watch.saw(0.1) for _ in range(8)][-1]


@pytest.mark.parametrize("yaw_rad", [-2.0, 0.0, 1.3])
def test_signals_along_a_way_tell_where_a_robot_is_without_any_idea_before(yaw_rad):
    rng = np.random.default_rng(8)
    true = Pose2D(12.0, 7.0, yaw_rad)
    places = np.array([(0.1 * k - 6.0, 2.0 * math.sin(k / 8)) for k in range(60)])
    motes = rng.integers(0, len(MOTES), 60)
    rssi_dbm = [
        LOSS.mean_dbm(true.compose(Pose2D(x, y, 0.0)).distance_m(MOTES[mote])) + 2.0 * rng.standard_normal()
        for (x, y), mote in zip(places, motes, strict=True)
    ]
    found = find_robot(Signals(places, motes, np.array([(m.x_m, m.y_m) for m in MOTES]), np.array(rssi_dbm)), LOSS)
    assert found is not None
    pose, covariance = found
    off = np.array((pose.x_m - 12.0, pose.y_m - 7.0, math.remainder(pose.yaw_rad - yaw_rad, math.tau)))
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert off @ np.linalg.solve(covariance, off) < 16.0
    assert math.hypot(off[0], off[1]) < 1.5


def test_a_robot_that_hears_two_motes_from_one_spot_may_be_anywhere():
    places, motes = np.zeros((30, 2)), np.arange(30) % 2
    mote_places = np.array(((0.0, 0.0), (8.0, 0.0)))
    assert find_robot(Signals(places, motes, mote_places, np.full(30, LOSS.mean_dbm(6.0))), LOSS) is None


def test_what_was_mapped_from_an_unsure_place_keeps_its_variance():
    anchors = MapAnchors(0.1, 0.01)
    here, there = Pose2D(0.5, 0.5, 0.0), Pose2D(3.0, 0.5, 0.0)
    assert anchors.at(here) is None
    first = anchors.enter(here, (0.0, 0.0, 0.0))
    assert first == pytest.approx((0.01, 0.01, 0.0001))
    assert anchors.enter(there, (0.25, 0.04, 0.01))[0] == pytest.approx(0.26)
    assert anchors.enter(here, (9.0, 9.0, 9.0)) == first


def test_anchors_are_bounded():
    anchors = MapAnchors(0.1, 0.01)
    for number in range(TILES_MAX + 10):
        anchors.enter(Pose2D(2.0 * number + 1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert len(anchors) == TILES_MAX
