"""The interface between the coordinator and what makes its plans."""

from typing import Protocol

from robrain.coordinator.planning.plan_in_force import PlanInForce
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.snapshot import Snapshot


class Planner(Protocol):
    """Makes plans from snapshots; the latest request counts."""

    def prepare(self) -> None:
        """Prepare for the first request; returns at once in live."""

    def ask(self, snapshot: Snapshot, policy: PlanningPolicy) -> None:
        """Request a plan; returns at once in live."""

    def take(self) -> list[PlanInForce]:
        """Return the plans made since the last call, the best last."""
        ...

    @property
    def is_busy(self) -> bool:
        """Whether a requested plan may still arrive."""
        ...

    @property
    def why_failed(self) -> str:
        """Why planning failed for the last request; empty if it has not failed."""
        ...

    def close(self) -> None:
        """Stop planning and free its resources."""
