"""What makes plans of situations, as the coordinator sees it."""

from typing import Protocol

from robrain.coordinator.planning.plan_in_force import Planned
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.snapshot import Situation


class Planner(Protocol):
    """Makes plans; the last question counts."""

    def prepare(self) -> None:
        """Get ready for the first question, if that takes a while; returns at once in live."""

    def ask(self, situation: Situation, policy: PlanningPolicy) -> None:
        """A plan is wanted; returns at once in live."""

    def take(self) -> list[Planned]:
        """The plans that were made since, the best last."""
        ...

    @property
    def is_busy(self) -> bool:
        """Whether a plan that was asked for may still come."""
        ...

    @property
    def why_failed(self) -> str:
        """Why planning failed for the last question; empty if it has not failed (so far)."""
        ...

    def close(self) -> None:
        """End it."""
