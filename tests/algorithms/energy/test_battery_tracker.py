"""Tracking one battery: trusted measurements correct the estimate, doubted ones widen it."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from robrain.algorithms.energy.battery_report import BatteryReport
from robrain.algorithms.energy.battery_tracker import (
    DOUBT_AT_ONCE,
    DOUBT_SHARE,
    KNOWN_START_SD,
    BatteryTracker,
    GaugeCheck,
    GaugeLimits,
    TrackedReading,
)
from robrain.algorithms.energy.soc_filter import PackModel, SocFilter
from robrain.sim.firmware.battery import BatterySpec, SimulatedBattery

PACK = PackModel(missed_sd=0.0)
LIE = TrackedReading(3.0, 1.0, 25.0)
"""An impossible pack voltage."""


class Followed:
    """A tracker, and a gauge that measures nearly the expected values twice a second."""

    def __init__(self, soc: float | None = 0.8) -> None:
        self.one = BatteryTracker(PACK, GaugeLimits(recover_s=2.0), soc)
        self.one.begin(TrackedReading(15.7, 1.0, 25.0))
        self._hair_v = 0.001

    @property
    def filter(self) -> SocFilter:
        return self.one.filter

    def sound(self, count: int, current_a: float = 1.0) -> None:
        for _ in range(count):
            self._hair_v = -self._hair_v  # bit-identical values would count as a frozen gauge
            voltage_v = self.filter.expected_v(current_a) + self._hair_v
            self.one.follow(TrackedReading(voltage_v, current_a, 25.0), 0.5 * current_a, 0.5)

    def lie(self, elapsed_s: float = 0.5) -> None:
        self.one.follow(LIE, 0.5, elapsed_s)

    @property
    def capacity_c(self) -> float:
        return self.filter.rated_c * self.filter.health


def test_charge_that_is_not_known_is_that_of_the_first_voltage():
    by_hand = SocFilter(PACK)
    by_hand.start_from(15.7, 1.0)
    followed = Followed(None)
    assert (followed.filter.soc, followed.filter.soc_sd) == (by_hand.soc, by_hand.soc_sd)
    assert followed.one.doubt_reason == ""


def test_first_measurement_that_is_a_lie_leaves_the_charge_open():
    one = BatteryTracker(PACK, GaugeLimits())
    one.begin(LIE)
    assert (one.filter.soc, one.filter.soc_sd) == (0.5, pytest.approx(0.3))
    assert "out of range" in one.doubt_reason


def test_charge_that_has_flown_is_counted_and_not_the_current_of_the_moment():
    followed, by_hand = Followed(), SocFilter(PACK)
    by_hand.start_at(0.8, KNOWN_START_SD)
    voltage_v = by_hand.expected_v(1.0)
    followed.one.follow(TrackedReading(voltage_v, 1.0, 25.0), 36.0, 0.5)
    by_hand.count(72.0, 0.5)
    by_hand.fuse(voltage_v, 1.0)
    assert (followed.filter.soc, followed.filter.soc_sd) == (by_hand.soc, by_hand.soc_sd)


def test_lie_is_not_taken_in_and_the_usual_current_is_counted_with_doubt():
    followed = Followed()
    followed.lie()
    usual_a = PACK.drive_current_a
    assert followed.filter.soc == pytest.approx(0.8 - usual_a * 0.5 / followed.capacity_c)
    blind_sd = DOUBT_SHARE * usual_a * 0.5 / followed.capacity_c
    assert followed.filter.soc_sd == pytest.approx(KNOWN_START_SD + DOUBT_AT_ONCE + blind_sd, rel=1e-3)


@pytest.mark.parametrize(("sound_s", "kept_s"), [(7.0, 0.0), (11.0, 0.0), (11.5, 5.5), (13.0, 5.5), (17.0, 11.0)])
def test_what_was_believed_long_before_a_lie_stays(sound_s, kept_s):
    followed, socs = Followed(), [0.8]
    for _ in range(round(2 * sound_s)):
        followed.sound(1, 2.0)
        socs.append(followed.filter.soc)
    usual_a = followed.one.usual_a
    followed.lie()
    # All the time since what is kept is counted blindly, with that of the lie.
    blind_s = sound_s + 0.5 - kept_s
    expected = socs[round(2 * kept_s)] - usual_a * blind_s / followed.capacity_c
    assert followed.filter.soc == pytest.approx(expected, rel=1e-9)


def test_usual_current_is_a_mean_over_a_minute_of_what_is_drawn():
    followed = Followed()
    followed.sound(1, 4.0)
    expected_a = 1.2 + (4.0 - 1.2) * 0.5 / 60.0
    assert followed.one.usual_a == pytest.approx(expected_a)
    for current_a in (-2.0, 0.0):  # charging or zero current says nothing about consumption
        followed.sound(1, current_a)
        assert followed.one.usual_a == pytest.approx(expected_a)
    followed.lie()
    assert followed.one.usual_a == pytest.approx(expected_a)
    long = Followed()
    long.one.follow(TrackedReading(long.filter.expected_v(3.0), 3.0, 25.0), 3.0 * 120.0, 120.0)
    assert long.one.usual_a == 3.0


def test_silence_is_counted_on_and_only_once_when_the_gauge_speaks_again():
    followed = Followed()
    usual_a = followed.one.usual_a
    for second in range(2, 12):
        followed.one.no_reading(float(second), 1.0)
    assert "no measurement for" in followed.one.doubt_reason
    soc = 0.8 - usual_a * 10.0 / followed.capacity_c
    assert followed.filter.soc == pytest.approx(soc)
    # Twelve seconds since the last measurement, ten of which have been counted on.
    followed.one.follow(TrackedReading(15.7, 1.0, 25.0), 12.0, 12.0)
    soc -= usual_a * 2.0 / followed.capacity_c
    assert followed.filter.soc == pytest.approx(soc)
    followed.one.follow(TrackedReading(15.701, 1.0, 25.0), 0.5, 0.5)
    assert followed.filter.soc == pytest.approx(soc - usual_a * 0.5 / followed.capacity_c)


def test_gauge_that_is_believed_again_corrects_again_and_the_next_lie_is_doubted_at_once():
    followed = Followed()
    followed.lie()
    while followed.one.doubt_reason:
        followed.sound(1)
    before = followed.filter.soc_sd
    followed.sound(20)
    assert followed.filter.soc_sd < before
    before = followed.filter.soc_sd
    followed.lie()
    assert followed.filter.soc_sd > before + 0.9 * DOUBT_AT_ONCE


REPORTED_PACK = PackModel()
STEP_S = 0.2
GUESSED = BatteryReport(has_current=False)


class Ended(NamedTuple):
    """Estimate and truth at the end of a run."""

    soc: float
    soc_sd: float
    true_soc: float
    why: str
    inside: float
    """Share of the time in which the truth was within two standard deviations."""


def run(minutes: float, guess_a: float, *, start_soc: float = 0.9, load_w: float = 12.0) -> Ended:
    """A battery whose load goes up and down, followed by its voltage and a constant guess of the current."""
    battery, rng = SimulatedBattery(BatterySpec(soc_at_start=start_soc)), np.random.default_rng(5)
    tracker, inside = BatteryTracker(REPORTED_PACK, GaugeLimits()), []
    battery.step(load_w, 0.0, STEP_S)
    tracker.begin(TrackedReading(battery.voltage_v, guess_a, 25.0), GUESSED)
    steps = round(minutes * 60 / STEP_S)
    for step in range(steps):
        now_w = load_w * (1.0 + 0.8 * math.sin(step * STEP_S / 7.0))
        battery.step(now_w, 0.0, STEP_S)
        voltage_v = round(battery.voltage_v + float(rng.normal(0.0, 0.01)), 2)
        tracker.follow(TrackedReading(voltage_v, guess_a, 25.0), guess_a * STEP_S, STEP_S, GUESSED)
        inside.append(abs(tracker.filter.soc - battery.soc) <= 2.0 * tracker.filter.soc_sd)
    believed = tracker.filter
    return Ended(believed.soc, believed.soc_sd, battery.soc, tracker.doubt_reason, sum(inside) / steps)


@pytest.mark.parametrize("guess_a", [0.5, 0.8, 1.2])
def test_voltage_alone_follows_the_charge_and_says_how_unsure_it_is(guess_a: float) -> None:
    ended = run(40.0, guess_a)
    assert ended.why == ""
    assert ended.soc == pytest.approx(ended.true_soc, abs=0.15)
    assert ended.inside > 0.9
    assert 0.01 < ended.soc_sd < 0.15


def test_steps_of_an_unknown_load_and_a_coarse_voltage_are_no_fault_of_the_gauge() -> None:
    tracker = BatteryTracker(REPORTED_PACK, GaugeLimits())
    tracker.begin(TrackedReading(15.5, 1.0, 25.0), GUESSED)
    for step in range(100):
        voltage_v = 15.5 if step % 50 < 25 else 14.5
        tracker.follow(TrackedReading(voltage_v, 1.0, 25.0), 1.0, 1.0, GUESSED)
        assert tracker.doubt_reason == ""
    tracker.follow(TrackedReading(3.0, 1.0, 25.0), 1.0, 1.0, GUESSED)
    assert "out of range" in tracker.doubt_reason


def test_the_batterys_own_charge_is_where_the_estimate_begins_and_where_it_goes_within_a_minute_or_two() -> None:
    tracker = BatteryTracker(REPORTED_PACK, GaugeLimits())
    at_rest = TrackedReading(15.2, 0.5, 25.0)  # half full by the curve
    tracker.begin(at_rest, BatteryReport(soc=0.8, soc_sd=0.02))
    assert (tracker.filter.soc, tracker.filter.soc_sd) == (0.8, pytest.approx(0.023, abs=0.001))
    for _ in range(300):
        tracker.follow(at_rest, 0.1, STEP_S, BatteryReport(soc=0.8, soc_sd=0.02))
    assert tracker.filter.soc == pytest.approx(0.8, abs=0.01)
    for _ in range(900):
        tracker.follow(at_rest, 0.1, STEP_S, BatteryReport(soc=0.6, soc_sd=0.02))
    assert tracker.filter.soc == pytest.approx(0.6, abs=0.02)
    assert tracker.filter.soc_sd == pytest.approx(0.02, abs=0.005)
    assert tracker.doubt_reason == ""


def test_a_curve_of_one_cell_is_that_of_all_cells() -> None:
    curve_v = tuple(voltage_v / 4 for voltage_v in REPORTED_PACK.curve_v)
    of_cells, of_pack = (
        BatteryTracker(pack, GaugeLimits()) for pack in (PackModel(curve_v=curve_v, cells=4), REPORTED_PACK)
    )
    for tracker in (of_cells, of_pack):
        tracker.begin(TrackedReading(15.3, 1.0, 25.0))
        tracker.follow(TrackedReading(15.29, 1.0, 25.0), 1.0, 1.0)
    assert of_cells.filter.soc == pytest.approx(of_pack.filter.soc)
    assert of_cells.filter.interval_j() == pytest.approx(of_pack.filter.interval_j())


@pytest.mark.parametrize("cells", [0, -1, 201])
def test_a_pack_has_one_to_two_hundred_cells(cells: int) -> None:
    with pytest.raises(ValueError, match="expected cells"):
        PackModel(cells=cells)


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
            self.measure(15.0 - RESISTANCE_OHM * noisy_a + self.rng.normal(0.0, 0.01), noisy_a)

    def measure(self, voltage_v: float, current_a: float, temperature_c: float = 25.0) -> bool:
        expected_v = 15.0 - RESISTANCE_OHM * current_a
        return self.check.judge(voltage_v, current_a, temperature_c, 0.2, expected_v, RESISTANCE_OHM)


def test_a_sound_gauge_is_believed_whatever_the_robot_does():
    gauge = Gauge()
    for current_a in (0.8, 4.0, 0.5, -1.5, 0.0, 1.0):  # drives, stands, charges, is full, leaves
        gauge.sound(30.0, current_a)
        assert gauge.check.reason == ""
