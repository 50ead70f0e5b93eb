"""A robot's consumption: lessons from its battery and its wheels, and the model that comes of them.

The integrals of the power's factors are kept long enough to be asked for between two stamps of the battery.
"""

import math
from bisect import bisect_right
from collections import deque
from typing import NamedTuple

import numpy as np

from robrain.algorithms.numeric.small_linear_algebra import dot, inverse_form, times_vector
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.energy_model import STILL_BELOW, TERMS, EnergyModel, Work, estimate
from robrain.protocol.model.ranges import Positive

BATCH_S = 20.0
PACE_OVER_S = 60.0
"""Time of motion over which the pace is averaged. Chosen: some legs."""
RESIDUAL_BATCHES = 30
"""Batches over which the unexplained is averaged; the prior counts as `PRIOR_BATCHES`."""
PRIOR_BATCHES = 4


class PowerPrior(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Values assumed before anything is measured.

    Chosen for a base of 4 kg with a small computer.

    Raises ValueError if a value is impossible.
    """

    idle_w: Positive = 8.0
    moving_w: Positive = 0.4
    speed_w_per_m_s: Positive = 9.0
    yaw_w_per_rad_s: Positive = 1.5
    acceleration_kg: Positive = 8.0
    idle_sd: Positive = 3.0
    moving_sd: Positive = 0.5
    speed_sd: Positive = 4.0
    yaw_sd: Positive = 0.7
    acceleration_sd: Positive = 3.0
    residual_w2_s: Positive = 4.0
    """Variance per second of the integral of the unexplained power."""
    memory_s: Positive = 300.0
    """Time constant of forgetting."""
    idle_drift_w: Positive = 1.0
    """Drift of the idle power within an hour, a standard deviation: the computer's load changes."""
    pace_m_s: Positive = 0.5
    turn_rate_rad_s: Positive = 1.2


class PowerLearner:
    """Coefficients of the terms, and their certainty.

    Args:
        prior: where it begins.

    """

    def __init__(self, prior: PowerPrior) -> None:
        self.prior = prior
        self._mean = np.array([getattr(prior, name) for name in TERMS])
        sds = [prior.idle_sd, prior.moving_sd, prior.speed_sd, prior.yaw_sd, prior.acceleration_sd]
        self._covariance = np.diag(np.square(sds))
        self._batch_s = self._batch_j = 0.0
        self._batches = PRIOR_BATCHES
        self.residual_w2_s = prior.residual_w2_s
        self.drift_w2_per_s = _short(prior.idle_drift_w**2 / 3600.0)
        self.pace_m_s = prior.pace_m_s
        """Mean speed on the path; `turn_rate_rad_s` is that of turns on the spot."""
        self.turn_rate_rad_s = prior.turn_rate_rad_s

    @property
    def coefficients(self) -> tuple[float, float, float, float, float]:
        """In the order of `TERMS`; none is below 0."""
        at_rest, moving, speed, yaw, acceleration = (max(0.0, _short(value)) for value in self._mean.tolist())
        return at_rest, moving, speed, yaw, acceleration

    @property
    def covariance(self) -> tuple[float, ...]:
        """Lower triangle, row by row."""
        return tuple(_short(self._covariance[row, column]) for row in range(len(TERMS)) for column in range(row + 1))

    def learn(self, amounts: tuple[float, ...], energy_j: float) -> None:
        """Learn from the energy drawn while the terms' factors had these integrals; the first is the duration, s."""
        duration_s = amounts[0]
        factors = np.array(amounts) / duration_s
        error_w = energy_j / duration_s - dot(factors, self._mean)
        self._collect(error_w * duration_s, duration_s)
        keeps = math.exp(-duration_s / self.prior.memory_s)
        self._covariance[0, 0] += self.drift_w2_per_s * duration_s
        informed = inverse_form(self._covariance, factors)
        covariance = self._covariance + (1.0 - keeps) / keeps / informed * np.outer(factors, factors)
        spread = times_vector(covariance, factors)
        gain = spread / (dot(factors, spread) + self.residual_w2_s / duration_s)
        self._mean += gain * error_w
        covariance -= np.outer(gain, spread)
        self._covariance = (covariance + covariance.T) / 2.0

    def pass_by(self, speed_m_s: float, yaw_rate_rad_s: float, duration_s: float) -> None:
        """Learn from the pace of some time of motion."""
        share = min(1.0, duration_s / PACE_OVER_S)
        if speed_m_s > STILL_BELOW:
            self.pace_m_s += share * (speed_m_s - self.pace_m_s)
        elif yaw_rate_rad_s > STILL_BELOW:
            self.turn_rate_rad_s += share * (yaw_rate_rad_s - self.turn_rate_rad_s)

    def _collect(self, error_j: float, duration_s: float) -> None:
        self._batch_j += error_j
        self._batch_s += duration_s
        if self._batch_s < BATCH_S:
            return
        self._batches = min(RESIDUAL_BATCHES, self._batches + 1)
        # One batch is one draw of a chi-square; a huge one has another cause, such as a load that was picked up.
        seen_w2_s = min(self._batch_j * self._batch_j / self._batch_s, 9.0 * self.residual_w2_s)
        self.residual_w2_s += (seen_w2_s - self.residual_w2_s) / self._batches
        self._batch_j = self._batch_s = 0.0


def _short(value: float) -> float:
    """Five digits exceed the accuracy, and are sent ten times a second."""
    return float(f"{value:.5g}")


NS = 1e-9
LESSON_S = 2.0
"""One lesson covers about this time: long against the delay between wheels and measurements."""
LESSON_MAX_S = 6.0
"""A lesson with a hole in it is none."""
POWER_OVER_S, USUAL_OVER_S = 5.0, 120.0
OUTCOMES = 20
"""Works over which plans are compared with their cost; the prior counts as `PRIOR_OUTCOMES`."""
PRIOR_OUTCOMES = 4
RELATIVE_SD_LEAST = 0.01
OUTCOME_MOST = 0.3
"""A work that cost more than this beyond its plan, relatively, did not go as planned at all: counted as this."""
KEPT = 128
"""Samples that are kept: 25 s at 5 Hz."""
GAP_S = 0.5
"""A longer time without a sample is a hole."""

Amounts = tuple[float, float, float, float, float]


class MotionTerms:
    """Adds up motion, sample by sample. Between samples the speeds are taken to change evenly."""

    def __init__(self) -> None:
        self._stamps: deque[int] = deque(maxlen=KEPT)
        self._sums: deque[Amounts] = deque(maxlen=KEPT)
        self._speed_m_s = 0.0
        self._yaw_rate_rad_s = 0.0

    def move(self, stamp_ns: int, speed_m_s: float, yaw_rate_rad_s: float) -> float:
        """Add the absolute speeds at a time; returns the time since the sample before, 0 for the first."""
        before_m_s, before_rad_s = self._speed_m_s, self._yaw_rate_rad_s
        self._speed_m_s, self._yaw_rate_rad_s = speed_m_s, yaw_rate_rad_s
        if self._stamps and stamp_ns - self._stamps[-1] > GAP_S / NS:
            self._stamps.clear()
            self._sums.clear()
        if not self._stamps:
            self._stamps.append(stamp_ns)
            self._sums.append((0.0, 0.0, 0.0, 0.0, 0.0))
            return 0.0
        elapsed_s = (stamp_ns - self._stamps[-1]) * NS
        if elapsed_s <= 0:
            return 0.0
        duration_s, moving_s, path_m, turned_rad, started = self._sums[-1]
        mean_m_s, mean_rad_s = 0.5 * (before_m_s + speed_m_s), 0.5 * (before_rad_s + yaw_rate_rad_s)
        is_moving = mean_m_s > STILL_BELOW or mean_rad_s > STILL_BELOW
        gained = 0.5 * (speed_m_s * speed_m_s - before_m_s * before_m_s)
        self._stamps.append(stamp_ns)
        self._sums.append(
            (
                duration_s + elapsed_s,
                moving_s + (elapsed_s if is_moving else 0.0),
                path_m + mean_m_s * elapsed_s,
                turned_rad + mean_rad_s * elapsed_s,
                started + max(0.0, gained),
            )
        )
        return elapsed_s

    def between(self, from_ns: int, to_ns: int) -> Amounts | None:
        """The integrals between two stamps, in the order of `TERMS`; None if they are not known, or empty."""
        begun, ended = self._at(from_ns), self._at(to_ns)
        if begun is None or ended is None or to_ns <= from_ns:
            return None
        duration_s, moving_s, path_m, turned_rad, started = (b - a for a, b in zip(begun, ended, strict=True))
        return duration_s, moving_s, path_m, turned_rad, started

    def _at(self, stamp_ns: int) -> Amounts | None:
        if not self._stamps or not self._stamps[0] <= stamp_ns <= self._stamps[-1]:
            return None
        upper = min(len(self._stamps) - 1, max(1, bisect_right(self._stamps, stamp_ns)))
        first_ns, last_ns = self._stamps[upper - 1], self._stamps[upper]
        share = (stamp_ns - first_ns) / max(last_ns - first_ns, 1)
        lower, higher = self._sums[upper - 1], self._sums[upper]
        duration_s, moving_s, path_m, turned_rad, started = (
            a + share * (b - a) for a, b in zip(lower, higher, strict=True)
        )
        return duration_s, moving_s, path_m, turned_rad, started


class Drawn(NamedTuple):
    """Energy drawn from the battery since an arbitrary start."""

    stamp_ns: int
    energy_j: float
    trusted: bool
    """The measurement is reliable, and the battery is not being charged."""


class Consumption:
    """Learns the energy model from measurements.

    Args:
        prior: values assumed before anything is measured.
        packet_j: energy of one radio packet.
        relative_sd: of the cost of a path, before any has been driven.

    """

    def __init__(self, prior: PowerPrior, packet_j: float, relative_sd: float) -> None:
        self.learner = PowerLearner(prior)
        self.power_w = prior.idle_w
        """Averaged over some seconds; `usual_power_w` over minutes."""
        self.usual_power_w = prior.idle_w
        self._packet_j = packet_j
        self._terms = MotionTerms()
        self._begun: Drawn | None = None
        self._last: Drawn | None = None
        self._path_ratio = 1.0
        self._relative_variance = relative_sd * relative_sd
        self._outcomes = PRIOR_OUTCOMES

    def move(self, stamp_ns: int, speed_m_s: float, yaw_rate_rad_s: float, *, is_usual: bool = True) -> None:
        """The robot's speeds now, both absolute, and whether they are its usual ones."""
        elapsed_s = self._terms.move(stamp_ns, speed_m_s, yaw_rate_rad_s)
        if is_usual:
            self.learner.pass_by(speed_m_s, yaw_rate_rad_s, elapsed_s)

    def draw(self, drawn: Drawn) -> bool:
        """Learn from the charge drawn up to now; returns whether anything was learned."""
        last, self._last = self._last, drawn
        if not drawn.trusted:
            self._begun = None
            return False
        if last is not None and last.trusted and drawn.stamp_ns > last.stamp_ns:
            elapsed_s = (drawn.stamp_ns - last.stamp_ns) * NS
            power_w = (drawn.energy_j - last.energy_j) / elapsed_s
            self.power_w += min(1.0, elapsed_s / POWER_OVER_S) * (power_w - self.power_w)
            self.usual_power_w += min(1.0, elapsed_s / USUAL_OVER_S) * (power_w - self.usual_power_w)
        begun = self._begun
        if begun is None or drawn.energy_j < begun.energy_j:  # less than before: the count started again
            self._begun = drawn
            return False
        if (drawn.stamp_ns - begun.stamp_ns) * NS < LESSON_S:
            return False
        self._begun = drawn
        amounts = self._terms.between(begun.stamp_ns, drawn.stamp_ns)
        if amounts is None or amounts[0] > LESSON_MAX_S:
            return False
        self.learner.learn(amounts, drawn.energy_j - begun.energy_j)
        return True

    def compare(self, work: Work, cost_j: float) -> None:
        """Learn from the cost of a work that was done as planned; waiting shows nothing about paths."""
        model = self.model(0.0)
        planned = estimate(model, work)
        path_j = planned.mean_j - model.coefficients[0] * work.wait_s - model.packet_j * work.radio_packets
        if work.path_m <= 0 or path_j <= 0:
            return
        path_sd_j = model.relative_sd * path_j
        known = max(0.0, planned.sigma_j**2 - path_sd_j**2) / path_j**2
        error = min(OUTCOME_MOST, max(-OUTCOME_MOST, (cost_j - planned.mean_j) / path_j))
        self._outcomes = min(OUTCOMES, self._outcomes + 1)
        self._path_ratio *= 1.0 + error / self._outcomes
        # The path ratio does not change for a difference that the power alone explains.
        self._relative_variance += (max(0.0, error * error - known) - self._relative_variance) / self._outcomes

    def model(self, usable_j: float) -> EnergyModel:
        """The model learned so far."""
        learner = self.learner
        return EnergyModel(
            coefficients=learner.coefficients,
            covariance=learner.covariance,
            residual_w2_s=round(learner.residual_w2_s, 4),
            drift_w2_per_s=learner.drift_w2_per_s,
            relative_sd=round(max(RELATIVE_SD_LEAST, math.sqrt(self._relative_variance)), 4),
            path_ratio=round(self._path_ratio, 4),
            pace_m_s=round(learner.pace_m_s, 4),
            turn_rate_rad_s=round(learner.turn_rate_rad_s, 4),
            packet_j=self._packet_j,
            usable_j=round(usable_j, 1),
            power_w=round(self.power_w, 3),
            usual_power_w=round(self.usual_power_w, 3),
        )
