"""A robot's consumption: lessons from its battery and its wheels, and the model that comes of them."""

import math
from typing import NamedTuple

from robrain.protocol.model.energy.energy_model import EnergyModel, Work, estimate
from robrain.protocol.model.energy.motion_terms import MotionTerms
from robrain.protocol.model.energy.power_learner import PowerLearner, PowerPrior

NS = 1e-9
LESSON_S = 2.0
"""One lesson covers about this time: long against the delay between wheels and measurements."""
LESSON_MAX_S = 6.0
"""A lesson with a hole in it is none."""
POWER_OVER_S, USUAL_OVER_S = 5.0, 120.0
OUTCOMES = 20
"""Works over which plans are compared with what they cost; the prior counts as `PRIOR_OUTCOMES`."""
PRIOR_OUTCOMES = 4
RELATIVE_SD_LEAST = 0.01
OUTCOME_MOST = 0.3
"""A work that cost more than this beyond its plan, relatively, did not go as planned at all: counted as this."""


class Drawn(NamedTuple):
    """Energy drawn from the battery since some beginning."""

    stamp_ns: int
    energy_j: float
    trusted: bool
    """The measurement is believed, and nothing is being charged."""


class Consumption:
    """Learns, and makes the model.

    Args:
        prior: what is believed before anything is measured.
        packet_j: for one packet by radio.
        relative_sd: of the cost of a way, before any has been driven.

    """

    def __init__(self, prior: PowerPrior, packet_j: float, relative_sd: float) -> None:
        self.learner = PowerLearner(prior)
        self.power_w = prior.standing_w
        """Averaged over some seconds; `usual_power_w` over minutes."""
        self.usual_power_w = prior.standing_w
        self._packet_j = packet_j
        self._terms = MotionTerms()
        self._begun: Drawn | None = None
        self._last: Drawn | None = None
        self._way_ratio = 1.0
        self._relative_variance = relative_sd * relative_sd
        self._outcomes = PRIOR_OUTCOMES

    def move(self, stamp_ns: int, speed_m_s: float, yaw_rate_rad_s: float) -> None:
        """The robot's speeds now; both absolute."""
        elapsed_s = self._terms.move(stamp_ns, speed_m_s, yaw_rate_rad_s)
        self.learner.pass_by(speed_m_s, yaw_rate_rad_s, elapsed_s)

    def draw(self, drawn: Drawn) -> bool:
        """What has been drawn up to now; True if something was learned from it."""
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
        if begun is None or drawn.energy_j < begun.energy_j:  # less than before: the count began anew
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
        """Take in what a work has cost that was done as planned; waiting does not tell of ways."""
        model = self.model(0.0)
        planned = estimate(model, work)
        on_the_way_j = planned.mean_j - model.coefficients[0] * work.wait_s - model.packet_j * work.radio_packets
        if work.path_m <= 0 or on_the_way_j <= 0:
            return
        by_way_j = model.relative_sd * on_the_way_j
        known = max(0.0, planned.sigma_j**2 - by_way_j**2) / on_the_way_j**2
        error = min(OUTCOME_MOST, max(-OUTCOME_MOST, (cost_j - planned.mean_j) / on_the_way_j))
        self._outcomes = min(OUTCOMES, self._outcomes + 1)
        self._way_ratio *= 1.0 + error / self._outcomes
        # What the power alone explains is not held against the way.
        self._relative_variance += (max(0.0, error * error - known) - self._relative_variance) / self._outcomes

    def model(self, usable_j: float) -> EnergyModel:
        """What is known now."""
        learner = self.learner
        return EnergyModel(
            coefficients=learner.coefficients,
            covariance=learner.covariance,
            residual_w2_s=round(learner.residual_w2_s, 4),
            drift_w2_per_s=learner.drift_w2_per_s,
            relative_sd=round(max(RELATIVE_SD_LEAST, math.sqrt(self._relative_variance)), 4),
            way_ratio=round(self._way_ratio, 4),
            pace_m_s=round(learner.pace_m_s, 4),
            turn_rate_rad_s=round(learner.turn_rate_rad_s, 4),
            packet_j=self._packet_j,
            usable_j=round(usable_j, 1),
            power_w=round(self.power_w, 3),
            usual_power_w=round(self.usual_power_w, 3),
        )
