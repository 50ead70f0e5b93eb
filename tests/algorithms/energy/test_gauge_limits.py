"""The check of a gauge at its limits, measurement by measurement."""

import math

import numpy as np
import pytest

from robrain.algorithms.energy.battery_tracker import GaugeCheck, GaugeLimits

LIMITS = GaugeLimits()


def fresh(voltage_v=15.0, current_a=1.0):
    """A check that has seen one sound measurement."""
    check = GaugeCheck(LIMITS)
    assert check.judge(voltage_v, current_a, 25.0, 0.0, voltage_v, 0.1)
    return check


def judge(check, voltage_v=15.001, current_a=1.001, temperature_c=25.0, since_s=0.2, off_v=0.0, resistance_ohm=0.1):
    """Judge the next measurement, by default a sound one; the estimate is `off_v` lower."""
    check.judge(voltage_v, current_a, temperature_c, since_s, voltage_v - off_v, resistance_ohm)
    return check.reason


@pytest.mark.parametrize(
    ("first", "sound", "wrong", "words"),
    [
        ({"voltage_v": 8.1}, {"voltage_v": 8.0}, {"voltage_v": 7.999}, "V is out of range"),
        ({"voltage_v": 17.4}, {"voltage_v": 17.5}, {"voltage_v": 17.501}, "V is out of range"),
        ({"current_a": 14.9}, {"current_a": 15.0}, {"current_a": 15.001}, "A is out of range"),
        ({"current_a": -14.9}, {"current_a": -15.0}, {"current_a": -15.001}, "A is out of range"),
        ({}, {"temperature_c": -30.0}, {"temperature_c": -30.1}, "degrees are out of range"),
        ({}, {"temperature_c": 75.0}, {"temperature_c": 75.1}, "degrees are out of range"),
        ({}, {}, {"current_a": math.nan}, "A is out of range"),
        ({}, {}, {"temperature_c": math.nan}, "degrees are out of range"),
    ],
)
def test_what_a_gauge_may_say_includes_its_limits(first, sound, wrong, words):
    assert judge(fresh(**first), **sound) == ""
    assert words in judge(fresh(**first), **wrong)


@pytest.mark.parametrize(("jump_v", "is_sound"), [(0.399, True), (0.401, False), (-0.399, True), (-0.401, False)])
def test_jump_is_what_the_change_of_current_does_not_explain(jump_v, is_sound):
    # Three amperes more drop 0.3 V at 0.1 Ω.
    why = judge(fresh(), voltage_v=15.0 - 0.3 + jump_v, current_a=4.0)
    assert (why == "") is is_sound
    assert is_sound or why == f"the voltage jumped by {jump_v:+.2f} V"


def test_gauge_is_frozen_after_its_time_and_the_time_counts_anew_after_a_change():
    check = fresh()
    assert judge(check, 15.0, 1.0, since_s=3.9) == ""
    assert judge(check, 15.001, 1.0, since_s=1.0) == ""
    assert judge(check, 15.001, 1.0, since_s=3.9) == ""
    assert judge(check, 15.001, 1.0, since_s=0.1) == "frozen at 15.001 V and 1.000 A"


def asleep(check, current_a, since_s, hair_v=0.0):
    return judge(check, 15.0 + hair_v, current_a, since_s=since_s)


@pytest.mark.parametrize(("current_a", "is_sound"), [(0.079, False), (-0.079, False), (0.08, True)])
def test_computer_draws_more_than_nothing(current_a, is_sound):
    check = fresh()
    assert asleep(check, current_a, 4.9, 0.001) == ""
    why = asleep(check, current_a, 0.1, 0.002)
    assert (why == "") is is_sound
    assert is_sound or why.endswith("A cannot be: the computer runs, and no charger feeds it")


def test_charger_may_feed_the_robot_until_the_battery_is_seen_to_discharge():
    check = GaugeCheck(LIMITS)
    for number in range(4):  # from the start on: it may stand at a charger
        assert asleep(check, 0.0, 3.0, 0.001 * number) == ""
    assert asleep(check, -1.0, 0.2) == ""
    for number in range(4):  # the battery is full
        assert asleep(check, 0.0, 3.0, 0.001 * number) == ""
    assert asleep(check, 0.5, 0.2) == ""
    assert asleep(check, 0.0, 4.9, 0.001) == ""
    assert "no charger feeds it" in asleep(check, 0.0, 0.2)


@pytest.mark.parametrize(("off_v", "is_sound"), [(0.299, True), (0.301, False), (-0.299, True), (-0.301, False)])
def test_contradiction_that_lasts_is_found_on_both_sides(off_v, is_sound):
    assert (judge(fresh(), since_s=3.0, off_v=off_v) == "") is is_sound


def test_silence_is_stale_beyond_its_limit_and_before_it_nothing_new():
    check = fresh()
    assert check.silent(1.5, 0.2)
    assert not check.silent(1.501, 0.2)
    assert check.reason == "no measurement for 1.5 s"
    assert not check.silent(0.5, 0.2)
    assert check.reason


@pytest.mark.parametrize(
    ("gaps_s", "recovers"), [([1.0] * 10, True), ([1.0] * 9 + [0.9], False), ([60.0] * 6, False), ([60.0] * 7, True)]
)
def test_gauge_is_believed_again_after_its_time_in_which_one_measurement_counts_for_little(gaps_s, recovers):
    check = fresh()
    assert judge(check, temperature_c=100.0)
    for number, since_s in enumerate(gaps_s):
        why = judge(check, 15.0 + 0.001 * (number % 2), 1.0 + 0.001 * (number % 2), since_s=since_s)
    assert (why == "") is recovers


def test_each_new_lie_begins_the_time_of_recovery_anew_and_is_the_one_that_is_told():
    check = fresh()
    judge(check, temperature_c=100.0)
    for number in range(9):
        judge(check, 15.0 + 0.001 * (number % 2), since_s=1.0)
    assert "-40 degrees" in judge(check, temperature_c=-40.0)
    for number in range(9):
        assert judge(check, 15.0 + 0.001 * (number % 2), since_s=1.0)
    assert judge(check, 15.005, since_s=1.0) == ""


def test_empty_voltage_range_is_refused():
    with pytest.raises(ValueError, match="expected voltage_max_v above voltage_min_v"):
        GaugeLimits(voltage_min_v=12.0, voltage_max_v=12.0)
    GaugeLimits(temperature_min_c=-1.0, temperature_max_c=-0.5)


RESISTANCE_OHM = 0.15


class Gauge:
    """Measures a pack of 15 V behind a resistance, five times a second, with noise."""

    def __init__(self, **limits: float) -> None:
        self.check = GaugeCheck(GaugeLimits(**limits))
        self.rng = np.random.default_rng(1)

    def sound(self, seconds: float, current_a: float = 0.8) -> None:
        for _ in range(round(seconds / 0.2)):
            noisy_a = current_a + self.rng.normal(0.0, 0.01)
            self.tell(15.0 - RESISTANCE_OHM * noisy_a + self.rng.normal(0.0, 0.01), noisy_a)

    def tell(self, voltage_v: float, current_a: float, temperature_c: float = 25.0) -> bool:
        expected_v = 15.0 - RESISTANCE_OHM * current_a
        return self.check.judge(voltage_v, current_a, temperature_c, 0.2, expected_v, RESISTANCE_OHM)


def test_a_sound_gauge_is_believed_whatever_the_robot_does():
    gauge = Gauge()
    for current_a in (0.8, 4.0, 0.5, -1.5, 0.0, 1.0):  # drives, stands, charges, is full, leaves
        gauge.sound(30.0, current_a)
        assert gauge.check.reason == ""
