"""What makes plans of snapshots, as the coordinator sees it."""

from typing import Protocol

from robrain.coordinator.planning.plan_in_force import PlanInForce
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.snapshot import Snapshot


class Planner(Protocol):
    """Makes plans; the last request counts."""

    def prepare(self) -> None:
        """Get ready for the first request, if that takes a while; returns at once in live."""

    def ask(self, snapshot: Snapshot, policy: PlanningPolicy) -> None:
        """A plan is wanted; returns at once in live."""

    def take(self) -> list[PlanInForce]:
        """The plans that were made since, the best last."""
        ...

    @property
    def is_busy(self) -> bool:
        """Whether a plan that was asked for may still come."""
        ...

    @property
    def why_failed(self) -> str:
        """Why planning failed for the last request; empty if it has not failed (so far)."""
        ...

    def close(self) -> None:
        """End it."""
