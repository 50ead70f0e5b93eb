"""Allocators by name. Every plan of an allocator that is not robrain's own is checked."""

from robrain.algorithms.allocation.allocator import ALLOCATORS, OPTIMAL, Allocator, Searching
from robrain.algorithms.allocation.explain import reasons
from robrain.algorithms.allocation.plan import Plan
from robrain.algorithms.allocation.problem import Objective, Problem, make_arrays
from robrain.algorithms.allocation.validate import validate
from robrain.protocol.registry import failure_text


class CheckedAllocator:
    """Wraps an allocator that is not robrain's own, and validates each of its plans.

    A failure is one of `failures`: it raises, or its plan is infeasible. Then the stock allocator makes the plan; of a
    search, the warm start is the plan. Unassigned jobs without a reason get one.

    Args:
        objective: the objective of its plans.
        allocator: makes the plans; None if it could not be made, which is a failure.
        failures: to which failures are added, in words, each with the line of its file.
        is_search: whether it only improves the plans of another allocator.

    """

    def __init__(
        self, objective: Objective, allocator: Allocator | None, failures: list[str], *, is_search: bool = False
    ) -> None:
        self.objective = objective
        self.failures = failures
        self._allocator = allocator
        self._is_search = is_search
        self._stock: Allocator = ALLOCATORS.get(OPTIMAL)(objective)

    def plan(
        self,
        problem: Problem,
        *,
        deadline_s: float | None = None,
        iterations: int | None = None,
        seed: int = 0,
        warm_start: Plan | None = None,
    ) -> Plan:
        """See `Allocator`."""
        if self._allocator is not None:
            try:
                plan: object = self._allocator.plan(
                    problem, deadline_s=deadline_s, iterations=iterations, seed=seed, warm_start=warm_start
                )
                return self._checked(problem, plan)
            except Exception as error:  # noqa: BLE001 - foreign code
                part = getattr(self._allocator, "plan", self._allocator)
                self.failures.append(failure_text(part, error))
        if self._is_search and warm_start is not None:
            return warm_start
        return self._stock.plan(problem, deadline_s=deadline_s, iterations=iterations, seed=seed, warm_start=warm_start)

    def search(self) -> Allocator | None:
        """See `Searching`; None if the allocator has no search."""
        allocator: object = self._stock if self.failures else self._allocator
        if not isinstance(allocator, Searching):
            return None
        try:
            found = allocator.search()
        except Exception as error:  # noqa: BLE001 - foreign code
            self.failures.append(failure_text(allocator.search, error))
            return None
        return None if found is None else CheckedAllocator(self.objective, found, self.failures, is_search=True)

    def _checked(self, problem: Problem, plan: object) -> Plan:
        if not isinstance(plan, Plan):
            raise TypeError(f"expected a Plan, got {type(plan).__name__}")
        if plan.objective is not self.objective:
            raise ValueError(f"expected a plan for {self.objective}, got one for {plan.objective}")
        if faults := validate(problem, plan):
            raise ValueError(f"the plan cannot be carried out: {'; '.join(faults)}")
        if all(one.reason is not None for one in plan.unassigned):
            return plan
        known = {one.job: one.reason for one in plan.unassigned if one.reason}
        return reasons(problem, make_arrays(problem), plan, known)


def allocator_of(method: str, objective: Objective) -> Allocator:
    """Return the named allocator, checked if it is not robrain's own."""
    if ALLOCATORS.is_stock(method):
        return ALLOCATORS.get(method)(objective)
    made_by: object = None
    try:
        made_by = made = ALLOCATORS.get(method)
        return CheckedAllocator(objective, made(objective), [])
    except Exception as error:  # noqa: BLE001 - foreign code
        return CheckedAllocator(objective, None, [failure_text(made_by, error)])
