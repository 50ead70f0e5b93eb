"""What a Mica2 draws in each of its states, and its batteries.

Currents are those of Shnayder et al.: Simulating the Power Consumption of Large-Scale Sensor Network Applications,
SenSys 2004, as its simulator PowerTOSSIM has them for the Mica2; the radio's come on top of the CPU's. Capacity and
voltages are chosen: two AA cells in series.
"""

from enum import StrEnum

CPU_ACTIVE_MA = 8.0
CPU_IDLE_MA = 4.13
SLEEP_MA = 0.1
RECEIVE_MA = 7.96
SENSOR_BOARD_MA = 0.7
LOG_WRITE_MA = 18.4
SEND_MA = (
    (-20.0, 4.65),
    (-19.0, 6.14),
    (-15.0, 6.3),
    (-8.0, 7.4),
    (-5.0, 7.98),
    (0.0, 9.4),
    (4.0, 12.5),
    (6.0, 14.7),
    (8.0, 18.3),
    (10.0, 22.4),
)
"""The CC1000's power levels, dBm, and what it draws at each."""

FRESH_V, FLAT_V = 3.1, 2.1
S_PER_H = 3600.0


class MoteState(StrEnum):
    """States whose time is integrated to charge."""

    SLEEP = "sleep"
    ACTIVE = "active"
    """The CPU at work, radio off."""
    SENSE = "sense"
    """The CPU at work with the sensor board on."""
    LOG = "log"
    """A reading goes into the flash memory."""
    SEND = "send"
    LISTEN = "listen"
    """The radio receives or waits to, while the CPU is idle."""


def send_ma(transmit_dbm: float) -> float:
    """What the radio draws at a power: of the lowest level that is as strong (ValueError beyond the strongest).

    >>> send_ma(0.0)
    9.4
    """
    for level_dbm, current_ma in SEND_MA:
        if transmit_dbm <= level_dbm:
            return current_ma
    raise ValueError(f"expected a transmit power of at most {SEND_MA[-1][0]:g} dBm, got {transmit_dbm:g}")


class MoteBattery:
    """Charge left, from the time spent in each state.

    Args:
        capacity_mah: when fresh.
        used_share: of it, at the start.
        transmit_dbm: power of the radio.

    """

    def __init__(self, capacity_mah: float, used_share: float, transmit_dbm: float) -> None:
        self.state_s = dict.fromkeys(MoteState, 0.0)
        """Time spent in each state so far."""
        self._capacity_mas = capacity_mah * S_PER_H
        self._used_mas = self._capacity_mas * used_share
        self._current_ma = {
            MoteState.SLEEP: SLEEP_MA,
            MoteState.ACTIVE: CPU_ACTIVE_MA,
            MoteState.SENSE: CPU_ACTIVE_MA + SENSOR_BOARD_MA,
            MoteState.LOG: CPU_ACTIVE_MA + LOG_WRITE_MA,
            MoteState.SEND: CPU_ACTIVE_MA + send_ma(transmit_dbm),
            MoteState.LISTEN: CPU_IDLE_MA + RECEIVE_MA,
        }

    def spend(self, state: MoteState, duration_s: float) -> None:
        """Count a stay in a state."""
        self.state_s[state] += duration_s
        self._used_mas += self._current_ma[state] * duration_s

    @property
    def left_share(self) -> float:
        """Share of its charge that is left."""
        return max(0.0, 1.0 - self._used_mas / self._capacity_mas)

    @property
    def is_flat(self) -> bool:
        """Whether nothing is left."""
        return self._used_mas >= self._capacity_mas

    @property
    def voltage_v(self) -> float:
        """Terminal voltage: falls evenly from fresh to flat."""
        return FRESH_V + (FLAT_V - FRESH_V) * min(1.0, self._used_mas / self._capacity_mas)
