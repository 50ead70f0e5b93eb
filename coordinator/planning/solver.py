"""How a plan is made of a question: an auction, some searches, and no change of hands for next to nothing.

Equal questions, seeds, rounds and iterations make equal plans, in both drives: in live the clock decides how many
rounds there are, and that number is written down with the plan.
"""

import logging
from collections.abc import Iterator, Mapping, Sequence

from robrain.coordinator.allocation.arrays import make_arrays
from robrain.coordinator.allocation.checked_allocator import BadPlan, allocator_of
from robrain.coordinator.allocation.plan import Plan, Route, Stop
from robrain.coordinator.allocation.problem import Problem
from robrain.coordinator.allocation.refusal import reasons
from robrain.coordinator.allocation.repair import keep
from robrain.coordinator.allocation.searched_auction import Searching
from robrain.coordinator.planning.charging_patience import for_the_ready, with_those_who_charge
from robrain.coordinator.planning.early_start import without_idling
from robrain.protocol.model.tasks.objective import Objective

logger = logging.getLogger(__name__)

FRUITLESS = 2
"""After so many rounds one after another that found nothing better there is little to be expected."""


class Thinking:
    """Makes one plan, round by round.

    Args:
        problem: what is asked.
        objective: what the plan is to be good at.
        method: name of its allocator.
        seed: of what is random in it.
        iterations: of each search.
        gain_min: tasks change hands only for a plan that is better by this share.
        orders: robots and their tasks, as they are planned so far.

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
    ) -> None:
        self.rounds = 0
        """Searches so far."""
        first = allocator_of(method, objective)
        self.problem = problem
        """What was asked; once there is a plan, with what those who charge are not to do."""
        self._asked = problem
        self._allocator = first
        self._problem = problem = for_the_ready(problem)
        self._iterations = iterations
        self._gain_min = gain_min
        self._seed = seed
        self._orders = orders
        self._before = _warm(orders, objective) if orders else None
        self._best = first.plan(problem, warm_start=self._before, iterations=1)
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
                return
            self.rounds += 1
            fruitless = 0 if found.rank < self._best.rank else fruitless + 1
            self._best = min(self._best, found, key=lambda plan: plan.rank)

    @property
    def plan(self) -> Plan:
        """The best so far; the one before, as far as it can be kept, unless the best is worth the change."""
        chosen = self._chosen()
        self.problem, plan = with_those_who_charge(self._asked, chosen, self._orders, self._allocator)
        return without_idling(self.problem, plan)

    def _chosen(self) -> Plan:
        best = self._best
        kept = keep(self._problem, self._before, best.objective)
        if kept is None or not self._changes_hands(best):
            return best
        if {one.job for one in kept.unassigned} != {one.job for one in best.unassigned}:
            return best
        if _gain(kept, best) >= self._gain_min:
            return best
        return reasons(
            self._problem, make_arrays(self._problem), kept, {one.job: one.reason for one in best.unassigned}
        )

    def _changes_hands(self, plan: Plan) -> bool:
        was = {task: robot for robot, tasks in self._orders.items() for task in tasks}
        return any(was.get(job, route.worker) != route.worker for route in plan.routes for job in route.jobs)


def think(
    problem: Problem,
    objective: Objective,
    method: str,
    *,
    seed: int,
    rounds: int,
    iterations: int,
    gain_min: float,
    orders: Mapping[str, Sequence[str]],
) -> tuple[Plan, int]:
    """The plan after at most so many rounds, and how many there were."""
    thinking = Thinking(
        problem, objective, method, seed=seed, iterations=iterations, gain_min=gain_min, orders=orders
    )  # fmt: skip
    for _ in thinking.improve():
        if thinking.rounds >= rounds:
            break
    return thinking.plan, thinking.rounds


def _is_worth_it(problem: Problem) -> bool:
    """Whether a search may find what the auction does not: with one task that is free, it cannot."""
    return sum(not job.pinned_to for job in problem.jobs) > 1


def _gain(kept: Plan, best: Plan) -> float:
    """By which share the best plan is better than the kept one."""
    match best.objective:
        case Objective.ENERGY:
            return _share(kept.cost_j - best.cost_j, kept.cost_j)
        case Objective.MAKESPAN:
            return _share(kept.makespan_s - best.makespan_s, kept.makespan_s)
        case Objective.LIFETIME:
            return _share(best.least_left_j - kept.least_left_j, kept.least_left_j)


def _share(gain: float, of: float) -> float:
    return gain / of if of > 0 else float(gain > 0)


def _warm(orders: Mapping[str, Sequence[str]], objective: Objective) -> Plan:
    """A plan of which the orders count only."""
    routes = tuple(
        Route(robot, tuple(Stop(task, 0.0, 0.0, 0.0, 0.0) for task in tasks), 0, 0.0, 0.0, 0.0)
        for robot, tasks in orders.items()
    )
    return Plan(
        objective=objective, routes=routes, cost_j=0.0, lost_prize_j=0.0, makespan_s=0.0, least_left_j=0.0
    )  # fmt: skip
