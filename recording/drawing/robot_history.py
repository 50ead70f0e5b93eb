"""A robot's last minutes in figures: the data of its charts."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.localization.pose_accuracy import position_sigma_m
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.team.arena_messages import RobotTruth
from robrain.protocol.model.energy_model import STILL_BELOW, EnergyModel
from robrain.protocol.model.geometry import Twist2D

STEP_S = 1.0
POINTS = 600
LONGEST_STEP_S = 5.0
"""Two states farther apart than this have a gap between them, in which energy is not reckoned."""
FAR_J = 1e9
NAN = float("nan")


class HistorySample(NamedTuple):
    """One line of the history; unknown values are nan."""

    time_s: float
    soc_percent: float
    power_w: float
    model_power_w: float
    """Power of its motion by the robot's own model."""
    measured_j: float
    """Since the beginning of the history, at the battery's terminals."""
    predicted_j: float
    """The same by the model."""
    error_m: float
    """Distance between its true and its estimated place, if an arena publishes the true one."""
    sigma_m: float
    """Expected distance by its own covariance: the longer half-axis of the 1-sigma ellipse."""


class RobotHistory:
    """Samples a robot's states once a second of the robot's clock; ten minutes are kept."""

    def __init__(self) -> None:
        self.samples: deque[HistorySample] = deque(maxlen=POINTS)
        self._before: RobotState | None = None
        self._first_ns: int | None = None
        self._measured_j = self._predicted_j = 0.0

    def handle(self, state: RobotState, truth: RobotTruth | None) -> None:
        """Add a state, and the robot's pose by the arena."""
        before, self._before = self._before, state
        if self._first_ns is None:
            self._first_ns = state.stamp_ns
        time_s = (state.stamp_ns - self._first_ns) / 1e9
        if before is not None:
            self._reckon(before, (state.stamp_ns - before.stamp_ns) / 1e9)
        if self.samples and time_s < self.samples[-1].time_s:  # its clock fell back: another life of it
            self.samples.clear()
        if self.samples and time_s - self.samples[-1].time_s < STEP_S:
            return
        battery = state.battery
        self.samples.append(
            HistorySample(
                time_s,
                100 * battery.soc if battery is not None else NAN,
                battery.voltage_v * battery.current_a if battery is not None else NAN,
                model_power_w(state.energy, state.velocity) if state.energy is not None else NAN,
                self._measured_j,
                self._predicted_j if state.energy is not None else NAN,
                state.pose.distance_m(truth.pose) if truth is not None and state.pose is not None else NAN,
                position_sigma_m(state.pose_covariance),
            )
        )

    def continue_from(self, samples: list[HistorySample], whole: "RobotHistory") -> None:
        """Have these samples of the whole history as one's own past."""
        self.samples.clear()
        self.samples.extend(samples)
        self._first_ns = whole._first_ns
        if samples:
            self._measured_j = samples[-1].measured_j
            self._predicted_j = samples[-1].predicted_j if math.isfinite(samples[-1].predicted_j) else 0.0

    def columns(self) -> dict[str, NDArray[np.float64]]:
        """The samples as one array for each field, oldest first."""
        table = np.array(self.samples, np.float64).reshape(-1, len(HistorySample._fields))
        return dict(zip(HistorySample._fields, table.T, strict=True))

    def _reckon(self, before: RobotState, passed_s: float) -> None:
        if not 0 < passed_s <= LONGEST_STEP_S:
            return
        battery, energy = before.battery, before.energy
        if battery is not None:
            self._measured_j = _added(self._measured_j, battery.voltage_v * battery.current_a * passed_s)
        if energy is not None:
            self._predicted_j = _added(self._predicted_j, model_power_w(energy, before.velocity) * passed_s)


def model_power_w(model: EnergyModel, velocity: Twist2D) -> float:
    """Power of a steady motion by the robot's model.

    The terms are those of `protocol.model.energy_model`.
    """
    speed_m_s, turn_rad_s = math.hypot(velocity.forward_m_s, velocity.left_m_s), abs(velocity.yaw_rad_s)
    moves = speed_m_s > STILL_BELOW or turn_rad_s > STILL_BELOW
    idle_w, moving_w, speed_w, yaw_w, _ = model.coefficients
    return idle_w + (moving_w + speed_w * speed_m_s + yaw_w * turn_rad_s if moves else 0.0)


def _added(total_j: float, more_j: float) -> float:
    after_j = total_j + more_j
    return after_j if abs(after_j) < FAR_J else total_j
