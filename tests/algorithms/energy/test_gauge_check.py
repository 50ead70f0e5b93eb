import numpy as np
import pytest

from robrain.algorithms.energy.battery_tracker import GaugeCheck, GaugeLimits

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
        assert gauge.check.why == ""


@pytest.mark.parametrize(
    ("measured", "expected"),
    [
        ((3.0, 0.8, 25.0), "3.00 V is out of range"),
        ((20.0, 0.8, 25.0), "20.00 V is out of range"),
        ((14.9, 31.0, 25.0), "31.00 A is out of range"),
        ((14.9, 0.8, 120.0), "120 degrees are out of range"),
        ((float("nan"), 0.8, 25.0), "nan V is out of range"),
        ((14.0, 0.8, 25.0), "the voltage jumped by -0.8"),
    ],
)
def test_a_measurement_that_cannot_be_is_named_at_once(measured, expected):
    gauge = Gauge()
    gauge.sound(5.0)
    assert not gauge.tell(*measured)
    assert expected in gauge.check.why


def test_a_load_that_pulls_the_voltage_down_is_no_jump():
    gauge = Gauge()
    gauge.sound(5.0)
    assert gauge.tell(15.0 - RESISTANCE_OHM * 10.0, 10.0)


def test_a_frozen_gauge_is_found_after_some_seconds():
    gauge = Gauge()
    gauge.sound(5.0)
    told = [gauge.tell(14.88, 0.8) for _ in range(30)]
    assert told.index(False) == pytest.approx(20, abs=1)
    assert gauge.check.why == "frozen at 14.880 V and 0.800 A"


def test_no_current_while_the_computer_runs_is_found_out():
    gauge = Gauge()
    gauge.sound(5.0)
    gauge.sound(6.0, current_a=0.0)
    assert "the computer runs" in gauge.check.why


def test_a_current_that_contradicts_the_voltage_is_found_out():
    gauge = Gauge()
    gauge.sound(5.0)
    for _ in range(50):
        gauge.check.judge(14.5 + gauge.rng.normal(0.0, 0.01), -2.0, 25.0, 0.2, 15.3, RESISTANCE_OHM)
    assert "contradicts -2.00 A" in gauge.check.why


def test_silence_is_a_fault_too():
    gauge = Gauge()
    gauge.sound(5.0)
    assert gauge.check.silent(1.0, 0.2)
    assert not gauge.check.silent(2.0, 0.2)
    assert gauge.check.why == "no measurement for 2.0 s"


def test_a_gauge_is_believed_again_once_it_has_been_right_for_some_time():
    gauge = Gauge()
    gauge.sound(5.0)
    gauge.tell(3.0, 0.8)
    gauge.tell(14.88, 0.8)
    gauge.sound(9.0)
    assert gauge.check.why
    gauge.sound(5.0)
    assert not gauge.check.why


@pytest.mark.parametrize("limits", [{"jump_v": 0.0}, {"stale_s": -1.0}, {"voltage_min_v": 18.0}])
def test_impossible_limits_are_refused(limits):
    with pytest.raises(ValueError, match="expected"):
        GaugeLimits(**limits)
