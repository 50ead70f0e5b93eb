"""What motes say: that the robot is elsewhere, and where it is."""

import math

import numpy as np
import pytest

from robrain.algorithms.localization import localiser as module
from robrain.algorithms.localization.localiser import DivergenceSpec, Localiser, LocaliserSpec
from robrain.algorithms.localization.odometry import moved_along
from robrain.algorithms.localization.rssi_ranging import PathLoss, RssiSample
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D

MOTES = [Point2D(float(x), float(y)) for x in (2, 9, 17) for y in (3, 10, 18)]
LOSS = PathLoss()
DEAF_WATCH = DivergenceSpec(nis_max=1e9, refused_max=1.0)
"""A watch that says nothing of what is heard."""
STEP = Twist2D(0.15, 0.0, 0.05)


class Listener:
    """A robot that drives a curve and hears a mote with each step, where it really is."""

    def __init__(self, true, believed, **spec):
        self.true = true
        self.localiser = Localiser(believed, 0.1, 0.05, LocaliserSpec(**spec))
        self.heard = 0

    def step(self, motes=9):
        self.true = moved_along(self.true, STEP)
        self.localiser.move(STEP)
        mote = MOTES[self.heard % motes]
        self.localiser.receive(RssiSample(f"m{self.heard % motes}", mote, LOSS.mean_dbm(self.true.distance_m(mote))))
        self.heard += 1


HERE = Pose2D(10.0, 6.0, 0.0)


def test_signals_that_speak_for_another_place_say_that_the_robot_is_lost():
    robot = Listener(Pose2D(4.0, 14.0, 2.0), HERE, watch=DEAF_WATCH)
    while not robot.localiser.lost:
        robot.step()
        assert robot.heard <= 24
    assert robot.heard == 24
    assert "the last 24 signals of motes speak for another place" in robot.localiser.lost


def test_few_motes_cannot_say_that_the_robot_is_elsewhere():
    robot = Listener(Pose2D(4.0, 14.0, 2.0), HERE, watch=DEAF_WATCH)
    for _ in range(60):
        robot.step(motes=3)
    assert robot.localiser.lost == ""


def test_places_are_compared_after_every_24th_signal_only(monkeypatch):
    compared = []
    monkeypatch.setattr(module, "better_elsewhere", lambda *_: compared.append(robot.heard + 1) or 8.0)
    robot = Listener(HERE, HERE, watch=DEAF_WATCH)
    for _ in range(80):
        robot.step()
    assert compared == [24, 48, 72]
    assert robot.localiser.lost == "", "8 nat are not enough"
    monkeypatch.setattr(module, "better_elsewhere", lambda *_: 8.1)
    while robot.heard < 96:
        robot.step()
    assert robot.localiser.lost.endswith("(by 8 nat)")


def test_innovations_that_are_too_large_say_so_at_once():
    robot = Listener(Pose2D(17.0, 12.0, 0.0), HERE, watch=DivergenceSpec(window=4))
    while not robot.localiser.lost:
        robot.step()
        assert robot.heard < 12
    assert "signals of motes" in robot.localiser.lost


def test_a_lost_robot_is_found_by_motes_as_soon_as_they_are_enough():
    robot = Listener(Pose2D(4.0, 12.0, 0.0), HERE)
    robot.localiser.lose("it was carried")
    while robot.localiser.arena_fix is None:
        robot.step()
        assert robot.heard < 90
    assert robot.heard % 8 == 0
    assert robot.localiser.lost == "it was carried"
    robot.localiser.place(*robot.localiser.arena_fix)
    assert robot.localiser.lost == ""
    assert robot.localiser.arena_fix is None
    assert robot.localiser.beginnings == 2
    assert robot.localiser.fits
    off = np.array(
        (
            robot.localiser.pose.x_m - robot.true.x_m,
            robot.localiser.pose.y_m - robot.true.y_m,
            math.remainder(robot.localiser.pose.yaw_rad - robot.true.yaw_rad, math.tau),
        )
    )
    assert off @ np.linalg.solve(robot.localiser.covariance, off) < 16.0


FOUND = Pose2D(3.0, 4.0, 0.5)


@pytest.mark.parametrize(
    ("variances", "is_found"),
    [
        ((2.2, 2.2, 0.24), True),
        ((2.3, 0.1, 0.1), False),
        ((0.1, 2.3, 0.1), False),
        ((0.1, 0.1, 0.26), False),
    ],
)
def test_an_answer_that_is_not_sure_is_none(monkeypatch, variances, is_found):
    monkeypatch.setattr(module, "find_robot", lambda *_: (FOUND, np.diag(variances)))
    robot = Listener(HERE, HERE)
    robot.localiser.lose("it was carried")
    for _ in range(24):
        assert robot.localiser.arena_fix is None
        robot.step()
    assert (robot.localiser.arena_fix is not None) == is_found
    assert robot.localiser.lost
    if is_found:
        robot.localiser.place(*robot.localiser.arena_fix)
        assert robot.localiser.pose == FOUND
        assert np.diag(robot.localiser.covariance) == pytest.approx(variances)


@pytest.mark.parametrize("maps", [True, False])
def test_a_robot_that_maps_is_where_it_was_until_its_frame_is_placed(monkeypatch, maps):
    monkeypatch.setattr(module, "find_robot", lambda *_: (FOUND, np.diag((0.1, 0.1, 0.01))))
    robot = Listener(HERE, HERE, maps=maps)
    robot.localiser.lose("it was carried")
    for _ in range(24):
        robot.step()
    assert robot.localiser.pose.distance_m(robot.true) < 0.3
    assert robot.localiser.arena_fix is not None
    robot.localiser.lose("it was carried once more")
    assert robot.localiser.arena_fix is None, "that was of another frame"


def test_signals_from_before_it_was_lost_do_not_help_to_find_a_robot(monkeypatch):
    tried = []
    monkeypatch.setattr(module, "find_robot", lambda *_: tried.append(robot.heard + 1))
    robot = Listener(HERE, HERE, watch=DEAF_WATCH)
    for _ in range(30):
        robot.step()
    robot.localiser.lose("it was carried")
    for _ in range(24):
        robot.step()
    assert tried == [54]


def test_signals_are_seen_from_where_the_corrected_odometry_puts_the_robot(monkeypatch):
    """Errors of the odometry that the filter has learned are taken off the way between signals."""
    seen = []
    monkeypatch.setattr(module, "better_elsewhere", lambda _here, signals, _loss: seen.append(signals) or 0.0)
    robot = Localiser(Pose2D(0.0, 0.0, 0.0), 0.01, 0.005, LocaliserSpec(watch=DEAF_WATCH))
    true = Pose2D(0.0, 0.0, 0.0)
    for _ in range(600):  # way that is 3 % longer than believed, turns that are 2 % larger, and a curve of 0.01 rad/m
        robot.move(Twist2D(0.1, 0.0, 0.1))
        true = moved_along(true, Twist2D(0.103, 0.0, 0.1 * 1.02 + 0.1 * 0.01))
        off = true.x_m - robot.pose.x_m, true.y_m - robot.pose.y_m, true.yaw_rad - robot.pose.yaw_rad
        for row, axis in (((1.0, 0.0, 0.0), 0), ((0.0, 1.0, 0.0), 1), ((0.0, 0.0, 1.0), 2)):
            robot.filter.correct(row, math.remainder(off[axis], math.tau) if axis == 2 else off[axis], 0.01**2)
    scale, curve, turn = robot.filter.biases
    assert scale == pytest.approx(0.03, abs=0.005)
    assert curve + turn == pytest.approx(0.03, abs=0.005), "which of the two it is cannot be told on one circle"
    path_m = robot.driven_m
    ahead, aside, turned = Twist2D(0.4, 0.0, 0.0), Twist2D(0.0, 0.4, 0.0), Twist2D(0.0, 0.0, 0.5)
    steps = [ahead, aside, turned] * 8
    for number, step in enumerate(steps):
        robot.receive(RssiSample(f"m{number % 9}", MOTES[number % 9], -70.0))
        robot.move(step)
    robot.receive(RssiSample("m0", MOTES[0], -70.0))
    turned_rad = 0.5 * (1.0 + turn)
    assert robot.driven_m - path_m == pytest.approx(8 * (0.8 + 0.3 * (turned_rad + 0.4 * curve)), rel=1e-3)
    (signals,) = seen
    places = signals.places[-25:] if len(signals.places) > 24 else signals.places
    gaps_m = np.hypot(*np.diff(places, axis=0).T)
    assert gaps_m[:2] == pytest.approx(0.4 * (1.0 + scale), rel=1e-5)
    bearings_rad = np.unwrap(np.arctan2(*np.diff(places, axis=0)[::3].T[::-1]))
    assert np.diff(bearings_rad) == pytest.approx(turned_rad + 0.4 * curve, abs=1e-4)
