"""Why a robot cannot, or should not, do a job: in numbers by a kernel, as a reason by `why_not`."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import msgspec
from numba import njit

from robrain.coordinator.allocation.arrays import ProblemArrays, TeamArrays, VisitArrays
from robrain.coordinator.allocation.insertion import BY_ENERGY, Routes, empty_routes, insertion_at, refresh
from robrain.coordinator.allocation.plan import Plan, Unassigned
from robrain.coordinator.allocation.problem import Job, Problem, Worker
from robrain.protocol.wire.reasons.plans import (
    AfterUndone,
    LeftOut,
    NearestOut,
    NobodyAllowed,
    NobodyHas,
    NoRobots,
    NotTogetherForIt,
    NotWorthIt,
)
from robrain.protocol.wire.reasons.robots import (
    BelowReserve,
    Crowded,
    Forbidden,
    LacksEnergy,
    LacksPlugins,
    NotReady,
    NoWayAndBack,
    RobotReason,
    TooLate,
    TooLateHome,
)

FITS, LACKS, NO_WAY, TOO_LATE, CROWDED, NO_ENERGY = range(6)
"""A job fits into a route; the robot lacks something or may not; there is no way; it is there too late even if it goes
at once; it would be in time but something else would then be too late; the energy does not suffice."""


class Judgement(NamedTuple):
    """What a job would mean for a robot's route."""

    code: int
    more_j: float
    """Of the cheapest insertion, also of one that there is not the energy for; infinite otherwise."""
    more_s: float
    """By how much later the robot would be back."""
    start_s: float
    """When the job would start there; when it could start at the earliest if that is too late."""
    left_j: float
    """What would be left of `usable_j`; below 0 if it does not suffice."""
    position: int


@njit(cache=True, nogil=True)
def judge_visit(
    team: TeamArrays, visits: VisitArrays, routes: Routes, worker: int, visit: int
) -> tuple[int, float, float, float, float, int]:
    """The fields of a `Judgement`."""
    profile = team.profile[worker]
    here = visits.place[visit]
    if not visits.allowed[worker, visit]:
        return LACKS, math.inf, math.inf, math.inf, math.inf, -1
    best_j, lacking_j, position, lacking_position = math.inf, math.inf, -1, -1
    for index in range(routes.length[worker] + 1):
        bid, more_j = insertion_at(team, visits, routes, worker, visit, index, BY_ENERGY)
        if bid < best_j:
            best_j, position = bid, index
        if more_j < lacking_j:
            lacking_j, lacking_position = more_j, index
    code = FITS
    if position < 0:
        code, best_j, position = NO_ENERGY, lacking_j, lacking_position
    if position < 0:
        arrive_s = team.ready_s[worker] + team.time_s[profile, team.start[worker], here]
        start_s = max(arrive_s, visits.earliest_s[visit])
        way_j = team.energy_j[profile, team.start[worker], here] + team.end_j[worker, here]
        if not way_j < math.inf:
            return NO_WAY, math.inf, math.inf, math.inf, math.inf, -1
        end_s = start_s + visits.service_s[visit] + team.end_s[worker, here]
        is_late = start_s > visits.latest_s[visit] or end_s > team.horizon_s
        return TOO_LATE if is_late else CROWDED, math.inf, math.inf, start_s, math.inf, -1
    place = team.start[worker] if position == 0 else visits.place[routes.order[worker, position - 1]]
    arrive_s = routes.leave_s[worker, position] + team.time_s[profile, place, here]
    start_s = max(arrive_s, visits.earliest_s[visit])
    end_s = start_s + visits.service_s[visit]
    for index in range(position, routes.length[worker]):
        following = routes.order[worker, index]
        before = here if index == position else visits.place[routes.order[worker, index - 1]]
        end_s += team.time_s[profile, before, visits.place[following]]
        end_s = max(end_s, visits.earliest_s[following]) + visits.service_s[following]
    last = visits.place[routes.order[worker, routes.length[worker] - 1]] if routes.length[worker] > position else here
    end_s += team.end_s[worker, last]
    left_j = team.usable_j[worker] - routes.spent_j[worker] - best_j
    return code, best_j, end_s - routes.end_s[worker], start_s, left_j, position


def judge(arrays: ProblemArrays, routes: Routes, worker: int, visit: int) -> Judgement:
    """What a visit would mean for a worker's route."""
    return Judgement(*judge_visit(arrays.team, arrays.visits, routes, worker, visit))


def why_not(judgement: Judgement, worker: Worker, job: Job, horizon_s: float) -> RobotReason | None:
    """Why the worker is out; None if it is not."""
    match judgement.code:
        case code if code == FITS:
            return None
        case code if code == LACKS:
            if missing := sorted(job.needs - worker.offers):
                return LacksPlugins(tuple(missing))
            return Forbidden() if worker.name in job.forbidden_workers else NotReady()
        case code if code == NO_WAY:
            return NoWayAndBack()
        case code if code == TOO_LATE:
            if judgement.start_s + job.service_s > job.latest_s:
                return TooLate(_figure(judgement.start_s), _figure(job.latest_s))
            return TooLateHome(_figure(judgement.start_s), _figure(horizon_s) if horizon_s < math.inf else None)
        case code if code == CROWDED:
            return Crowded()
    if worker.capacity_j > 0:
        left = max(0.0, (judgement.left_j + worker.reserve_j) / worker.capacity_j)
        return BelowReserve(_figure(left), _figure(worker.reserve_j / worker.capacity_j))
    return LacksEnergy(_figure(-judgement.left_j))


def _figure(value: float) -> float:
    """Within the range of `Quantity`, and short."""
    return min(1e15, round(value, 6))


@njit(cache=True, nogil=True)
def _nearest_to_it(team: TeamArrays, visits: VisitArrays, routes: Routes, visit: int) -> int:
    """The worker that could do it at least cost; if none can, the one that fails latest in the order of the codes."""
    best, best_code, best_more_j = -1, -1, math.inf
    for worker in range(len(team.ready_s)):
        code, more_j, _, _, left_j, _ = judge_visit(team, visits, routes, worker, visit)
        if code == FITS:
            code = NO_ENERGY + 1
        elif code == NO_ENERGY:
            more_j = -left_j
        if code > best_code or (code == best_code and more_j < best_more_j):
            best, best_code, best_more_j = worker, code, more_j
    return best


def reasons(problem: Problem, arrays: ProblemArrays, plan: Plan, known: Mapping[str, LeftOut | None]) -> Plan:
    """The plan with a reason for each job that nobody does.

    A robot that could do it, but at more than its prize, is named; otherwise the robot that came nearest to it.
    `known` has the reasons that are known already; those of jobs that the plan does do not count.
    """
    routes = routes_of(problem, arrays, plan)
    visit_of = {int(index): visit for visit, index in enumerate(arrays.visits.job)}
    done = {stop.job for route in plan.routes for stop in route.stops}
    found = []
    for one in plan.unassigned:
        index = problem.job_index[one.job]
        job = problem.jobs[index]
        missing = next((name for name in problem.predecessors(job) if name not in done), "")
        if index in arrays.refused:
            reason: LeftOut = arrays.refused[index]
        elif missing and one.job not in known:
            reason = AfterUndone(missing)
        else:
            reason = known.get(one.job) or _reason(problem, arrays, routes, job, visit_of[index])
        found.append(Unassigned(one.job, reason))
    return msgspec.structs.replace(plan, unassigned=tuple(found))


def _reason(problem: Problem, arrays: ProblemArrays, routes: Routes, job: Job, visit: int) -> LeftOut:
    if not problem.workers:
        return NoRobots()
    nearest = int(_nearest_to_it(arrays.team, arrays.visits, routes, visit))
    worker = problem.workers[nearest]
    best = judge(arrays, routes, nearest, visit)
    if best.code == LACKS:
        has_plugins = any(job.needs <= other.offers for other in problem.workers)
        return NobodyAllowed() if has_plugins else NobodyHas(tuple(sorted(job.needs)))
    out = why_not(best, worker, job, problem.horizon_s)
    if out is not None:
        return NearestOut(worker.name, out)
    if job.robots > 1:
        return NotTogetherForIt(job.robots)
    return NotWorthIt(_figure(job.prize_j), worker.name, _figure(best.more_j))


def routes_of(problem: Problem, arrays: ProblemArrays, plan: Plan) -> Routes:
    """A plan's routes as the kernels know them; what robots are at already is not in them."""
    rows: dict[str, list[int]] = {}
    for visit, index in enumerate(arrays.visits.job):
        rows.setdefault(problem.jobs[index].id, []).append(visit)
    routes = empty_routes(arrays.team, arrays.visits)
    for worker, route in enumerate(plan.routes):
        order = [rows[stop.job].pop(0) for stop in route.stops if stop.job in rows]
        routes.order[worker, : len(order)] = order
        routes.length[worker] = len(order)
        refresh(arrays.team, arrays.visits, routes, worker)
    return routes
