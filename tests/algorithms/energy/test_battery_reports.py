"""Batteries that measure no current, or tell their state of charge themselves."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from robrain.algorithms.energy.battery_report import BatteryReport
from robrain.algorithms.energy.battery_tracker import BatteryTracker, GaugeLimits, TrackedReading
from robrain.algorithms.energy.soc_filter import PackModel
from robrain.sim.firmware.battery import BatterySpec, SimulatedBattery

PACK = PackModel()
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
    tracker, inside = BatteryTracker(PACK, GaugeLimits()), []
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
    tracker = BatteryTracker(PACK, GaugeLimits())
    tracker.begin(TrackedReading(15.5, 1.0, 25.0), GUESSED)
    for step in range(100):
        voltage_v = 15.5 if step % 50 < 25 else 14.5
        tracker.follow(TrackedReading(voltage_v, 1.0, 25.0), 1.0, 1.0, GUESSED)
        assert tracker.doubt_reason == ""
    tracker.follow(TrackedReading(3.0, 1.0, 25.0), 1.0, 1.0, GUESSED)
    assert "out of range" in tracker.doubt_reason


def test_the_batterys_own_charge_is_where_the_estimate_begins_and_where_it_goes_within_a_minute_or_two() -> None:
    tracker = BatteryTracker(PACK, GaugeLimits())
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


def test_charge_that_is_counted_shows_before_the_battery_tells_it() -> None:
    tracker = BatteryTracker(PACK, GaugeLimits())
    report = BatteryReport(soc=0.8, soc_sd=0.03)
    tracker.begin(TrackedReading(15.0, 3.0, 25.0), report)
    for _ in range(50):
        tracker.follow(TrackedReading(15.0, 3.0, 25.0), 3.0 * STEP_S, STEP_S, report)
    assert 0.002 < 0.8 - tracker.filter.soc < 0.01


def test_a_curve_of_one_cell_is_that_of_all_cells() -> None:
    curve_v = tuple(voltage_v / 4 for voltage_v in PACK.curve_v)
    of_cells, of_pack = (BatteryTracker(pack, GaugeLimits()) for pack in (PackModel(curve_v=curve_v, cells=4), PACK))
    for tracker in (of_cells, of_pack):
        tracker.begin(TrackedReading(15.3, 1.0, 25.0))
        tracker.follow(TrackedReading(15.29, 1.0, 25.0), 1.0, 1.0)
    assert of_cells.filter.soc == pytest.approx(of_pack.filter.soc)
    assert of_cells.filter.interval_j() == pytest.approx(of_pack.filter.interval_j())


@pytest.mark.parametrize("cells", [0, -1, 201])
def test_a_pack_has_one_to_two_hundred_cells(cells: int) -> None:
    with pytest.raises(ValueError, match="expected cells"):
        PackModel(cells=cells)
