"""A battery: open-circuit voltage over the state of charge behind an internal resistance, with its own warmth.

The equivalent circuit "Rint" of Johnson: Battery performance models in ADVISOR, Journal of Power Sources 110
(2002). The table has the shape of four lithium-ion cells in series; its values, the resistance and the thermal ones
are chosen, not measured.
"""

import math
from bisect import bisect_right

J_PER_WH = 3600.0

SOC = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
OPEN_CIRCUIT_V = (12.00, 13.20, 13.80, 14.24, 14.48, 14.64, 14.80, 15.04, 15.36, 15.76, 16.20, 16.72)
RESISTANCE_OHM = 0.12
AMBIENT_C = 22.0
HEAT_CAPACITY_J_PER_K = 400.0
HEAT_LOSS_W_PER_K = 0.3


class Battery:
    """State of one battery; full when it is made.

    Args:
        capacity_wh: energy between full and empty, at the cells (the loss in the resistance included).

    Raises:
        ValueError: the capacity is not above 0.

    """

    def __init__(self, capacity_wh: float) -> None:
        if not (capacity_wh > 0 and math.isfinite(capacity_wh)):
            raise ValueError(f"expected battery_wh > 0, got {capacity_wh}")
        self.capacity_j = capacity_wh * J_PER_WH
        self.used_j = 0.0
        """Energy taken from the cells since full, never more than the capacity."""
        self.current_a = 0.0
        """Positive while discharging."""
        self.voltage_v = OPEN_CIRCUIT_V[-1]
        """At the terminals."""
        self.temperature_c = AMBIENT_C

    @property
    def soc(self) -> float:
        """State of charge by energy, 0 to 1."""
        return 1.0 - self.used_j / self.capacity_j

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing left to take."""
        return self.used_j >= self.capacity_j

    def draw(self, power_w: float, duration_s: float) -> None:
        """Deliver a constant power at the terminals for a while; an empty battery delivers nothing."""
        open_v = open_circuit_v(self.soc)
        if self.is_empty:
            power_w = 0.0
        # P = (E − I·R)·I; the smaller root is the working point. Past E²/4R the load pulls the voltage down to E/2.
        room = max(0.0, open_v * open_v - 4.0 * RESISTANCE_OHM * power_w)
        self.current_a = (open_v - math.sqrt(room)) / (2.0 * RESISTANCE_OHM)
        self.voltage_v = open_v - self.current_a * RESISTANCE_OHM
        self.used_j = min(self.capacity_j, self.used_j + open_v * self.current_a * duration_s)
        loss_w = self.current_a * self.current_a * RESISTANCE_OHM
        cooling_w = HEAT_LOSS_W_PER_K * (self.temperature_c - AMBIENT_C)
        self.temperature_c += (loss_w - cooling_w) * duration_s / HEAT_CAPACITY_J_PER_K


def open_circuit_v(soc: float) -> float:
    """Voltage at rest, linear between the entries of the table; `soc` outside 0 to 1 counts as the nearer end.

    >>> open_circuit_v(1.0)
    16.72
    """
    if soc <= SOC[0]:
        return OPEN_CIRCUIT_V[0]
    if soc >= SOC[-1]:
        return OPEN_CIRCUIT_V[-1]
    upper = bisect_right(SOC, soc)
    share = (soc - SOC[upper - 1]) / (SOC[upper] - SOC[upper - 1])
    return OPEN_CIRCUIT_V[upper - 1] + share * (OPEN_CIRCUIT_V[upper] - OPEN_CIRCUIT_V[upper - 1])
