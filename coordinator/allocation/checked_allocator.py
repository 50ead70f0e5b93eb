"""Allocators by name. Every plan of an allocator from another distribution is checked."""

from collections.abc import Sequence

from robrain.coordinator.allocation.allocator import ALLOCATORS, Allocator, Searching
from robrain.coordinator.allocation.explain import reasons
from robrain.coordinator.allocation.plan import Plan
from robrain.coordinator.allocation.problem import Objective, Problem, make_arrays
from robrain.coordinator.allocation.validate import validate


class BadPlan(ValueError):
    """A plan of another distribution's allocator failed `validate`."""

    def __init__(self, method: str, faults: Sequence[str]) -> None:
        super().__init__(f"the plan of {method} cannot be carried out: {'; '.join(faults)}")
        self.method = method
        self.faults = tuple(faults)


class CheckedAllocator:
    """Wraps an allocator: validates each of its plans, and those of its search.

    Jobs that the allocator leaves out without a reason get one.

    Args:
        method: its name, for the error message.
        allocator: makes the plans.

    """

    def __init__(self, method: str, allocator: Allocator) -> None:
        self._method = method
        self._allocator = allocator

    @property
    def objective(self) -> Objective:
        """See `Allocator`."""
        return self._allocator.objective

    def plan(
        self,
        problem: Problem,
        *,
        deadline_s: float | None = None,
        iterations: int | None = None,
        seed: int = 0,
        warm_start: Plan | None = None,
    ) -> Plan:
        """See `Allocator`; raises BadPlan if the plan fails `validate`."""
        plan = self._allocator.plan(
            problem, deadline_s=deadline_s, iterations=iterations, seed=seed, warm_start=warm_start
        )
        if faults := validate(problem, plan):
            raise BadPlan(self._method, faults)
        if all(one.reason is not None for one in plan.unassigned):
            return plan
        return reasons(
            problem, make_arrays(problem), plan, {one.job: one.reason for one in plan.unassigned if one.reason}
        )

    def search(self) -> Allocator | None:
        """See `Searching`; None if the allocator has no search."""
        found = self._allocator.search() if isinstance(self._allocator, Searching) else None
        return None if found is None else CheckedAllocator(self._method, found)


def allocator_of(method: str, objective: Objective) -> Allocator:
    """Return the named allocator, checked if another distribution provides it (UnknownEntry if there is none)."""
    allocator = ALLOCATORS.get(method)(objective)
    return allocator if ALLOCATORS.is_stock(method) else CheckedAllocator(method, allocator)
