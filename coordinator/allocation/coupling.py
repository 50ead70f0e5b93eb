"""Jobs that wait for each other: what comes after what, and k robots at once.

Such jobs couple routes, which neither the auction's bids nor PyVRP's model can hold. They are dealt with outside:

- the auction places them first, one by one in an order in which each comes after what it waits for, and fixes when they
  are done; all else is then put around them (`place_coupled`);
- for the search, a plan's times are turned into time windows that keep them apart whatever is moved within the windows
  (`windows_of`). Both are restrictions: what they leave out may hold something better.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.coordinator.allocation.insertion import (
    BY_ENERGY,
    BY_FINISH,
    Routes,
    cheapest_insertion,
    insert,
    refresh,
    remove,
)
from robrain.coordinator.allocation.plan import Plan
from robrain.coordinator.allocation.problem import Problem, ProblemArrays, VisitArrays
from robrain.protocol.wire.reasons.plans import AfterUndone, LeftOut, NotTogether, WaitsForItself

NOISE = (0.6, 1.4)
"""What bids are multiplied by where chance is wanted; chosen."""
HORIZON_SHARE = 1.25
"""Without a horizon, windows let a plan take so much longer than it would have to; chosen."""


def place_coupled(
    problem: Problem,
    arrays: ProblemArrays,
    routes: Routes,
    open_visits: NDArray[np.bool_],
    rule: int,
    rng: np.random.Generator | None = None,
) -> dict[int, LeftOut | None]:
    """Put the coupled jobs into empty routes and narrow their windows, both in place.

    With a generator the order among those that could be placed next is drawn, and bids are made a little more or less.

    Returns:
        For each of them that nobody does, why, or None if no robot alone can do it. All of them are no longer open.

    """
    waiting = problem.coupled
    visits_of: dict[int, list[int]] = {index: [] for index in waiting}
    for visit, job in enumerate(arrays.visits.job):
        if int(job) in visits_of:
            visits_of[int(job)].append(visit)
            open_visits[visit] = False
    ends_s = _pinned_ends(problem, arrays)
    why: dict[int, LeftOut | None] = {}
    undecided = [index for index in waiting if visits_of[index]]
    why.update({index: arrays.refused[index] for index in waiting if index in arrays.refused})
    worth_j = _chain_worth(problem, waiting)
    while undecided:
        ready = [
            index
            for index in undecided
            if all(
                (other := problem.job_index[name]) in ends_s or other in why
                for name in problem.predecessors(problem.jobs[index])
            )
        ]
        if not ready:
            why.update(dict.fromkeys(undecided, WaitsForItself()))
            break
        index = ready[0] if rng is None else ready[int(rng.integers(len(ready)))]
        undecided.remove(index)
        missing = [name for name in problem.predecessors(problem.jobs[index]) if problem.job_index[name] in why]
        if missing:
            why[index] = AfterUndone(missing[0])
            continue
        visits = visits_of[index]
        before_s = max(
            (ends_s[problem.job_index[name]] for name in problem.predecessors(problem.jobs[index])), default=0
        )
        arrays.visits.earliest_s[visits] = np.maximum(arrays.visits.earliest_s[visits], before_s)
        end_s = _place(arrays, routes, visits, rule, worth_j[index], rng, is_waited_for=bool(waiting[index]))
        if end_s is None:
            wanted = len(visits)
            why[index] = NotTogether(wanted) if wanted > 1 else None
        else:
            ends_s[index] = end_s
    return why


def _pinned_ends(problem: Problem, arrays: ProblemArrays) -> dict[int, float]:
    """When what robots are at will have ended."""
    ends_s: dict[int, float] = {}
    for worker, jobs in zip(problem.workers, arrays.pinned, strict=True):
        now_s, place = worker.ready_s, worker.start
        for index in jobs:
            job = problem.jobs[index]
            now_s += float(problem.time_s[worker.profile, place, job.place])
            now_s, place = max(now_s, job.earliest_s) + job.service_s, job.place
            ends_s[index] = now_s
    return ends_s


def _chain_worth(problem: Problem, waiting: dict[int, list[int]]) -> dict[int, float]:
    """A job's prize and those of all that come after it, which cannot be had without it."""
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
    routes: Routes,
    visits: list[int],
    rule: int,
    worth_j: float,
    rng: np.random.Generator | None,
    *,
    is_waited_for: bool,
) -> float | None:
    """Give a job's visits to as many robots, at the least cost at which they can be there at once; when it ends."""
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
            # Waiting for the others takes energy that it has not got.
            for other, (earliest_s, latest_s) in zip(visits, old, strict=True):
                all_visits.earliest_s[other], all_visits.latest_s[other] = earliest_s, latest_s
            for other_worker, other in zip(workers[:number], visits[:number], strict=True):
                at = [int(one) for one in routes.order[other_worker, : routes.length[other_worker]]].index(other)
                remove(team, all_visits, routes, other_worker, at)
            return None
        insert(team, all_visits, routes, worker, visit, position)
    refresh(team, all_visits, routes, workers[0])
    return start_s + float(all_visits.service_s[first])


# -- for the search -----------------------------------------------------------------------------------------------


class Windows(NamedTuple):
    """Visits that may be moved freely without breaking what comes after what."""

    rows: NDArray[np.int64]
    """Which of the problem's visits these are; coupled jobs that the plan leaves out are not among them."""
    visits: VisitArrays
    required: NDArray[np.bool_]


def windows_of(problem: Problem, arrays: ProblemArrays, plan: Plan, share: float, end_s: float) -> Windows:
    """Time windows from a plan's times.

    Each coupled job gets a time between its earliest in the plan and its latest that keeps to `end_s`. All limits are
    differences of times, so any such mixture of the two schedules is itself one that can be kept. Between a job and
    one that comes after it a moment is chosen, half-way, that the one ends before and the other starts after. A job
    for k robots keeps its time.

    Args:
        problem: what is asked.
        arrays: of the problem.
        plan: passes `validate`.
        share: 0 takes the earliest times, 1 the latest.
        end_s: everybody is to be at a charger by then; at least the plan's makespan.

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
    """The greatest fixed point of the plan's orders, found by going over the routes backwards until nothing moves."""
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
                limit_s = min(limit_s - float(time_s[job.place, place]), job.latest_s)
                for other in followers.get(job.id, ()):
                    limit_s = min(limit_s, latest_s[other])
                limit_s = min(limit_s - job.service_s, latest_s[job.id])
                is_settled = is_settled and limit_s == latest_s[job.id]
                latest_s[job.id], place = limit_s, job.place
        if is_settled:
            break
    return latest_s
