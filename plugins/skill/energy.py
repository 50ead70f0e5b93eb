"""Energy: learns energy costs from the battery and the wheels, and estimates the cost of work."""

import math
from typing import Protocol

from robrain.agent.plugin import Skill, external
from robrain.algorithms.energy.consumption import Consumption, PowerPrior
from robrain.plugins.unit.battery import BatteryInterface
from robrain.plugins.unit.driver.interface import DriverInterface
from robrain.protocol.model.energy_model import EnergyEstimate, EnergyModel, Work, estimate

__all__ = ["EnergyEstimate", "EnergyInterface", "EnergyModel", "Work"]


class EnergyInterface(Protocol):
    """Energy costs of this robot, in joules at the battery's terminals."""

    def estimate(self, work: Work) -> EnergyEstimate:
        """Cost of this work; use `high_j(0.95)` before a promise."""

    def usable_j(self) -> float:
        """Lower 95 % bound of the energy before the cut-off; 0 while the battery is unknown."""

    def outcome(self, work: Work, cost_j: float) -> None:
        """Report the cost of work that went as planned; it adjusts later estimates of paths."""

    def power_w(self) -> float:
        """Power drawn, averaged over some seconds; the manifest's idle power before the first measurement."""


class Energy(Skill):
    """Learns the robot's power model and predicts the energy of work."""

    class Parameters(PowerPrior, frozen=True, kw_only=True, forbid_unknown_fields=True):
        """Values assumed before anything is measured, and values that are never measured."""

        packet_j: float = 0.0008
        """One packet of 36 bytes by a Mica2 at full power: 26.9 mA at 3 V (CPU and sending) for 10 ms."""
        relative_sd: float = 0.03
        """Relative standard deviation of a path's cost: detours and swerving. Chosen; learned from outcomes."""

    interface = EnergyInterface
    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        parameters = self.parameters
        self._consumption = Consumption(parameters, parameters.packet_j, parameters.relative_sd)
        self._model: EnergyModel | None = None
        self._seen_ns = -1

    def activate(self) -> None:
        self._battery = self.env.use("battery", BatteryInterface)
        self._driver = self.env.use("driver", DriverInterface)

    def step(self) -> None:
        velocity = self._driver.velocity()
        speed_m_s = math.hypot(velocity.forward_m_s, velocity.left_m_s)
        self._consumption.move(
            self.env.clock.now_ns(), speed_m_s, abs(velocity.yaw_rad_s), is_usual=not self.env.board.is_slowed
        )
        drawn = self._battery.drawn()
        if drawn is None or drawn.stamp_ns == self._seen_ns:
            return
        self._seen_ns = drawn.stamp_ns
        if self._consumption.draw(drawn) or not drawn.trusted:
            self._model = None
            self.env.board.energy = self._current_model()

    @external
    def estimate(self, work: Work) -> EnergyEstimate:
        """Expected cost of this work: mean and standard deviation in joules, and its duration."""
        return estimate(self._current_model(), work)

    @external
    def usable_j(self) -> float:
        """Lower 95 % bound of the energy before the cut-off; 0 while the battery is unknown."""
        state = self._battery.state()
        return state.remaining_low_j if state is not None else 0.0

    @external
    def power_w(self) -> float:
        """Power drawn, averaged over some seconds."""
        return self._consumption.power_w

    @external
    def model(self) -> EnergyModel:
        """The learned model, as in the robot's state."""
        return self._current_model()

    def outcome(self, work: Work, cost_j: float) -> None:
        """Report the cost of work that went as planned; it adjusts later estimates of paths."""
        self._consumption.compare(work, cost_j)
        self._model = None

    def _current_model(self) -> EnergyModel:
        if self._model is None:
            self._model = self._consumption.model(self.usable_j())
        return self._model
