"""Solves an allocation problem: the allocator's first plan, searches that improve it, then the refinement passes.

Equal problems, seeds, rounds and iterations make equal plans, in both drives: in live the clock decides how many
rounds there are, and that number is written down with the plan.
"""

import logging
from collections.abc import Iterator, Mapping, Sequence

from robrain.coordinator.allocation.allocator import Searching
from robrain.coordinator.allocation.checked_allocator import BadPlan, allocator_of
from robrain.coordinator.allocation.plan import Plan
from robrain.coordinator.allocation.problem import Problem
from robrain.coordinator.planning.plan_passes import CHARGING_ROBOTS, STOCK_PASSES, PlanDraft, PlanFailure, refined
from robrain.coordinator.planning.stock_passes import for_the_ready, plan_of
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.objective import Objective

logger = logging.getLogger(__name__)

FRUITLESS = 2
"""After so many rounds one after another that found nothing better there is little to be expected."""


class PlanSolver:
    """Makes one plan, round by round.

    Args:
        problem: what is asked.
        objective: what the plan is to be good at.
        method: name of its allocator.
        seed: of what is random in it.
        iterations: of each search.
        gain_min: a task moves to another robot only if the plan becomes better by at least this share.
        orders: robots and their tasks in order, by the plan before.
        passes: names of the refinement passes, in their order.

    """

    def __init__(
        self,
        problem: Problem,
        objective: Objective,
        method: str,
        *,
        seed: int,
        iterations: int,
        gain_min: float,
        orders: Mapping[str, Sequence[str]],
        passes: Sequence[str] = STOCK_PASSES,
    ) -> None:
        self.rounds = 0
        """Searches so far."""
        self.failures: tuple[PlanFailure, ...] = ()
        """What failed of other distributions' code when `plan` was last read."""
        self._failures: tuple[PlanFailure, ...] = ()
        first = allocator_of(method, objective)
        self.problem = problem
        """What was asked; once there is a plan, the problem that it solves."""
        self._asked = problem
        self._method = method
        self._allocator = first
        self._problem = problem = for_the_ready(problem) if CHARGING_ROBOTS in passes else problem
        self._iterations = iterations
        self._gain_min = gain_min
        self._seed = seed
        self._orders = orders
        self._passes = passes
        self._best = first.plan(problem, warm_start=plan_of(orders, objective), iterations=1)
        self._search = first.search() if isinstance(first, Searching) and _is_worth_it(problem) else None

    def improve(self) -> Iterator[None]:
        """Yields before each search, for as long as something may come of one."""
        fruitless = 0
        while self._search is not None and fruitless < FRUITLESS:
            yield
            try:
                found = self._search.plan(
                    self._problem, iterations=self._iterations, seed=self._seed + self.rounds, warm_start=self._best
                )
            except BadPlan as error:  # the plan that it was to improve is sound
                logger.warning("the plan is not searched any further: %s", error)
                self._failures += (PlanFailure("allocator", self._method, cut(str(error))),)
                return
            self.rounds += 1
            fruitless = 0 if found.rank < self._best.rank else fruitless + 1
            self._best = min(self._best, found, key=lambda plan: plan.rank)

    @property
    def plan(self) -> Plan:
        """The best plan so far, refined."""
        draft = PlanDraft(
            asked=self._asked,
            problem=self._problem,
            plan=self._best,
            orders=self._orders,
            gain_min=self._gain_min,
            allocator=self._allocator,
            failures=self._failures,
        )
        draft = refined(draft, self._passes)
        self.problem, self.failures = draft.problem, draft.failures
        return draft.plan


def solve(
    problem: Problem,
    objective: Objective,
    method: str,
    *,
    seed: int,
    rounds: int,
    iterations: int,
    gain_min: float,
    orders: Mapping[str, Sequence[str]],
    passes: Sequence[str] = STOCK_PASSES,
) -> tuple[Plan, int]:
    """The plan after at most so many rounds, and how many there were."""
    solver = PlanSolver(
        problem, objective, method, seed=seed, iterations=iterations, gain_min=gain_min, orders=orders, passes=passes
    )
    for _ in solver.improve():
        if solver.rounds >= rounds:
            break
    return solver.plan, solver.rounds


def _is_worth_it(problem: Problem) -> bool:
    """Whether a search may find what the auction does not: with one task that is free, it cannot."""
    return sum(not job.pinned_to for job in problem.jobs) > 1
