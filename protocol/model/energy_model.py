"""Energy cost of work for a robot, from the model that it has learned of itself.

Power is a sum of terms: idle (with compute), moving, speed, turning, speeding up. The terms are those of two
papers by Mei, Lu, Hu, Lee. These are: Energy-Efficient Motion Planning for Mobile Robots, ICRA 2004; A Case Study of
Mobile Robot's Energy Consumption and Conservation Techniques, ICAR 2005. Sensing, control and computing draw a
constant; the motors draw a loss when they turn, and m(a + gμ)v. All joules are at the battery's terminals. Pure
functions: the robot and the coordinator get the same figures from the same published model.
"""

import math
from statistics import NormalDist
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Joules, NotNegative, Pace, Positive, Quantity, Watts

TERMS = ("idle_w", "moving_w", "speed_w_per_m_s", "yaw_w_per_rad_s", "acceleration_kg")
"""Names of the coefficients, in order. The last is a mass: the energy of a change of v²/2."""
CARRY_J_PER_KG_M = 0.3
"""Energy to carry a kilogram for a metre on a level floor: g·c/η. The rolling resistance c = 0.015 and the drive's
efficiency η = 0.5 are chosen, not measured."""
STILL_BELOW = 0.01
"""Below this many m/s and rad/s the robot stands; chosen above the noise of encoders."""


class Work(Checked, frozen=True):
    """Work of a robot: a path, turns on the spot, waiting, radio packets.

    Raises ValueError if an amount is negative or infinite, or the speed is not above 0.
    """

    path_m: NotNegative = 0.0
    turn_rad: NotNegative = 0.0
    """Sum of the turns on the spot; an omni base need not turn to follow a path."""
    wait_s: NotNegative = 0.0
    radio_packets: NotNegative = 0
    speed_m_s: Positive | None = None
    """The robot's usual pace if None."""
    carried_kg_m: NotNegative = 0.0
    """Payload times the length of the path on which it is carried, summed."""
    ends_at: Point2D | None = None
    """Where the robot is after it, arena frame; None for where it began."""

    def __add__(self, other: "Work") -> "Work":
        """Both in sequence, the paths at their mean speed.

        Raises:
            ValueError: one path has a speed and the other has the usual pace, which only a model contains.

        """
        paths = [work for work in (self, other) if work.path_m > 0] or [self]
        speeds_m_s = [work.speed_m_s for work in paths if work.speed_m_s is not None]
        if speeds_m_s and len(speeds_m_s) < len(paths):
            raise ValueError("expected two ways with a speed, or two without; estimate each by itself")
        speed_m_s = speeds_m_s[0] if speeds_m_s else None
        if len(speeds_m_s) == 2 and speeds_m_s[0] != speeds_m_s[1]:
            durations_s = [work.path_m / speed for work, speed in zip(paths, speeds_m_s, strict=True)]
            speed_m_s = (self.path_m + other.path_m) / sum(durations_s)
        return Work(
            self.path_m + other.path_m,
            self.turn_rad + other.turn_rad,
            self.wait_s + other.wait_s,
            self.radio_packets + other.radio_packets,
            speed_m_s,
            self.carried_kg_m + other.carried_kg_m,
            other.ends_at or self.ends_at,
        )


class EnergyEstimate(msgspec.Struct, frozen=True):
    """Expected cost of work, as a normal distribution."""

    mean_j: float
    sigma_j: float
    duration_s: float

    def low_j(self, confidence: float) -> float:
        """It will cost at least this, with this confidence (one-sided, above 0 and below 1)."""
        return max(0.0, self.mean_j - NormalDist().inv_cdf(confidence) * self.sigma_j)

    def high_j(self, confidence: float) -> float:
        """It will cost at most this, with this confidence.

        The 90 % interval goes from `low_j(0.95)` to `high_j(0.95)`.
        """
        return max(0.0, self.mean_j + NormalDist().inv_cdf(confidence) * self.sigma_j)


class EnergyModel(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's model of its consumption, as published in its state."""

    coefficients: tuple[Watts, Watts, Watts, Watts, Watts]
    """In the order of `TERMS`."""
    covariance: Annotated[tuple[Quantity, ...], Meta(min_length=15, max_length=15)]
    """Covariance of the coefficients: the lower triangle row by row, 15 numbers."""
    residual_w2_s: Annotated[float, Meta(ge=0.0, le=1e12)]
    """Power that the terms do not explain: variance of its integral per second (W²·s)."""
    drift_w2_per_s: Annotated[float, Meta(ge=0.0, le=1e12)]
    """Variance that the idle power gains per second, because it drifts."""
    relative_sd: Annotated[float, Meta(ge=0.0, le=1e3)]
    """Standard deviation of a path's cost around its plan, as a share of the cost."""
    path_ratio: Annotated[float, Meta(ge=0.0, le=1e3)]
    """Mean ratio of a path's cost to its plan: stops and detours that no plan foresees."""
    pace_m_s: Pace
    """Usual speed along a path, including stops and corners."""
    turn_rate_rad_s: Pace
    """Usual rate of turns on the spot."""
    packet_j: Joules
    """Energy of one radio packet."""
    usable_j: Joules
    """Lower 95 % bound of the energy left before the battery cuts off."""
    power_w: Watts
    """Power drawn now, averaged over some seconds."""
    usual_power_w: Watts
    """Mean power over the last minutes."""


def estimate(model: EnergyModel, work: Work) -> EnergyEstimate:
    """Cost of this work for a robot of this model."""
    duration_s, moving, speed, yaw, acceleration = integrals(model, work)
    amounts = (duration_s, moving, speed, yaw, acceleration)
    mean_j = sum(amount * coefficient for amount, coefficient in zip(amounts, model.coefficients, strict=True))
    waiting_j = work.wait_s * model.coefficients[0]
    path_j = model.path_ratio * (mean_j - waiting_j)
    mean_j = waiting_j + path_j + work.radio_packets * model.packet_j + work.carried_kg_m * CARRY_J_PER_KG_M
    variance_j2 = quadratic_form(model.covariance, amounts)
    variance_j2 += duration_s * model.residual_w2_s + model.drift_w2_per_s * duration_s**3 / 3.0
    variance_j2 += (model.relative_sd * path_j) ** 2
    return EnergyEstimate(max(0.0, mean_j), math.sqrt(max(0.0, variance_j2)), duration_s)


def integrals(model: EnergyModel, work: Work) -> tuple[float, float, float, float, float]:
    """The integrals of the terms' factors over the work, in the order of `TERMS`; the first is its duration, s.

    A path is assumed to need one acceleration.
    """
    speed_m_s = work.speed_m_s if work.speed_m_s is not None else model.pace_m_s
    moving_s = work.path_m / speed_m_s + work.turn_rad / model.turn_rate_rad_s
    started = 0.5 * speed_m_s * speed_m_s if work.path_m > 0 else 0.0
    return moving_s + work.wait_s, moving_s, work.path_m, work.turn_rad, started


def quadratic_form(lower: tuple[float, ...], vector: tuple[float, ...]) -> float:
    """vᵀ·M·v of a symmetric matrix given by its lower triangle, row by row.

    >>> quadratic_form((4.0, 1.0, 9.0), (1.0, 2.0))
    44.0
    """
    total, position = 0.0, 0
    for row, value in enumerate(vector):
        for column in range(row):
            total += 2.0 * value * vector[column] * lower[position + column]
        total += value * value * lower[position + row]
        position += row + 1
    return total
