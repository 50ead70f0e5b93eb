"""What the energy skill offers."""

from typing import Protocol

from robrain.protocol.model.energy_model import EnergyEstimate, EnergyModel, Work

__all__ = ["EnergyEstimate", "EnergyInterface", "EnergyModel", "Work"]


class EnergyInterface(Protocol):
    """What things cost this robot, in joules at the battery's terminals."""

    def estimate(self, work: Work) -> EnergyEstimate:
        """What this work will cost; ask for `high_j(0.95)` before promising anything."""

    def usable_j(self) -> float:
        """Lower 95 % bound of the energy before the cut-off; 0 while the battery is unknown."""

    def outcome(self, work: Work, cost_j: float) -> None:
        """Report what work that went as planned has cost; it adjusts later estimates of ways."""

    def power_w(self) -> float:
        """Power drawn, averaged over some seconds; the manifest's standing power before the first measurement."""
