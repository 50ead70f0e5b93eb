"""Docking and charging step by step, on fakes; the charging current decides."""

import math

import pytest

from robrain.plugins.behavior.errand import Failed
from robrain.plugins.behavior.recharge import (
    DOCK_TRIES,
    DOCKED_M,
    GIVE_S,
    SEEK_BLOCKED_S,
    SEEK_RINGS,
    SEEK_WAIT_S,
    TOUCH_S,
    Docking,
)
from robrain.plugins.skill.home import ChargerPlace
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.model.geometry import Pose2D
from tests.plugins.behavior.bare_errand import BareErrand, run

STEP_S = 0.25


def docking(yaw_rad=None):
    errand = BareErrand()
    return errand, Docking(errand, ChargerPlace(2.0, 1.0, yaw_rad), 10.0)


def play(errand, script, limit_s=600.0, each=lambda: None):
    """Run a script on a simulated clock: its result and duration, or ... if it is still running."""
    steps = round(limit_s / STEP_S)
    for number in range(steps):
        try:
            next(script)
        except StopIteration as end:
            return end.value, number * STEP_S
        errand.wait(STEP_S)
        each()
    return ..., limit_s


def keeps(_charger):
    return False


# -- onto the contacts ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("yaw_rad", "facing_rad"), [(1.0, 1.0), (None, 0.5)])
def test_robot_goes_to_the_place_in_odom_and_looks_where_the_charger_says_or_as_it_does(yaw_rad, facing_rad):
    errand, one = docking(yaw_rad)
    errand.at = Pose2D(2.0, 1.0, 0.5)
    errand.charging = True
    errand.board.T_arena_odom = Pose2D(1.0, 0.0, math.pi / 2)
    run(one.dock())
    (sent,) = errand.driver.sent
    assert (sent.x_m, sent.y_m) == pytest.approx((1.0, -1.0))
    assert sent.yaw_rad == pytest.approx(facing_rad - math.pi / 2)


@pytest.mark.parametrize(("away_m", "tries"), [(DOCKED_M, 1), (DOCKED_M + 0.001, DOCK_TRIES)])
def test_robot_tries_again_until_it_stands_near_enough(away_m, tries):
    errand, one = docking()
    errand.at = Pose2D(2.0 + away_m, 1.0, 0.0)
    errand.charging = True
    run(one.dock())
    assert len(errand.driver.sent) == tries


def test_robot_that_does_not_know_where_it_is_does_not_dock():
    errand, one = docking()
    errand.board.T_arena_odom = None
    with pytest.raises(Failed, match="does not know where it is"):
        run(one.dock())


def test_robot_waits_for_the_first_current_and_no_longer_than_its_time():
    errand, one = docking()
    errand.at = Pose2D(2.0, 1.0, 0.0)
    assert play(errand, one.dock())[1] == pytest.approx(TOUCH_S + STEP_S)
    assert errand.driver.sent
    errand.charging = True
    assert play(errand, one.dock())[1] == STEP_S


# -- at the charger ---------------------------------------------------------------------------------------------


def test_robot_that_is_full_enough_leaves_at_once():
    errand, one = docking()
    errand.soc = 0.9
    assert play(errand, one.charge(0.9, keeps)) == (False, 0.0)
    assert not one.has_charged
    errand.charging, errand.soc = True, 0.899
    assert play(errand, one.charge(0.9, keeps), 30.0) == (..., 30.0)


def test_robot_charges_until_there_is_enough():
    errand, one = docking()
    errand.charging = True

    def fill():
        errand.soc += 0.01

    assert play(errand, one.charge(0.7, keeps), each=fill)[0] is False
    assert errand.soc == pytest.approx(0.7, abs=0.02)
    assert one.has_charged
    assert errand.driver.sent == []


@pytest.mark.parametrize("gives_after_s", [0.0, 1.0])
def test_whether_a_mate_needs_the_charger_is_looked_at_every_two_seconds(gives_after_s):
    errand, one = docking()
    errand.charging, asked_ns = True, []

    def must_give(charger):
        assert charger.place == one._charger.place
        asked_ns.append(errand.clock.now_ns())
        return len(asked_ns) == 1 + round(gives_after_s)

    gives, took_s = play(errand, one.charge(0.9, must_give))
    assert gives is True
    assert took_s == gives_after_s * GIVE_S


def test_charger_that_gives_no_more_is_left_after_its_time():
    errand, one = docking()
    errand.charging = True
    script = one.charge(0.9, keeps)
    play(errand, script, 5.0)
    errand.charging = False
    gives, took_s = play(errand, script)
    assert gives is False
    assert took_s == pytest.approx(10.0, abs=2 * STEP_S)
    assert one.has_charged
    assert errand.driver.sent == []  # it has been on the contacts: nothing is sought


# -- seeking ----------------------------------------------------------------------------------------------------


def test_robot_that_gets_no_current_looks_for_the_contacts_around_from_the_inside_out_and_once():
    errand, one = docking(0.0)
    gives, took_s = play(errand, one.charge(0.9, keeps))
    assert gives is False
    away = [
        (math.hypot(at.x_m - 2.0, at.y_m - 1.0), math.atan2(at.y_m - 1.0, at.x_m - 2.0)) for at in errand.driver.sent
    ]
    expected = [
        (radius_m, math.remainder(index * math.tau / places, math.tau))
        for radius_m, places in SEEK_RINGS
        for index in range(places)
    ]
    for (radius_m, angle_rad), (expected_m, expected_rad) in zip(away, expected, strict=True):
        assert radius_m == pytest.approx(expected_m)
        assert math.remainder(angle_rad - expected_rad, math.tau) == pytest.approx(0.0, abs=1e-9)
    # At each place it waits for a current; then for as long as a charger may give nothing.
    assert took_s == pytest.approx(26 * (SEEK_WAIT_S + 0.3) + 10.0, abs=10.0)
    assert took_s > 26 * SEEK_WAIT_S + 10.0


def test_search_ends_where_the_current_comes():
    errand, one = docking()

    def touch():
        errand.charging = len(errand.driver.sent) >= 4

    errand.soc = 0.89
    script = one.charge(0.9, keeps)
    play(errand, script, 20.0, touch)
    assert len(errand.driver.sent) == 4
    assert one.has_charged


def test_place_where_something_stands_is_passed_over_at_once():
    errand, one = docking()
    errand.driver.state, errand.driver.blocked = Motion.BLOCKED, SEEK_BLOCKED_S
    script = one._seek()
    _, took_s = play(errand, script)
    assert errand.driver.stops == len(errand.driver.sent) == 26
    assert took_s == pytest.approx(26 * STEP_S)


def test_robot_that_is_blocked_for_a_moment_is_given_time():
    errand, one = docking()
    errand.driver.state, errand.driver.blocked = Motion.BLOCKED, SEEK_BLOCKED_S - 0.01
    assert play(errand, one._seek(), 20.0)[0] is ...
    assert len(errand.driver.sent) == 1
    assert errand.driver.stops == 0
