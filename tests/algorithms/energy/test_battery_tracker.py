"""Tracking one battery: trusted measurements correct the estimate, doubted ones widen it."""

import pytest

from robrain.algorithms.energy.battery_tracker import (
    DOUBT_AT_ONCE,
    DOUBT_SHARE,
    KNOWN_START_SD,
    BatteryTracker,
    GaugeLimits,
    TrackedReading,
)
from robrain.algorithms.energy.soc_filter import PackModel, SocFilter

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


def test_known_charge_at_the_start_counts_whatever_the_voltage_says():
    followed = Followed(0.4)
    assert (followed.filter.soc, followed.filter.soc_sd) == (0.4, pytest.approx(KNOWN_START_SD))


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


def test_voltage_corrects_the_charge():
    followed = Followed()
    voltage_v = followed.filter.expected_v(1.0) + 0.1
    followed.one.follow(TrackedReading(voltage_v, 1.0, 25.0), 0.0, 0.5)
    assert followed.filter.soc > 0.8


def test_lie_is_not_taken_in_and_the_usual_current_is_counted_with_doubt():
    followed = Followed()
    followed.lie()
    usual_a = PACK.drive_current_a
    assert followed.filter.soc == pytest.approx(0.8 - usual_a * 0.5 / followed.capacity_c)
    blind_sd = DOUBT_SHARE * usual_a * 0.5 / followed.capacity_c
    assert followed.filter.soc_sd == pytest.approx(KNOWN_START_SD + DOUBT_AT_ONCE + blind_sd, rel=1e-3)


def test_lie_that_goes_on_is_doubted_at_once_only_once_and_then_by_its_time():
    followed = Followed()
    followed.lie()
    first_sd, first_soc = followed.filter.soc_sd, followed.filter.soc
    for _ in range(10):
        followed.lie(2.0)
    moved = PACK.drive_current_a * 20.0 / followed.capacity_c
    assert followed.filter.soc == pytest.approx(first_soc - moved)
    assert followed.filter.soc_sd == pytest.approx(first_sd + DOUBT_SHARE * moved, rel=1e-3)


def test_what_was_believed_shortly_before_a_lie_is_forgotten_and_its_time_counted_blindly():
    followed = Followed()
    followed.sound(4)
    followed.lie()
    # Two and a half seconds since the start, which is the last snapshot that is old enough.
    assert followed.filter.soc == pytest.approx(0.8 - followed.one.usual_a * 2.5 / followed.capacity_c)


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


def test_short_silence_is_ignored():
    followed = Followed()
    followed.one.no_reading(1.5, 1.5)
    assert (followed.filter.soc, followed.one.doubt_reason) == (0.8, "")


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
