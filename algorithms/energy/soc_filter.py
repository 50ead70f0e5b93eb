"""State of charge: coulomb counting fused with the open-circuit voltage by an extended Kalman filter.

Source: Plett, Extended Kalman filtering for battery management systems of LiPB-based HEV battery packs, part 3, Journal
of Power Sources 134 (2004). The filter has the joint form: state and slow parameters in one filter. The states:

- state of charge z, of the present capacity
- overpotential u of one RC pair behind the resistance (Thevenin's circuit)
- error d of the curve: a random walk, so that the filter's certainty never exceeds that of the curve
- resistance r
- health g, the capacity as a share of the rated one

Discharging is positive. The curve, the rated capacity and all spreads are a datasheet's: nominal, not the pack's own.
"""

import math
from bisect import bisect_left
from typing import Annotated

import numpy as np
from msgspec import Meta
from numba import njit

from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import NotNegative, Positive

J_PER_WH = 3600.0
CELLS_MAX = 200
SOC_LEAST, SOC_MOST = 0.0, 1.02
HEALTH_LEAST, HEALTH_MOST = 0.3, 1.3
RESISTANCE_LEAST = 0.2
"""Shares of the nominal values that the filter does not leave."""
SAME_ERROR_S = 60.0
"""Errors of a guessed current, or of a state of charge that the battery reports, stay the same for about this time. All
reports of that time count as one measurement. Chosen."""
_SD_95 = 1.959964
"""Half of a two-sided 95 % interval of a normal distribution, in standard deviations."""


class PackModel(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Datasheet values of a pack, and their uncertainties.

    The values are chosen for four cells in series.

    Raises ValueError if a value is impossible.
    """

    capacity_wh: Positive = 20.0
    """Rated capacity."""
    curve_soc: tuple[float, ...] = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
    curve_v: tuple[float, ...] = (
        *(10.6, 12.7, 14.07, 14.7, 14.84, 14.9, 14.99, 15.08, 15.2),
        *(15.36, 15.56, 15.78, 16.07, 16.41),
    )
    """Open-circuit voltage at the states of charge in `curve_soc`, rising; of the pack, or of each of its `cells`."""
    cells: Annotated[int, Meta(ge=1, le=CELLS_MAX)] = 1
    """Number of cells in series; it multiplies `curve_v`. All other figures are those of the pack."""
    curve_sd_v: NotNegative = 0.03
    """Standard deviation of a pack's curve."""
    curve_wander_s: Positive = 1800.0
    resistance_ohm: Positive = 0.13
    resistance_sd: NotNegative = 0.05
    relaxation_share: NotNegative = 0.6
    """Resistance of the RC pair, as a share of `resistance_ohm`."""
    relaxation_s: Positive = 90.0
    health: Positive = 0.93
    """Capacity of a pack of unknown age, as a share of the rated capacity."""
    health_sd: NotNegative = 0.06
    voltage_sd_v: Positive = 0.02
    """Standard deviation of one measurement, including errors of the circuit model."""
    missed_sd: NotNegative = 0.012
    """Standard deviation of the state of charge by effects outside the model, such as uneven charge in the cells."""
    current_sd: NotNegative = 0.01
    """Relative standard deviation of the integrated charge."""
    cut_off_v: float = 12.0
    """Voltage at the terminals below which the charge cannot be used."""
    drive_current_a: NotNegative = 1.2
    """Current that the robot must be able to draw to the end."""
    rate_loss_s: NotNegative = 60.0
    """Charge that a load leaves unused at the end, per ampere: from a datasheet's capacities at two rates. Half of it
    is the assumed standard deviation."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.curve_soc) != len(self.curve_v) or len(self.curve_soc) < 2:
            raise ValueError("expected as many curve_soc as curve_v, two at least")
        for name in ("curve_soc", "curve_v"):
            if not all(a < b for a, b in zip(getattr(self, name), getattr(self, name)[1:], strict=False)):
                raise ValueError(f"expected {name} to rise, got {getattr(self, name)}")
        if self.curve_soc[0] != 0 or self.curve_soc[-1] != 1:
            raise ValueError(f"expected curve_soc from 0 to 1, got {self.curve_soc[0]} to {self.curve_soc[-1]}")
        if not self.cut_off_v < self.curve_v[-1] * self.cells:
            raise ValueError(f"expected cut_off_v below the curve's end, got {self.cut_off_v}")


class SocFilter:
    """The filter of one pack.

    Args:
        pack: its datasheet values.

    """

    def __init__(self, pack: PackModel) -> None:
        self.pack = pack
        self._curve_soc = np.array(pack.curve_soc)
        self._curve_v = np.array(pack.curve_v) * pack.cells
        spans = np.diff(self._curve_soc)
        mean_v = float(((self._curve_v[1:] + self._curve_v[:-1]) / 2 * spans).sum())
        self.rated_c = pack.capacity_wh * J_PER_WH / mean_v
        """Charge of the rated capacity."""
        self._areas = np.concatenate(([0.0], np.cumsum((self._curve_v[1:] + self._curve_v[:-1]) / 2 * spans)))
        self._state = np.array([1.0, 0.0, 0.0, pack.resistance_ohm, pack.health])
        sds = np.array([0.3, 0.02, pack.curve_sd_v, pack.resistance_sd, pack.health_sd])
        self._covariance = np.diag(sds * sds)
        self._constants = np.array(
            [
                self.rated_c,
                pack.relaxation_share,
                pack.relaxation_s,
                pack.curve_sd_v,
                pack.curve_wander_s,
                pack.voltage_sd_v,
                pack.current_sd,
                pack.resistance_ohm,
            ]
        )

    @property
    def soc(self) -> float:
        """State of charge, 0 to 1."""
        return min(1.0, float(self._state[0]))

    @property
    def soc_sd(self) -> float:
        """Its standard deviation."""
        return math.sqrt(self._covariance[0, 0] + self.pack.missed_sd**2)

    @property
    def health(self) -> float:
        """The capacity as a share of the rated one."""
        return float(self._state[4])

    @property
    def resistance_ohm(self) -> float:
        """Of the pack, without relaxation."""
        return float(self._state[3])

    def start_at(self, soc: float, sd: float) -> None:
        """Begin with a state of charge from another source."""
        self._state[0] = soc
        self._covariance[0, :] = self._covariance[:, 0] = 0.0
        self._covariance[0, 0] = sd * sd

    def start_from(self, voltage_v: float, current_a: float) -> None:
        """Begin with a first measurement, assumed to be at rest behind the whole resistance."""
        pack = self.pack
        behind_ohm = pack.resistance_ohm * (1.0 + pack.relaxation_share)
        open_v = voltage_v + current_a * pack.resistance_ohm
        soc = float(np.interp(open_v, self._curve_v, self._curve_soc))
        slope_v = _slope(self._curve_soc, self._curve_v, soc)
        sd_v = math.hypot(pack.curve_sd_v, pack.voltage_sd_v, current_a * behind_ohm)
        self.start_at(soc, min(0.3, sd_v / slope_v))

    def expected_v(self, current_a: float) -> float:
        """Voltage at the terminals with this current now."""
        soc, relaxation_v, wrong_v, resistance_ohm, _ = self._state.tolist()
        open_v = _along(self._curve_soc, self._curve_v, soc)
        return float(open_v - relaxation_v + wrong_v - current_a * resistance_ohm)

    def snapshot(self) -> tuple[Floats, Floats]:
        """State and covariance as they are, for `restore`."""
        return self._state.copy(), self._covariance.copy()

    def restore(self, snapshot: tuple[Floats, Floats]) -> None:
        """Forget all later changes."""
        self._state, self._covariance = snapshot[0].copy(), snapshot[1].copy()

    def count(self, current_a: float, duration_s: float) -> None:
        """Predict the state after a time with this current."""
        _predict(self._state, self._covariance, self._constants, current_a, duration_s)

    def doubt(self, sd: float) -> None:
        """Increase the uncertainty of the state of charge; it adds to the standard deviation itself, as a bias does."""
        before = math.sqrt(self._covariance[0, 0])
        grown = min(0.5, before + sd)
        self._covariance[0, 0] = grown * grown

    def fuse(self, voltage_v: float, current_a: float) -> None:
        """Correct by a voltage that was measured together with this current."""
        _update(self._state, self._covariance, self._constants, self._curve_soc, self._curve_v, voltage_v, current_a)

    def count_guess(self, current_a: float, sd_a: float, duration_s: float) -> None:
        """Predict the state after a guessed current, with this standard deviation."""
        self.count(current_a, duration_s)
        share = sd_a / (self.rated_c * float(self._state[4]))
        grown = self._covariance[0, 0] + share * share * SAME_ERROR_S * duration_s
        self._covariance[0, 0] = max(float(self._covariance[0, 0]), min(0.25, grown))

    def fuse_at_guess(self, voltage_v: float, current_a: float, sd_a: float, duration_s: float) -> None:
        """As `fuse`, with a guessed current; `duration_s` since the last time."""
        behind_ohm = self.resistance_ohm * (1.0 + self.pack.relaxation_share)
        constants = self._constants.copy()
        constants[_VOLTAGE_SD] = _once(math.hypot(self.pack.voltage_sd_v, sd_a * behind_ohm), duration_s)
        _update(self._state, self._covariance, constants, self._curve_soc, self._curve_v, voltage_v, current_a)

    def fuse_soc(self, soc: float, sd: float, duration_s: float) -> None:
        """Correct by a state of charge that the battery itself reports; `duration_s` since it last did.

        The estimate follows it within `SAME_ERROR_S`, and its certainty never exceeds that of the report.
        """
        state, covariance = self._state, self._covariance
        covariance[0, 0] += sd * sd * min(1.0, duration_s / SAME_ERROR_S)
        cross = covariance[:, 0].copy()
        spread = float(cross[0]) + _once(sd, duration_s) ** 2
        state += cross / spread * (soc - float(state[0]))
        covariance -= np.outer(cross, cross) / spread
        state[0] = min(SOC_MOST, max(SOC_LEAST, float(state[0])))
        state[3] = max(RESISTANCE_LEAST * self.pack.resistance_ohm, float(state[3]))
        state[4] = min(HEALTH_MOST, max(HEALTH_LEAST, float(state[4])))

    def remaining_j(self) -> tuple[float, float]:
        """Energy at the terminals above the cut-off, and its standard deviation."""
        pack, state, covariance = self.pack, self._state, self._covariance
        soc, health = self.soc, float(state[4])
        drop_v = pack.drive_current_a * float(state[3]) * (1.0 + pack.relaxation_share)
        left_behind = pack.rate_loss_s * pack.drive_current_a / (self.rated_c * health)
        empty = float(_along(self._curve_v, self._curve_soc, pack.cut_off_v + drop_v)) + left_behind
        room_v = self._area(soc) - self._area(empty) - drop_v * (soc - empty)
        end_v = _along(self._curve_soc, self._curve_v, soc) - drop_v
        by_soc, by_health = health * end_v, room_v
        variance = by_soc * by_soc * self.soc_sd**2 + by_health * by_health * covariance[4, 4]
        variance += 2.0 * by_soc * by_health * covariance[0, 4]
        drop_sd_v = pack.drive_current_a * math.sqrt(covariance[3, 3]) * (1.0 + pack.relaxation_share)
        empty_sd = math.hypot(drop_sd_v, pack.curve_sd_v) / _slope(self._curve_soc, self._curve_v, empty)
        empty_sd = math.hypot(empty_sd, 0.5 * left_behind)
        variance += (health * end_v * empty_sd) ** 2 + (health * (soc - empty) * drop_sd_v) ** 2
        mean_j = self.rated_c * health * room_v
        return max(0.0, mean_j), self.rated_c * math.sqrt(max(0.0, variance))

    def interval_j(self) -> tuple[float, float, float]:
        """Remaining energy and the ends of its 95 % interval: mean, low, high."""
        mean_j, sd_j = self.remaining_j()
        return mean_j, max(0.0, mean_j - _SD_95 * sd_j), mean_j + _SD_95 * sd_j

    def _area(self, soc: float) -> float:
        """Integral of the curve from empty to here."""
        upper = min(len(self.pack.curve_soc) - 1, max(1, bisect_left(self.pack.curve_soc, soc)))
        span = soc - float(self._curve_soc[upper - 1])
        here_v = _along(self._curve_soc, self._curve_v, soc)
        return float(self._areas[upper - 1]) + span * (float(self._curve_v[upper - 1]) + here_v) / 2


_VOLTAGE_SD = 5
"""Place of `voltage_sd_v` in the constants."""


def _once(sd: float, duration_s: float) -> float:
    """Standard deviation for each of several measurements with the same error that are to count as one."""
    return sd * math.sqrt(max(1.0, SAME_ERROR_S / duration_s))


@njit(cache=True, nogil=True)
def _upper(curve_soc: Floats, soc: float) -> int:
    # The curve has a dozen points: a linear search is faster than bisection.
    for index in range(1, len(curve_soc) - 1):
        if curve_soc[index] >= soc:
            return index
    return len(curve_soc) - 1


@njit(cache=True, nogil=True)
def _slope(curve_soc: Floats, curve_v: Floats, soc: float) -> float:
    upper = _upper(curve_soc, soc)
    return float((curve_v[upper] - curve_v[upper - 1]) / (curve_soc[upper] - curve_soc[upper - 1]))


@njit(cache=True, nogil=True)
def _along(places: Floats, values: Floats, place: float) -> float:
    # numpy's interp for one place, at a tenth of its time.
    upper = _upper(places, place)
    share = (place - places[upper - 1]) / (places[upper] - places[upper - 1])
    return float(values[upper - 1] + min(1.0, max(0.0, share)) * (values[upper] - values[upper - 1]))


@njit(cache=True, nogil=True)
def _predict(x: Floats, covariance: Floats, constants: Floats, current_a: float, duration_s: float) -> None:
    rated_c, share, relaxation_s, curve_sd_v, wander_s, _, current_sd, nominal_ohm = constants
    moved = current_a * duration_s / (x[4] * rated_c)
    stays = math.exp(-duration_s / relaxation_s)
    steady = math.exp(-duration_s / wander_s)
    by_health, by_resistance = moved / x[4], (1.0 - stays) * current_a * share
    x[1] = stays * x[1] + (1.0 - stays) * current_a * share * x[3]
    x[0] = min(SOC_MOST, max(SOC_LEAST, x[0] - moved))
    x[2] *= steady
    # F·P·Fᵀ; F is the identity but for five places: rows first, then columns.
    for k in range(5):
        covariance[0, k] += by_health * covariance[4, k]
        covariance[1, k] = stays * covariance[1, k] + by_resistance * covariance[3, k]
        covariance[2, k] *= steady
    for k in range(5):
        covariance[k, 0] += by_health * covariance[k, 4]
        covariance[k, 1] = stays * covariance[k, 1] + by_resistance * covariance[k, 3]
        covariance[k, 2] *= steady
    # Counting errors are a bias more than a noise: the spread that this gives after an hour at one hour's rate.
    covariance[0, 0] += current_sd * current_sd * abs(moved)
    covariance[1, 1] += (0.1 * current_a * share * x[3]) ** 2 * (1.0 - stays * stays)
    covariance[2, 2] += curve_sd_v * curve_sd_v * (1.0 - steady * steady)
    # Resistance follows temperature and charge: a tenth of it in an hour. Health does not change in a day.
    covariance[3, 3] += (0.1 * nominal_ohm) ** 2 * duration_s / 3600.0


@njit(cache=True, nogil=True)
def _update(
    x: Floats,
    covariance: Floats,
    constants: Floats,
    curve_soc: Floats,
    curve_v: Floats,
    voltage_v: float,
    current_a: float,
) -> None:
    voltage_sd_v, nominal_ohm = constants[_VOLTAGE_SD], constants[7]
    # The measurement's row is H = (slope, -1, 1, -current, 0).
    slope_v = _slope(curve_soc, curve_v, x[0])
    innovation_v = voltage_v - (_along(curve_soc, curve_v, x[0]) - x[1] + x[2] - current_a * x[3])
    cross = np.empty(5)
    for k in range(5):
        cross[k] = slope_v * covariance[k, 0] - covariance[k, 1] + covariance[k, 2] - current_a * covariance[k, 3]
    spread = slope_v * cross[0] - cross[1] + cross[2] - current_a * cross[3] + voltage_sd_v * voltage_sd_v
    for k in range(5):
        x[k] += cross[k] / spread * innovation_v
    for k in range(5):
        for m in range(k + 1):
            covariance[k, m] -= cross[k] * cross[m] / spread
            covariance[m, k] = covariance[k, m]
    x[0] = min(SOC_MOST, max(SOC_LEAST, x[0]))
    x[3] = max(RESISTANCE_LEAST * nominal_ohm, x[3])
    x[4] = min(HEALTH_MOST, max(HEALTH_LEAST, x[4]))
