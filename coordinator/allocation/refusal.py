"""Why a robot cannot, or should not, do a job: in numbers by a kernel, in words by `Judgement.reason`."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import msgspec
from numba import njit

from robrain.coordinator.allocation.arrays import ProblemArrays, TeamArrays, VisitArrays
from robrain.coordinator.allocation.insertion import BY_ENERGY, Routes, empty_routes, insertion_at, refresh
from robrain.coordinator.allocation.plan import Plan, Unassigned
from robrain.coordinator.allocation.problem import Job, Problem, Worker

FITS, LACKS, NO_WAY, TOO_LATE, CROWDED, NO_ENERGY = range(6)
"""A job fits into a route; the robot lacks something; there is no way; it is there too late even if it goes at once; it
would be in time but something else would then be too late; the energy does not suffice."""


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


def in_words(judgement: Judgement, worker: Worker, job: Job, horizon_s: float) -> str:
    """Why the worker is out; empty if it is not."""
    match judgement.code:
        case code if code == FITS:
            return ""
        case code if code == LACKS:
            return f"no {', no '.join(sorted(job.needs - worker.offers))}"
        case code if code == NO_WAY:
            return "no way there and to a charger"
        case code if code == TOO_LATE:
            if judgement.start_s + job.service_s > job.latest_s:
                return f"cannot be there before {judgement.start_s:.0f} s, must end it by {job.latest_s:.0f} s"
            return f"cannot be there before {judgement.start_s:.0f} s and at a charger by {horizon_s:.0f} s"
        case code if code == CROWDED:
            return "another of its jobs would be too late"
    if worker.capacity_j > 0:
        left = max(0.0, (judgement.left_j + worker.reserve_j) / worker.capacity_j)
        reserve = worker.reserve_j / worker.capacity_j
        digits = 0 if round(100 * left) < round(100 * reserve) else 2
        return f"would leave {100 * left:.{digits}f} % < {100 * reserve:.{digits}f} % reserve"
    return f"lacks {-judgement.left_j:.0f} J"


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


def reasons(problem: Problem, arrays: ProblemArrays, plan: Plan, why: Mapping[str, str]) -> Plan:
    """The plan with one sentence for each job that nobody does.

    A robot that could do it, but at more than its prize, is named; otherwise the robot that came nearest to it. `why`
    has what is known already; it is not said of a job that the plan does.
    """
    routes = routes_of(problem, arrays, plan)
    visit_of = {int(index): visit for visit, index in enumerate(arrays.visits.job)}
    done = {stop.job for route in plan.routes for stop in route.stops}
    told = []
    for one in plan.unassigned:
        index = problem.job_index[one.job]
        job = problem.jobs[index]
        missing = next((name for name in problem.predecessors(job) if name not in done), "")
        if index in arrays.refused:
            reason = arrays.refused[index]
        elif missing and one.job not in why:
            reason = f"it comes after {missing}, which nobody does"
        elif why.get(one.job):
            reason = why[one.job]
        else:
            reason = _reason(problem, arrays, routes, job, visit_of[index])
        told.append(Unassigned(one.job, reason))
    return msgspec.structs.replace(plan, unassigned=tuple(told))


def _reason(problem: Problem, arrays: ProblemArrays, routes: Routes, job: Job, visit: int) -> str:
    if not problem.workers:
        return "there are no robots"
    nearest = int(_nearest_to_it(arrays.team, arrays.visits, routes, visit))
    worker = problem.workers[nearest]
    best = judge(arrays, routes, nearest, visit)
    if best.code == FITS and job.robots > 1:
        return f"no {job.robots} robots can be at it at once for what it is worth"
    if best.code == FITS:
        return f"it is worth {job.prize_j:.0f} J and would take {worker.name}, the cheapest, {best.more_j:.0f} J"
    if best.code == LACKS:
        return f"no robot has {' and '.join(sorted(job.needs))}"
    return f"{worker.name}, which comes nearest: {in_words(best, worker, job, problem.horizon_s)}"


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
