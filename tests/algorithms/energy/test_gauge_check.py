import numpy as np

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
        assert gauge.check.reason == ""
