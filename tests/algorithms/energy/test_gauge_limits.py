"""The check of a gauge at its limits, measurement by measurement."""

import math

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


@pytest.mark.parametrize(("since_s", "is_sound"), [(1.5, False), (1.501, True)])
def test_after_a_silence_no_change_is_a_jump(since_s, is_sound):
    assert (judge(fresh(), voltage_v=14.0, since_s=since_s) == "") is is_sound


@pytest.mark.parametrize("changes", [{"current_a": 1.0}, {"voltage_v": 15.0}])
def test_gauge_is_frozen_only_if_both_stay_the_same(changes):
    check = fresh()
    assert judge(check, voltage_v=15.0, current_a=1.0, since_s=3.9) == ""
    assert judge(check, **({"voltage_v": 15.001, "current_a": 1.001} | changes), since_s=3.9) == ""
    assert judge(check, voltage_v=15.0 + 0.0005, current_a=1.0005, since_s=3.9) == ""


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


def test_current_between_two_sleeps_wakes_the_gauge():
    check = fresh()
    assert asleep(check, 0.0, 4.0, 0.001) == ""
    assert asleep(check, 1.0, 0.2, 0.002) == ""
    assert asleep(check, 0.0, 4.0, 0.003) == ""


def test_contradiction_is_a_mean_over_its_time():
    check = fresh()
    mean_v = 0.0
    while mean_v <= 0.3:
        assert check.reason == ""
        mean_v += 0.2 / 3.0 * (0.5 - mean_v)
        why = judge(check, 15.0 + 0.001 * (mean_v > 0.1), 1.0 + mean_v / 1000, off_v=0.5)
    assert "contradicts" in why
    expected_v = 15.001 - mean_v
    assert why == f"15.00 V contradicts {1.0 + mean_v / 1000:.2f} A: {expected_v:.2f} V expected"


@pytest.mark.parametrize(("off_v", "is_sound"), [(0.299, True), (0.301, False), (-0.299, True), (-0.301, False)])
def test_contradiction_that_lasts_is_found_on_both_sides(off_v, is_sound):
    assert (judge(fresh(), since_s=3.0, off_v=off_v) == "") is is_sound


@pytest.mark.parametrize("off_v", [7.0, -7.0])
def test_one_wild_estimate_counts_as_two_volts_at_the_most(off_v):
    check = fresh()
    assert judge(check, since_s=0.4, off_v=off_v) == ""  # 0.27 V of the mean
    assert judge(check, since_s=0.2) == ""
    assert judge(fresh(), since_s=60.0, off_v=0.29) == ""  # the mean is never beyond what was measured


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
