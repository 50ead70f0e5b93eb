"""Learning what a robot draws: recursive least squares over the terms of its power.

Forgetting is directional (Cao & Schwartz: A directional forgetting algorithm based on the decomposition of the
information matrix, Automatica 36, 2000): old information is discounted only where a measurement replaces it, so that a
robot that stands for an hour still knows what driving costs.

What the terms leave unexplained is measured by batch means (Law: Simulation Modeling and Analysis, 5th ed., 9.5.3):
neighbouring residuals are not independent, and the mean of one over a long way varies more than their scatter suggests.
"""

import math

import msgspec
import numpy as np

from robrain.algorithms.numeric.small_linear_algebra import dot, inverse_form, times_vector
from robrain.protocol.model.energy_model import STANDING_BELOW, TERMS
from robrain.protocol.model.ranges import check_positive

BATCH_S = 20.0
PACE_OVER_S = 60.0
"""Time of motion over which the pace is averaged. Chosen: some legs."""
RESIDUAL_BATCHES = 30
"""Batches over which the unexplained is averaged; the prior counts as `PRIOR_BATCHES`."""
PRIOR_BATCHES = 4


class PowerPrior(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is believed before anything is measured. Chosen for a base of 4 kg with a small computer.

    Raises ValueError where it is built with an impossible figure.
    """

    standing_w: float = 8.0
    moving_w: float = 0.4
    speed_w_per_m_s: float = 9.0
    yaw_w_per_rad_s: float = 1.5
    acceleration_kg: float = 8.0
    standing_sd: float = 3.0
    moving_sd: float = 0.5
    speed_sd: float = 4.0
    yaw_sd: float = 0.7
    acceleration_sd: float = 3.0
    residual_w2_s: float = 4.0
    """Variance per second of the integral of the unexplained power."""
    memory_s: float = 300.0
    """Time constant of forgetting."""
    standing_drift_w: float = 1.0
    """Drift of the standing power within an hour, a standard deviation: the computer's load changes."""
    pace_m_s: float = 0.5
    turn_rate_rad_s: float = 1.2

    def __post_init__(self) -> None:
        check_positive(self, below=math.inf)


class PowerLearner:
    """Coefficients of the terms, and how sure they are.

    Args:
        prior: where it begins.

    """

    def __init__(self, prior: PowerPrior) -> None:
        self.prior = prior
        self._mean = np.array([getattr(prior, name) for name in TERMS])
        sds = [prior.standing_sd, prior.moving_sd, prior.speed_sd, prior.yaw_sd, prior.acceleration_sd]
        self._covariance = np.diag(np.square(sds))
        self._batch_s = self._batch_j = 0.0
        self._batches = PRIOR_BATCHES
        self.residual_w2_s = prior.residual_w2_s
        self.drift_w2_per_s = _short(prior.standing_drift_w**2 / 3600.0)
        self.pace_m_s = prior.pace_m_s
        """Mean speed of the way; `turn_rate_rad_s` is that of turns on the spot."""
        self.turn_rate_rad_s = prior.turn_rate_rad_s

    @property
    def coefficients(self) -> tuple[float, float, float, float, float]:
        """In the order of `TERMS`; none is below 0."""
        standing, moving, speed, yaw, acceleration = (max(0.0, _short(value)) for value in self._mean.tolist())
        return standing, moving, speed, yaw, acceleration

    @property
    def covariance(self) -> tuple[float, ...]:
        """Lower triangle, row by row."""
        return tuple(_short(self._covariance[row, column]) for row in range(len(TERMS)) for column in range(row + 1))

    def learn(self, amounts: tuple[float, ...], energy_j: float) -> None:
        """Take in what was drawn while the terms' factors had these integrals; the first is the duration, s."""
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
        """Take in the pace of some time of motion."""
        share = min(1.0, duration_s / PACE_OVER_S)
        if speed_m_s > STANDING_BELOW:
            self.pace_m_s += share * (speed_m_s - self.pace_m_s)
        elif yaw_rate_rad_s > STANDING_BELOW:
            self.turn_rate_rad_s += share * (yaw_rate_rad_s - self.turn_rate_rad_s)

    def _collect(self, error_j: float, duration_s: float) -> None:
        self._batch_j += error_j
        self._batch_s += duration_s
        if self._batch_s < BATCH_S:
            return
        self._batches = min(RESIDUAL_BATCHES, self._batches + 1)
        # One batch is one draw of a chi-square; a huge one tells of something else, such as a load that was taken up.
        seen_w2_s = min(self._batch_j * self._batch_j / self._batch_s, 9.0 * self.residual_w2_s)
        self.residual_w2_s += (seen_w2_s - self.residual_w2_s) / self._batches
        self._batch_j = self._batch_s = 0.0


def _short(value: float) -> float:
    """Five digits are more than is known, and travel ten times a second."""
    return float(f"{value:.5g}")
