"""Coupled jobs: precedence between jobs, and jobs for k robots at once.

Coupled jobs link routes, which neither the auction's bids nor PyVRP's model can express. They are handled separately:

- `place_coupled`: the auction places them first, in topological order, and fixes their times; all other jobs are then
  placed around them;
- `windows_of`: for the search, the times of a plan become time windows that keep the coupled jobs apart however visits
  are moved within the windows. Both are restrictions: they may exclude better plans.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.allocation.insertion import (
    BY_ENERGY,
    BY_FINISH,
    RouteBatch,
    cheapest_insertion,
    cheapest_pair,
    insert,
    refresh,
    remove,
)
from robrain.algorithms.allocation.plan import Plan
from robrain.algorithms.allocation.problem import Problem, ProblemArrays, VisitArrays
from robrain.protocol.reasons import PlanReason, after_undone, plain

NOISE = (0.6, 1.4)
"""Range of the random factor applied to bids (chosen)."""
HORIZON_SHARE = 1.25
"""Without a horizon, windows allow a plan to take this factor longer than necessary (chosen)."""


def place_coupled(
    problem: Problem,
    arrays: ProblemArrays,
    routes: RouteBatch,
    open_visits: NDArray[np.bool_],
    rule: int,
    rng: np.random.Generator | None = None,
) -> dict[int, PlanReason | None]:
    """Insert the coupled jobs into empty routes and narrow their windows; changes both in place.

    With a generator, the next job is drawn among those that can be placed, and bids are scaled by a random factor.

    Returns: For each unassigned coupled job, the reason, or None if no single robot can do it. All coupled jobs are
        closed.

    """
    waiting = problem.coupled
    visits_of: dict[int, list[int]] = {index: [] for index in waiting}
    for visit, job in enumerate(arrays.visits.job):
        if int(job) in visits_of:
            visits_of[int(job)].append(visit)
            open_visits[visit] = False
    ends_s = _pinned_ends(problem, arrays)
    reason: dict[int, PlanReason | None] = {}
    pairs = {pickup: delivery for pickup, delivery in problem.deliveries.items() if pickup in waiting}
    pickup_of = {delivery: pickup for pickup, delivery in pairs.items()}
    undecided = [index for index in waiting if visits_of[index] and index not in pickup_of]
    reason.update({index: arrays.refused[index] for index in waiting if index in arrays.refused})
    worth_j = _chain_worth(problem, waiting)
    while undecided:
        ready = [
            index
            for index in undecided
            if all(
                (other := problem.job_index[name]) in ends_s or other in reason or other == index
                for job in ((index, pairs[index]) if index in pairs else (index,))
                for name in problem.predecessors(problem.jobs[job])
            )
        ]
        if not ready:
            reason.update(dict.fromkeys(undecided, plain("waits_for_itself", "it waits for itself")))
            break
        index = ready[0] if rng is None else ready[int(rng.integers(len(ready)))]
        undecided.remove(index)
        jobs = (index, pairs[index]) if index in pairs else (index,)
        before = [[problem.job_index[name] for name in problem.predecessors(problem.jobs[job])] for job in jobs]
        missing = [other for others in before for other in others if other in reason]
        if missing:
            reason.update(dict.fromkeys(jobs, after_undone(problem.jobs[missing[0]].id)))
            continue
        visits = visits_of[index]
        for job, others in zip(jobs, before, strict=True):
            before_s = max((ends_s[other] for other in others if other != index), default=0)
            arrays.visits.earliest_s[visits_of[job]] = np.maximum(arrays.visits.earliest_s[visits_of[job]], before_s)
        if index in pairs:
            is_waited_for = [bool(waiting[job]) for job in jobs]
            pair = _place_pair(arrays, routes, visits[0], rule, sum(worth_j[job] for job in jobs), rng, is_waited_for)
            if pair is None:
                reason.update(dict.fromkeys(jobs))
            else:
                ends_s.update(zip(jobs, pair, strict=True))
            continue
        end_s = _place(arrays, routes, visits, rule, worth_j[index], rng, is_waited_for=bool(waiting[index]))
        if end_s is None:
            wanted = len(visits)
            text = f"no {wanted} robots can be at it at once"
            reason[index] = plain("not_together", text, count=wanted) if wanted > 1 else None
        else:
            ends_s[index] = end_s
    return reason


def _pinned_ends(problem: Problem, arrays: ProblemArrays) -> dict[int, float]:
    """End times of the pinned jobs."""
    ends_s: dict[int, float] = {}
    for worker, jobs in zip(problem.workers, arrays.pinned, strict=True):
        now_s, place = worker.ready_s, worker.start
        for index in jobs:
            job = problem.jobs[index]
            now_s += float(problem.time_s[worker.profile, place, job.place])
            now_s, place = max(now_s, job.earliest_s) + job.service_s, job.exit_place
            ends_s[index] = now_s
    return ends_s


def _chain_worth(problem: Problem, waiting: dict[int, list[int]]) -> dict[int, float]:
    """Prize of each job plus the prizes of all jobs that depend on it."""
    worth_j = {}
    for index in waiting:
        seen, stack = {index}, [index]
        while stack:
            for other in waiting[stack.pop()]:
                if other not in seen:
                    seen.add(other)
                    stack.append(other)
        worth_j[index] = math.fsum(problem.jobs[other].prize_j for other in seen)
    return worth_j


def _place(
    arrays: ProblemArrays,
    routes: RouteBatch,
    visits: list[int],
    rule: int,
    worth_j: float,
    rng: np.random.Generator | None,
    *,
    is_waited_for: bool,
) -> float | None:
    """Assign a job's visits to that many robots at the least cost; returns the job's end time, None if infeasible."""
    team, all_visits = arrays.team, arrays.visits
    count = len(visits)
    first = visits[0]
    bids = []
    for worker in range(len(team.ready_s)):
        bid, more_j, position = cheapest_insertion(team, all_visits, routes, worker, first, rule)
        if position >= 0:
            insert(team, all_visits, routes, worker, first, position)
            start_s = float(routes.leave_s[worker, position + 1] - all_visits.service_s[first])
            latest_s = float(routes.late_s[worker, position])
            remove(team, all_visits, routes, worker, position)
            weight = 1.0 if rng is None else float(rng.uniform(*NOISE))
            bids.append((bid * weight, more_j, worker, start_s, latest_s))
    best: tuple[float, list[int], float] | None = None
    for start_s in sorted({bid[3] for bid in bids}):
        there = sorted(bid for bid in bids if bid[3] <= start_s <= bid[4])[:count]
        if len(there) < count:
            continue
        cost = start_s if rule == BY_FINISH else math.fsum(bid[0] for bid in there)
        if rule == BY_ENERGY and not math.fsum(bid[1] for bid in there) < worth_j:
            continue
        if best is None or cost < best[0]:
            best = (cost, [bid[2] for bid in there], start_s)
    if best is None:
        return None
    _, workers, start_s = best
    old = [(float(all_visits.earliest_s[visit]), float(all_visits.latest_s[visit])) for visit in visits]
    if count > 1:
        all_visits.earliest_s[visits] = start_s
    if count > 1 or is_waited_for:
        all_visits.latest_s[visits] = start_s
    for number, (worker, visit) in enumerate(zip(workers, visits, strict=True)):
        _, _, position = cheapest_insertion(team, all_visits, routes, worker, visit, rule)
        if position < 0:
            # The robot lacks the energy to wait for the others.
            for other, (earliest_s, latest_s) in zip(visits, old, strict=True):
                all_visits.earliest_s[other], all_visits.latest_s[other] = earliest_s, latest_s
            for other_worker, other in zip(workers[:number], visits[:number], strict=True):
                at = [int(one) for one in routes.order[other_worker, : routes.length[other_worker]]].index(other)
                remove(team, all_visits, routes, other_worker, at)
            return None
        insert(team, all_visits, routes, worker, visit, position)
    refresh(team, all_visits, routes, workers[0])
    return start_s + float(all_visits.service_s[first])


def _place_pair(
    arrays: ProblemArrays,
    routes: RouteBatch,
    pickup: int,
    rule: int,
    worth_j: float,
    rng: np.random.Generator | None,
    is_waited_for: list[bool],
) -> tuple[float, float] | None:
    """Assign a pickup and its delivery to the robot of least cost; returns their end times, None if infeasible."""
    team, visits = arrays.team, arrays.visits
    bids = []
    for worker in range(len(team.ready_s)):
        bid, more_j, position, later = cheapest_pair(team, visits, routes, worker, pickup, rule, 0)
        if bid < math.inf and not (rule == BY_ENERGY and more_j >= worth_j):
            bids.append((bid * (1.0 if rng is None else float(rng.uniform(*NOISE))), worker, position, later))
    if not bids:
        return None
    _, worker, position, later = min(bids)
    pair = (pickup, int(visits.delivery[pickup]))
    for visit, at in zip(pair, (position, later), strict=True):
        insert(team, visits, routes, worker, visit, at)
    ends_s = float(routes.leave_s[worker, position + 1]), float(routes.leave_s[worker, later + 1])
    for visit, end_s, is_fixed in zip(pair, ends_s, is_waited_for, strict=True):
        if is_fixed:
            visits.latest_s[visit] = end_s - visits.service_s[visit]
    refresh(team, visits, routes, worker)
    return ends_s


class Windows(NamedTuple):
    """Visits with windows that keep the precedence of coupled jobs."""

    rows: NDArray[np.int64]
    """Indices of these visits in the problem; coupled jobs that the plan leaves out are missing."""
    visits: VisitArrays
    required: NDArray[np.bool_]


def windows_of(problem: Problem, arrays: ProblemArrays, plan: Plan, share: float, end_s: float) -> Windows:
    """Derive time windows from the times of a plan.

    Each coupled job gets a time between its earliest in the plan and its latest that meets `end_s`. All constraints are
    differences of times, so any mixture of the two schedules is feasible. A time half-way between a job and its
    successor separates the end of the one from the start of the other. A job for k robots keeps its time.

    Args:
        problem: the problem.
        arrays: of the problem.
        plan: passes `validate`.
        share: 0 takes the earliest times, 1 the latest.
        end_s: latest arrival of every robot at a charger; at least the plan's makespan.

    """
    waiting = problem.coupled
    done = {stop.job: stop for route in plan.routes for stop in route.stops}
    left_out = {index for index in waiting if problem.jobs[index].id not in done}
    chosen = np.array([row for row, job in enumerate(arrays.visits.job) if int(job) not in left_out], np.int64)
    visits = arrays.visits.chosen(chosen)
    required = np.zeros(len(chosen), np.bool_)
    if not waiting:
        return Windows(chosen, visits, required)
    latest_s = _latest_starts(problem, plan, min(end_s, problem.horizon_s))
    times_s = {
        name: stop.start_s
        if problem.jobs[problem.job_index[name]].pinned_to
        else (1 - share) * stop.start_s + share * max(stop.start_s, latest_s[name])
        for name, stop in done.items()
    }
    rows: dict[int, list[int]] = {}
    for row, job in enumerate(visits.job):
        rows.setdefault(int(job), []).append(row)
    for number, followers in waiting.items():
        job = problem.jobs[number]
        if number in left_out:
            continue
        for other in followers:
            if other in left_out:
                continue
            end = times_s[job.id] + job.service_s
            moment_s = end if job.pinned_to else (end + times_s[problem.jobs[other].id]) / 2
            mine, theirs = rows.get(number, []), rows.get(other, [])
            visits.latest_s[mine] = np.minimum(visits.latest_s[mine], moment_s - job.service_s)
            visits.earliest_s[theirs] = np.maximum(visits.earliest_s[theirs], moment_s)
            required[mine] = True
        if job.robots > 1:
            mine = rows.get(number, [])
            visits.earliest_s[mine] = visits.latest_s[mine] = times_s[job.id]
            required[mine] = True
    return Windows(chosen, visits, required)


def _latest_starts(problem: Problem, plan: Plan, end_s: float) -> dict[str, float]:
    """Greatest fixed point of the plan's orders, by backward passes over the routes until no time changes."""
    jobs = {job.id: job for job in problem.jobs}
    latest_s = {stop.job: math.inf for route in plan.routes for stop in route.stops}
    followers: dict[str, list[str]] = {}
    for name in latest_s:
        for other in problem.predecessors(jobs[name]):
            followers.setdefault(other, []).append(name)
    for _ in range(sum(len(route.stops) for route in plan.routes) + 1):
        is_settled = True
        for worker, route in zip(problem.workers, plan.routes, strict=True):
            time_s = problem.time_s[worker.profile]
            limit_s, place = end_s, route.end_place
            for stop in reversed(route.stops):
                job = jobs[stop.job]
                limit_s = min(limit_s - float(time_s[job.exit_place, place]), job.latest_s)
                for other in followers.get(job.id, ()):
                    limit_s = min(limit_s, latest_s[other])
                limit_s = min(limit_s - job.service_s, latest_s[job.id])
                is_settled = is_settled and limit_s == latest_s[job.id]
                latest_s[job.id], place = limit_s, job.place
        if is_settled:
            break
    return latest_s
