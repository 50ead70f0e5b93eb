"""The sequential single-item auction with cheapest insertion, and the greedy baseline.

Source: Koenig, Tovey, Lagoudakis and others, The Power of Sequential Single-Item Auctions for Agent Coordination, AAAI
2006. Each round assigns one job to the lowest bid of all robots for all jobs. A bid is the cost of the cheapest
insertion into the robot's route (MiniSum), or the time at which the robot would be back (MiniMax). Three rules for the
winner of a round are tried and the best plan is kept.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.allocation.coupling import place_coupled
from robrain.algorithms.allocation.explain import reasons
from robrain.algorithms.allocation.insertion import (
    BY_ENERGY,
    BY_FINISH,
    BY_LEAST_LEFT,
    RouteBatch,
    cheapest_insertion,
    cheapest_pair,
    empty_routes,
    insert,
    insertion_at,
    is_load,
    position_of,
    refresh,
    remove,
)
from robrain.algorithms.allocation.plan import Plan, Route, make_plan
from robrain.algorithms.allocation.problem import (
    LARGEST,
    Objective,
    Problem,
    ProblemArrays,
    TeamArrays,
    VisitArrays,
    Worker,
    make_arrays,
)
from robrain.algorithms.allocation.validate import SLACK, validate
from robrain.protocol.reasons import PlanReason


def keep(problem: Problem, plan: Plan, objective: Objective) -> Plan | None:
    """Apply an earlier plan's orders to this problem as far as they are feasible; None if none are."""
    orders_of = {route.worker: route.jobs for route in plan.routes}
    orders = [orders_of.get(worker.name, ()) for worker in problem.workers]
    return repaired(problem, orders, objective)


def repaired(problem: Problem, orders: Sequence[Sequence[str]], objective: Objective) -> Plan | None:
    """Return a plan with as much of these orders as passes `validate`; None if nothing does."""
    pinned = [[problem.jobs[index].id for index in jobs] for jobs in make_arrays(problem).pinned]
    kept = []
    for worker, order, first in zip(problem.workers, orders, pinned, strict=True):
        fit = [name for name in order if name in problem.job_index and _may(problem, worker, name)]
        kept.append([*first, *fit])
    for _ in range(len(problem.jobs) + 2):
        _drop_incomplete(problem, kept)
        plan = make_plan(problem, kept, objective)
        if plan is None:
            # The orders form a cycle: drop the jobs that wait for others.
            dropped = {job.id for job in problem.jobs if problem.predecessors(job) or job.robots > 1}
        else:
            dropped = {
                name
                for worker, route in zip(problem.workers, plan.routes, strict=True)
                if (name := _misfit(problem, worker, route))
            }
        dropped -= {name for names in pinned for name in names}
        if not dropped:
            break
        kept = [[name for name in order if name not in dropped] for order in kept]
    return plan if plan is not None and not validate(problem, plan) else None


def _may(problem: Problem, worker: Worker, name: str) -> bool:
    job = problem.jobs[problem.job_index[name]]
    return not job.pinned_to and job.admits(worker)


def _drop_incomplete(problem: Problem, orders: list[list[str]]) -> None:
    """Remove jobs with too few robots, a predecessor that no robot does, or half a pair; in place."""
    while True:
        count: dict[str, int] = {}
        for order in orders:
            for name in order:
                count[name] = count.get(name, 0) + 1
        bad = {
            name
            for name, robots in count.items()
            if robots != (job := problem.jobs[problem.job_index[name]]).robots
            or any(other not in count for other in problem.predecessors(job))
        }
        for pickup, delivery in problem.deliveries.items():
            pair = problem.jobs[pickup].id, problem.jobs[delivery].id
            if not any(set(pair) <= set(order) and order.index(pair[0]) < order.index(pair[1]) for order in orders):
                bad |= set(pair) & set(count)
        if not bad:
            return
        orders[:] = [[name for name in order if name not in bad] for order in orders]


def _misfit(problem: Problem, worker: Worker, route: Route) -> str:
    """Return a job of the route to leave out; empty if the route is feasible.

    This is the first job that is too late or brings a load that the robot cannot carry. If energy or horizon do not
    suffice, it is the job that saves most per prize.
    """
    load_kg = worker.load_kg
    for stop in route.stops:
        job = problem.jobs[problem.job_index[stop.job]]
        load_kg += job.load_kg
        if stop.end_s > job.latest_s + SLACK or not -SLACK <= load_kg <= worker.capacity_kg + SLACK:
            return stop.job
    if not route.stops or (route.left_j >= -SLACK and route.end_s <= problem.horizon_s + SLACK):
        return ""
    energy_j = problem.energy_j[worker.profile]
    jobs = [problem.jobs[problem.job_index[stop.job]] for stop in route.stops]
    best, best_ratio = route.stops[-1].job, -np.inf
    before = worker.start
    for job, after in zip(jobs, [*(job.place for job in jobs[1:]), route.end_place], strict=True):
        legs_j = float(energy_j[before, job.place] + energy_j[job.exit_place, after])  # infinite if there is no path
        saved_j = legs_j if np.isinf(legs_j) else legs_j - float(energy_j[before, after])
        before = job.exit_place
        ratio = (saved_j + job.service_j) / max(job.prize_j, 1e-9)
        if not job.pinned_to and ratio > best_ratio:
            best, best_ratio = job.id, ratio
    return best


FEW_PAIRS = 2000
"""Up to this many robots × jobs all three auctions are held; beyond, only one, to keep the first plan fast."""
PRICELESS = 1e12
"""Prizes, or joules, scaled by this outweigh any path."""
LEAST_BID, GREATEST_GAIN, LEAST_PER_PRIZE = 0, 1, 2
"""Which bid wins a round: the least; the one with the greatest prize minus bid; the least bid per prize."""

ROUNDS = {
    Objective.ENERGY: ((BY_ENERGY, LEAST_PER_PRIZE), (BY_ENERGY, LEAST_BID), (BY_ENERGY, GREATEST_GAIN)),
    Objective.MAKESPAN: ((BY_FINISH, LEAST_BID), (BY_ENERGY, LEAST_BID), (BY_ENERGY, LEAST_PER_PRIZE)),
    Objective.LIFETIME: ((BY_LEAST_LEFT, LEAST_BID), (BY_ENERGY, LEAST_BID), (BY_ENERGY, LEAST_PER_PRIZE)),
}
"""The bid and the winning rule of the three auctions for each objective; the first matches the objective itself."""


class AuctionAllocator:
    """Plans by auction, without search: deadline, iterations and seed have no effect."""

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
        """See `Allocator`. Returns the warm start if it is feasible and better."""
        pairs = len(problem.jobs) * len(problem.workers)
        tries = ROUNDS[self.objective][: 3 if pairs <= FEW_PAIRS else 1]
        plans = [self.hold(problem, rule, choice) for rule, choice in tries]
        best, reason = min(plans, key=lambda plan: plan[0].rank)
        kept = None if warm_start is None else keep(problem, warm_start, self.objective)
        if kept is not None and kept.rank < best.rank:
            best, reason = kept, {}
        return reasons(problem, make_arrays(problem), best, reason)

    def hold(
        self, problem: Problem, rule: int, choice: int, rng: np.random.Generator | None = None
    ) -> tuple[Plan, dict[str, PlanReason | None]]:
        """Hold one auction: a plan without reasons, and the known reasons. `rng` only affects coupled jobs."""
        arrays = make_arrays(problem)
        # Bids do not know charges within routes. `repaired` then removes the jobs that no charges make feasible.
        is_charging = arrays.team.charge_w > 0
        arrays.team.usable_j[is_charging] = LARGEST
        routes = empty_routes(arrays.team, arrays.visits)
        open_visits = np.ones(len(arrays.visits.job), np.bool_)
        reason = place_coupled(problem, arrays, routes, open_visits, rule, rng) if problem.coupled else {}
        team, visits = arrays.team, arrays.visits
        prize_j = visits.prize_j
        # First, prizes only rank jobs: the first job in an area is seldom worth the drive by itself.
        priceless = prize_j * PRICELESS if choice == LEAST_PER_PRIZE else prize_j + PRICELESS
        hold_auction(team, visits._replace(prize_j=priceless), routes, open_visits, rule, choice)
        if self.objective is Objective.ENERGY:
            coupled = _indispensable(problem)
            kept = np.array([int(job) in coupled for job in visits.job], np.bool_)
            pickups = visits.delivery >= 0
            kept[pickups] |= kept[visits.delivery[pickups]]
            drop_unprofitable(team, visits, routes, open_visits, kept)
            hold_auction(team, visits, routes, open_visits, rule, choice)
            drop_unprofitable(team, visits, routes, open_visits, kept)
        plan = plan_of(problem, arrays, routes, self.objective)
        if is_charging.any():
            plan = repaired(problem, plan.orders, self.objective) or plan_of(
                problem, arrays, empty_routes(team, visits), self.objective
            )
        return plan, _by_id(problem, reason)


class GreedyAllocator:
    """The baseline: the robot that is free first takes the nearest job, without planning further ahead."""

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
        """See `Allocator`; ignores the warm start."""
        arrays = make_arrays(problem)
        routes = empty_routes(arrays.team, arrays.visits)
        open_visits = np.ones(len(arrays.visits.job), np.bool_)
        rule = BY_ENERGY if self.objective is Objective.ENERGY else BY_FINISH
        reason = place_coupled(problem, arrays, routes, open_visits, rule) if problem.coupled else {}
        queue_nearest(arrays.team, arrays.visits, routes, open_visits, rule)
        plan = plan_of(problem, arrays, routes, self.objective)
        return reasons(problem, make_arrays(problem), plan, _by_id(problem, reason))


def plan_of(problem: Problem, arrays: ProblemArrays, routes: RouteBatch, objective: Objective) -> Plan:
    """The plan with these routes."""
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


def _by_id(problem: Problem, reason_text: Mapping[int, PlanReason | None]) -> dict[str, PlanReason | None]:
    return {problem.jobs[index].id: reason for index, reason in reason_text.items()}


def _indispensable(problem: Problem) -> set[int]:
    """Jobs that other jobs wait for, or that need several robots: never dropped for their own cost."""
    return {index for index, others in problem.coupled.items() if others or problem.jobs[index].robots > 1}


@njit(cache=True, nogil=True)
def hold_auction(
    team: TeamArrays, visits: VisitArrays, routes: RouteBatch, open_visits: NDArray[np.bool_], rule: int, choice: int
) -> None:
    """Assign one visit per round until no bid remains; changes `routes` and `open_visits` in place.

    Each worker bids the cost of its cheapest insertion for each open visit, and one bid wins. A pickup stands for its
    delivery too. Only the winner's bids change afterwards. Under the energy rule no visit costs more than
    its prize, delays aside.
    """
    workers, count = visits.allowed.shape
    bids = np.full((workers, count), math.inf)
    more_j = np.full((workers, count), math.inf)
    positions = np.full((workers, count), -1)
    later = np.full((workers, count), -1)
    best = np.full(count, -1)
    for visit in range(count):
        open_visits[visit] = open_visits[visit] and visits.pickup[visit] < 0
        if open_visits[visit]:
            for worker in range(workers):
                if visits.delivery[visit] >= 0:
                    pair = cheapest_pair(team, visits, routes, worker, visit, rule, 0)
                    bids[worker, visit], more_j[worker, visit], positions[worker, visit], later[worker, visit] = pair
                else:
                    found = cheapest_insertion(team, visits, routes, worker, visit, rule)
                    bids[worker, visit], more_j[worker, visit], positions[worker, visit] = found
            best[visit] = _best_worker(bids, more_j, visit)
    while True:
        winner = -1
        least = math.inf
        for visit in range(count):
            if not open_visits[visit] or best[visit] < 0:
                continue
            value = bids[best[visit], visit]
            if rule == BY_ENERGY and not more_j[best[visit], visit] < visits.prize_j[visit]:
                continue
            if choice == GREATEST_GAIN:
                value -= visits.prize_j[visit]
            elif choice == LEAST_PER_PRIZE:
                value /= max(visits.prize_j[visit], 1e-9)
            if value < least:
                winner, least = visit, value
        if winner < 0:
            return
        taker = best[winner]
        inserted_at = positions[taker, winner]
        insert(team, visits, routes, taker, winner, inserted_at)
        if visits.delivery[winner] >= 0:
            insert(team, visits, routes, taker, visits.delivery[winner], later[taker, winner])
        open_visits[winner] = False
        for visit in range(count):
            if not open_visits[visit]:
                continue
            if positions[taker, visit] >= 0 and visits.delivery[visit] >= 0:
                pair = cheapest_pair(team, visits, routes, taker, visit, rule, 0)
                bids[taker, visit], more_j[taker, visit], positions[taker, visit], later[taker, visit] = pair
            elif positions[taker, visit] >= 0 and visits.delivery[winner] >= 0:
                found = cheapest_insertion(team, visits, routes, taker, visit, rule)
                bids[taker, visit], more_j[taker, visit], positions[taker, visit] = found
            elif positions[taker, visit] >= 0:
                found = _bid_again(team, visits, routes, taker, visit, rule, positions[taker, visit], inserted_at)
                bids[taker, visit], more_j[taker, visit], positions[taker, visit] = found
            other = best[visit]
            if other == taker:
                best[visit] = _best_worker(bids, more_j, visit)
            elif _is_less(bids, more_j, visit, taker, other):
                best[visit] = taker


@njit(cache=True, nogil=True)
def _bid_again(
    team: TeamArrays,
    visits: VisitArrays,
    routes: RouteBatch,
    worker: int,
    visit: int,
    rule: int,
    old_position: int,
    inserted_at: int,
) -> tuple[float, float, int]:
    """The cheapest insertion after a visit was inserted at `inserted_at`.

    Two path segments are new and one is gone. Only the old best position and the two new positions are evaluated. The
    exception is an old best position that was on the removed segment or is now too late. This is exact where detours
    are never shorter and waiting is free.
    """
    if old_position == inserted_at or team.wait_w[worker] > 0 or routes.wait_s[worker] > 0:
        return cheapest_insertion(team, visits, routes, worker, visit, rule)
    position = old_position if old_position < inserted_at else old_position + 1
    bid, more_j = insertion_at(team, visits, routes, worker, visit, position, rule)
    if more_j == math.inf:
        return cheapest_insertion(team, visits, routes, worker, visit, rule)
    for other in (inserted_at, inserted_at + 1):
        other_bid, other_more_j = insertion_at(team, visits, routes, worker, visit, other, rule)
        if other_bid < bid or (other_bid == bid and other_bid < math.inf and other_more_j < more_j):
            bid, more_j, position = other_bid, other_more_j, other
    return (bid, more_j, position) if bid < math.inf else (math.inf, math.inf, -1)


@njit(cache=True, nogil=True)
def drop_unprofitable(
    team: TeamArrays, visits: VisitArrays, routes: RouteBatch, open_visits: NDArray[np.bool_], kept: NDArray[np.bool_]
) -> None:
    """Remove visits, and whole routes, that cost more than their prize.

    Changes `routes` and `open_visits` in place; visits marked in `kept`, (V,), stay. A delivery goes with its pickup.
    """
    for worker in range(len(routes.length)):
        while True:
            before_j = routes.spent_j[worker]
            worst, worst_j = -1, 1e-9
            for position in range(routes.length[worker]):
                visit = routes.order[worker, position]
                if kept[visit] or visits.pickup[visit] >= 0:
                    continue
                later = _remove_with_delivery(team, visits, routes, worker, position)
                saved_j = before_j - routes.spent_j[worker] - visits.prize_j[visit]
                for index in range(routes.length[worker] + 1):
                    if not is_load(team, worker, routes.load_kg[worker, index]):
                        saved_j = 0.0  # a delivery before made room for what follows
                if later >= 0:
                    insert(team, visits, routes, worker, visits.delivery[visit], later)
                insert(team, visits, routes, worker, visit, position)
                if saved_j > worst_j:
                    worst, worst_j = position, saved_j
            if worst < 0:
                break
            open_visits[routes.order[worker, worst]] = True
            _remove_with_delivery(team, visits, routes, worker, worst)
        prize_j = 0.0
        for position in range(routes.length[worker]):
            visit = routes.order[worker, position]
            prize_j += math.inf if kept[visit] else visits.prize_j[visit]
        if prize_j < routes.spent_j[worker]:
            for position in range(routes.length[worker]):
                open_visits[routes.order[worker, position]] = True
            routes.length[worker] = 0
            refresh(team, visits, routes, worker)


@njit(cache=True, nogil=True)
def _remove_with_delivery(team: TeamArrays, visits: VisitArrays, routes: RouteBatch, worker: int, position: int) -> int:
    """Remove a visit and its delivery; returns the position that the delivery had without the visit, −1 for none."""
    delivery = visits.delivery[routes.order[worker, position]]
    remove(team, visits, routes, worker, position)
    later = position_of(routes, worker, delivery) if delivery >= 0 else -1
    if later >= 0:
        remove(team, visits, routes, worker, later)
    return later


@njit(cache=True, nogil=True)
def _best_worker(bids: NDArray[np.float64], more_j: NDArray[np.float64], visit: int) -> int:
    best = -1
    for worker in range(bids.shape[0]):
        if _is_less(bids, more_j, visit, worker, best):
            best = worker
    return best


@njit(cache=True, nogil=True)
def _is_less(bids: NDArray[np.float64], more_j: NDArray[np.float64], visit: int, one: int, other: int) -> bool:
    if not bids[one, visit] < math.inf:
        return False
    if other < 0 or bids[one, visit] < bids[other, visit]:
        return True
    return bool(bids[one, visit] == bids[other, visit] and more_j[one, visit] < more_j[other, visit])


@njit(cache=True, nogil=True)
def queue_nearest(
    team: TeamArrays, visits: VisitArrays, routes: RouteBatch, open_visits: NDArray[np.bool_], rule: int
) -> None:
    """The greedy baseline: the worker that is free first takes the open visit that it reaches with least energy.

    The visit is appended to the route; a worker without a feasible visit drops out. Changes `routes` and `open_visits`
    in place. A delivery follows its pickup at once.
    """
    workers, count = visits.allowed.shape
    is_in = np.ones(workers, np.bool_)
    while True:
        taker = -1
        for worker in range(workers):
            free_s = routes.leave_s[worker, routes.length[worker]]
            if is_in[worker] and (taker < 0 or free_s < routes.leave_s[taker, routes.length[taker]]):
                taker = worker
        if taker < 0:
            return
        winner, least_j = -1, math.inf
        length = routes.length[taker]
        profile = team.profile[taker]
        place = team.start[taker] if length == 0 else visits.exit_place[routes.order[taker, length - 1]]
        for visit in range(count):
            if not open_visits[visit] or not visits.allowed[taker, visit] or visits.pickup[visit] >= 0:
                continue
            here, leaves_from = visits.place[visit], visits.exit_place[visit]
            path_j = team.energy_j[profile, place, here] + visits.service_j[visit]
            if not path_j < least_j or (rule == BY_ENERGY and not path_j < visits.prize_j[visit]):
                continue
            if visits.delivery[visit] >= 0:
                if cheapest_pair(team, visits, routes, taker, visit, BY_ENERGY, length)[0] < math.inf:
                    winner, least_j = visit, path_j
                continue
            if not is_load(team, taker, routes.load_kg[taker, length] + visits.load_kg[visit]):
                continue
            arrive_s = routes.leave_s[taker, length] + team.time_s[profile, place, here]
            start_s = max(arrive_s, visits.earliest_s[visit])
            end_s = start_s + visits.service_s[visit]
            if not (start_s <= visits.latest_s[visit] and end_s + team.end_s[taker, leaves_from] <= team.horizon_s):
                continue
            wait_s = routes.wait_s[taker] + start_s - arrive_s
            spent_j = routes.spent_j[taker] - routes.wait_s[taker] * team.wait_w[taker]
            if length > 0:
                spent_j -= team.end_j[taker, place]
            if (
                not spent_j + path_j + team.end_j[taker, leaves_from] + wait_s * team.wait_w[taker]
                <= team.usable_j[taker]
            ):
                continue
            winner, least_j = visit, path_j
        if winner < 0:
            is_in[taker] = False
            continue
        insert(team, visits, routes, taker, winner, length)
        if visits.delivery[winner] >= 0:
            insert(team, visits, routes, taker, visits.delivery[winner], length + 1)
        open_visits[winner] = False
