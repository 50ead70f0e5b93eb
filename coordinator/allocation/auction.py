"""The sequential single-item auction with cheapest insertion, and the greedy baseline.

Koenig, Tovey, Lagoudakis and others, The Power of Sequential Single-Item Auctions for Agent Coordination, AAAI 2006:
one job is handed out a round, to the lowest bid of all robots for all jobs, a bid being what the cheapest insertion
into the robot's route costs (MiniSum), or when the robot would be back (MiniMax). Three ways to choose the winner of a
round are tried and the best plan is kept; an auction is quick enough for that.
"""

from collections.abc import Mapping

import numpy as np

from robrain.coordinator.allocation.arrays import ProblemArrays, make_arrays
from robrain.coordinator.allocation.bidding import (
    GREATEST_GAIN,
    LEAST_BID,
    LEAST_PER_PRIZE,
    drop_unprofitable,
    hold_auction,
    queue_nearest,
)
from robrain.coordinator.allocation.coupling import coupled_jobs, place_coupled
from robrain.coordinator.allocation.insertion import BY_ENERGY, BY_FINISH, BY_LEAST_LEFT, Routes, empty_routes
from robrain.coordinator.allocation.plan import Plan
from robrain.coordinator.allocation.problem import Objective, Problem
from robrain.coordinator.allocation.refusal import reasons
from robrain.coordinator.allocation.repair import keep
from robrain.coordinator.allocation.schedule import make_plan
from robrain.protocol.wire.reasons.plans import LeftOut

FEW_PAIRS = 2000
"""Up to so many robots × jobs all three auctions are held; beyond, one, so that the first plan is there at once."""
PRICELESS = 1e12
"""Prizes so much greater, or so many joules more, outweigh every way."""


ROUNDS = {
    Objective.ENERGY: ((BY_ENERGY, LEAST_PER_PRIZE), (BY_ENERGY, LEAST_BID), (BY_ENERGY, GREATEST_GAIN)),
    Objective.MAKESPAN: ((BY_FINISH, LEAST_BID), (BY_ENERGY, LEAST_BID), (BY_ENERGY, LEAST_PER_PRIZE)),
    Objective.LIFETIME: ((BY_LEAST_LEFT, LEAST_BID), (BY_ENERGY, LEAST_BID), (BY_ENERGY, LEAST_PER_PRIZE)),
}
"""What is bid, and which bid wins: three auctions for each objective, the first of which is its own."""


class AuctionAllocator:
    """Plans by auction. There is no search in it: deadline, iterations and seed change nothing."""

    def __init__(self, objective: Objective = Objective.ENERGY) -> None:
        self.objective = objective

    def plan(
        self,
        problem: Problem,
        *,
        deadline_s: float | None = None,
        iterations: int | None = None,
        seed: int = 0,
        warm_start: Plan | None = None,
    ) -> Plan:
        """See `Allocator`. A warm start that can be kept and is better comes back."""
        pairs = len(problem.jobs) * len(problem.workers)
        tries = ROUNDS[self.objective][: 3 if pairs <= FEW_PAIRS else 1]
        plans = [self.hold(problem, rule, choice) for rule, choice in tries]
        best, why = min(plans, key=lambda plan: plan[0].rank)
        kept = keep(problem, warm_start, self.objective)
        if kept is not None and kept.rank < best.rank:
            best, why = kept, {}
        return reasons(problem, make_arrays(problem), best, why)

    def hold(
        self, problem: Problem, rule: int, choice: int, rng: np.random.Generator | None = None
    ) -> tuple[Plan, dict[str, LeftOut | None]]:
        """One auction: a plan without reasons, and the reasons that are known. Chance only touches coupled jobs."""
        arrays = make_arrays(problem)
        routes = empty_routes(arrays.team, arrays.visits)
        open_visits = np.ones(len(arrays.visits.job), np.bool_)
        why = place_coupled(problem, arrays, routes, open_visits, rule, rng) if coupled_jobs(problem) else {}
        team, visits = arrays.team, arrays.visits
        prize_j = visits.prize_j
        # A prize first counts only against other prizes: the first job in a place is seldom worth the way alone.
        priceless = prize_j * PRICELESS if choice == LEAST_PER_PRIZE else prize_j + PRICELESS
        hold_auction(team, visits._replace(prize_j=priceless), routes, open_visits, rule, choice)
        if self.objective is Objective.ENERGY:
            coupled = _indispensable(problem)
            kept = np.array([int(job) in coupled for job in visits.job], np.bool_)
            drop_unprofitable(team, visits, routes, open_visits, kept)
            hold_auction(team, visits, routes, open_visits, rule, choice)
            drop_unprofitable(team, visits, routes, open_visits, kept)
        return plan_of(problem, arrays, routes, self.objective), _by_id(problem, why)


class GreedyAllocator:
    """The baseline: whoever is free first takes the nearest job. It looks at nothing beyond the next job."""

    def __init__(self, objective: Objective = Objective.ENERGY) -> None:
        self.objective = objective

    def plan(
        self,
        problem: Problem,
        *,
        deadline_s: float | None = None,
        iterations: int | None = None,
        seed: int = 0,
        warm_start: Plan | None = None,
    ) -> Plan:
        """See `Allocator`; a warm start is not looked at."""
        arrays = make_arrays(problem)
        routes = empty_routes(arrays.team, arrays.visits)
        open_visits = np.ones(len(arrays.visits.job), np.bool_)
        rule = BY_ENERGY if self.objective is Objective.ENERGY else BY_FINISH
        why = place_coupled(problem, arrays, routes, open_visits, rule) if coupled_jobs(problem) else {}
        queue_nearest(arrays.team, arrays.visits, routes, open_visits, rule)
        plan = plan_of(problem, arrays, routes, self.objective)
        return reasons(problem, make_arrays(problem), plan, _by_id(problem, why))


def plan_of(problem: Problem, arrays: ProblemArrays, routes: Routes, objective: Objective) -> Plan:
    """The plan whose routes these are."""
    jobs = arrays.visits.job
    orders = [
        [problem.jobs[index].id for index in pinned]
        + [problem.jobs[jobs[visit]].id for visit in routes.order[worker, : routes.length[worker]]]
        for worker, pinned in enumerate(arrays.pinned)
    ]
    plan = make_plan(problem, orders, objective)
    if plan is None:
        raise RuntimeError("expected an auction to put jobs in an order that can be kept")
    return plan


def _by_id(problem: Problem, why: Mapping[int, LeftOut | None]) -> dict[str, LeftOut | None]:
    return {problem.jobs[index].id: reason for index, reason in why.items()}


def _indispensable(problem: Problem) -> set[int]:
    """Jobs that others wait for or that several robots are at: they are not dropped for what they alone cost."""
    return {index for index, others in coupled_jobs(problem).items() if others or problem.jobs[index].robots > 1}
