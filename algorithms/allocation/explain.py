"""Reasons for a plan: the cost of a job for each robot, or why the robot is excluded."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import msgspec
import numpy as np
from numba import njit

from robrain.algorithms.allocation.coupling import windows_of
from robrain.algorithms.allocation.insertion import (
    BY_ENERGY,
    RouteBatch,
    cheapest_pair,
    empty_routes,
    insertion_at,
    is_load,
    refresh,
    remove,
)
from robrain.algorithms.allocation.plan import Plan, Unassigned
from robrain.algorithms.allocation.problem import (
    Job,
    Problem,
    ProblemArrays,
    TeamArrays,
    VisitArrays,
    Worker,
    make_arrays,
)
from robrain.protocol.messages.tasks.task_messages import RobotVerdict
from robrain.protocol.reasons import (
    NO_ROUND_TRIP,
    BelowReserve,
    LacksEnergy,
    NearestOut,
    PlanReason,
    RobotReason,
    after_undone,
    lacks_plugins,
    plain,
)


def explain(
    problem: Problem, plan: Plan, name: str, pauses: Mapping[tuple[str, str], RobotReason] = MappingProxyType({})
) -> tuple[RobotVerdict, ...]:
    """Return each worker's cost of a job by a plan, or the reason of its exclusion; nothing for a pinned job.

    A robot's figures are those of the cheapest position in its route, with all other jobs in place. They cover the path
    from the place before, and the work. A robot that does the job is evaluated without it. Jobs that others wait for
    keep their windows. The figures of a delivery are those of its pickup, and both must fit.

    Args:
        problem: the problem.
        plan: its plan.
        name: id of the job.
        pauses: job and robot that must not be brought together for a while, and why.

    """
    index = problem.job_index[name]
    job = problem.jobs[index]
    if job.pinned_to:
        return ()
    robots = {route.worker for route in plan.routes if name in route.jobs}
    delivery = problem.deliveries.get(index, -1)
    for pickup, second in problem.deliveries.items():
        if second == index:
            index, job, delivery = pickup, problem.jobs[pickup], second
    arrays = make_arrays(problem)
    if problem.coupled:
        arrays = _narrowed(problem, arrays, plan)
    routes = routes_of(problem, arrays, plan)
    visit = int(np.flatnonzero(arrays.visits.job == index)[0])
    _remove_job(problem, arrays, routes, index)
    _remove_job(problem, arrays, routes, delivery)
    bids = []
    for row, worker in enumerate(problem.workers):
        if (pause := pauses.get((name, worker.name))) is not None:
            bid = RobotVerdict.judged(worker.name, pause)
        else:
            bid = _bid(problem, arrays, routes, row, job, judge(arrays, routes, row, visit))
        bids.append(msgspec.structs.replace(bid, chosen=worker.name in robots))
    return tuple(bids)


def _narrowed(problem: Problem, arrays: ProblemArrays, plan: Plan) -> ProblemArrays:
    windows = windows_of(problem, arrays, plan, 0.0, plan.makespan_s)
    for full, narrow in (
        (arrays.visits.earliest_s, windows.visits.earliest_s),
        (arrays.visits.latest_s, windows.visits.latest_s),
    ):
        full[windows.rows] = narrow
    return arrays


def _remove_job(problem: Problem, arrays: ProblemArrays, routes: RouteBatch, index: int) -> None:
    """Remove a job's visits from their routes; nothing for −1."""
    for worker in range(len(problem.workers)):
        for position in range(routes.length[worker]):
            if int(arrays.visits.job[routes.order[worker, position]]) == index:
                remove(arrays.team, arrays.visits, routes, worker, position)
                break


def _bid(
    problem: Problem, arrays: ProblemArrays, routes: RouteBatch, index: int, job: Job, judged: "Judgement"
) -> RobotVerdict:
    worker = problem.workers[index]
    if judged.code != FITS:
        return RobotVerdict.judged(worker.name, exclusion(judged, worker, job, problem.horizon_s))
    before = routes.order[index, judged.position - 1]
    place = arrays.visits.exit_place[before] if judged.position else arrays.team.start[index]
    path = worker.profile, place, job.place
    arrives_in_s = routes.leave_s[index, judged.position] + problem.time_s[path]
    left_j = max(0.0, judged.left_j + worker.reserve_j)
    return RobotVerdict(
        robot=worker.name,
        path_m=None if problem.length_m is None else round(float(problem.length_m[path]), 2),
        energy_j=round(float(problem.energy_j[path]) + job.service_j, 3),
        arrives_in_s=round(float(arrives_in_s), 3),
        left_soc=round(min(1.0, left_j / worker.capacity_j), 4) if worker.capacity_j > 0 else None,
    )


FITS, LACKS, NO_PATH, TOO_LATE, FULL, CROWDED, NO_ENERGY = range(7)
"""Results of checking whether a job fits into a route. `LACKS`: the robot lacks a plugin or is not admitted. `NO_PATH`:
no path exists. `TOO_LATE`: the job is late even if the robot goes at once. `FULL`: the robot can never carry its load.
`CROWDED`: another job would be late. `NO_ENERGY`: the energy does not suffice."""


class Judgement(NamedTuple):
    """Effect of one more job on a robot's route."""

    code: int
    more_j: float
    """Joules of the cheapest insertion, also if the energy does not suffice; infinite otherwise."""
    start_s: float
    """Start of the job in that position; its earliest possible start if that is too late."""
    left_j: float
    """Remaining energy of `usable_j`; below 0 if it does not suffice."""
    position: int


@njit(cache=True, nogil=True)
def judge_visit(
    team: TeamArrays, visits: VisitArrays, routes: RouteBatch, worker: int, visit: int
) -> tuple[int, float, float, float, int]:
    """Compute the fields of a `Judgement`."""
    profile = team.profile[worker]
    here, leaves_from = visits.place[visit], visits.exit_place[visit]
    if not visits.allowed[worker, visit]:
        return LACKS, math.inf, math.inf, math.inf, -1
    best_j, lacking_j, position, lacking_position = math.inf, math.inf, -1, -1
    if visits.delivery[visit] >= 0:
        bid, lacking_j, lacking_position, _ = cheapest_pair(team, visits, routes, worker, visit, BY_ENERGY, 0)
        if bid < math.inf:
            best_j, position = bid, lacking_position
    for index in range(routes.length[worker] + 1 if visits.delivery[visit] < 0 else 0):
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
        path_j = team.energy_j[profile, team.start[worker], here] + team.end_j[worker, leaves_from]
        if not path_j < math.inf:
            return NO_PATH, math.inf, math.inf, math.inf, -1
        end_s = start_s + visits.service_s[visit] + team.end_s[worker, leaves_from]
        is_late = start_s > visits.latest_s[visit] or end_s > team.horizon_s
        is_full = True
        for index in range(routes.length[worker] + 1):
            if is_load(team, worker, routes.load_kg[worker, index] + visits.load_kg[visit]):
                is_full = False
        code = TOO_LATE if is_late else FULL if is_full else CROWDED
        return code, math.inf, start_s, math.inf, -1
    place = team.start[worker] if position == 0 else visits.exit_place[routes.order[worker, position - 1]]
    arrive_s = routes.leave_s[worker, position] + team.time_s[profile, place, here]
    start_s = max(arrive_s, visits.earliest_s[visit])
    left_j = team.usable_j[worker] - routes.spent_j[worker] - best_j
    return code, best_j, start_s, left_j, position


def judge(arrays: ProblemArrays, routes: RouteBatch, worker: int, visit: int) -> Judgement:
    """Evaluate a visit for a worker's route."""
    return Judgement(*judge_visit(arrays.team, arrays.visits, routes, worker, visit))


def exclusion(judgement: Judgement, worker: Worker, job: Job, horizon_s: float) -> RobotReason | None:
    """Reason why the worker is excluded; None if it is not."""
    match judgement.code:
        case code if code == FITS:
            return None
        case code if code == LACKS:
            if missing := sorted(job.needs - worker.offers):
                return lacks_plugins(missing)
            if worker.name in job.forbidden_workers:
                return plain("forbidden", "is not to be given it")
            if job.load_kg < 0 or job.same_worker_as:
                return plain("not_holder", "does not carry what is delivered")
            return plain("not_delivery", "is not to be given its delivery")
        case code if code == FULL:
            load_kg = _figure(job.load_kg)
            return plain("full", f"cannot carry {load_kg:g} kg more", load_kg=load_kg)
        case code if code == NO_PATH:
            return plain(NO_ROUND_TRIP, "cannot reach it and then a charger")
        case code if code == TOO_LATE:
            start_s = _figure(judgement.start_s)
            text = f"cannot be there before {start_s:.0f} s"
            if judgement.start_s + job.service_s > job.latest_s:
                latest_s = _figure(job.latest_s)
                text += f", must end it by {latest_s:.0f} s"
                return plain("too_late", text, start_s=start_s, latest_s=latest_s)
            if horizon_s == math.inf:
                return plain("too_late_home", f"{text}, too late for what follows", start_s=start_s)
            horizon_s = _figure(horizon_s)
            text += f" and at a charger by {horizon_s:.0f} s"
            return plain("too_late_home", text, start_s=start_s, horizon_s=horizon_s)
        case code if code == CROWDED:
            return plain("crowded", "would be late at another of its tasks")
    if worker.capacity_j > 0:
        left = max(0.0, (judgement.left_j + worker.reserve_j) / worker.capacity_j)
        return BelowReserve(_figure(left), _figure(worker.reserve_j / worker.capacity_j))
    return LacksEnergy(_figure(-judgement.left_j))


def _figure(value: float) -> float:
    """Rounded, and within the range of `Quantity`."""
    return min(1e15, round(value, 6))


@njit(cache=True, nogil=True)
def _nearest_to_it(team: TeamArrays, visits: VisitArrays, routes: RouteBatch, visit: int) -> int:
    """The worker that could do it at least cost; if none can, the one whose code in the list above is highest."""
    best, best_code, best_more_j = -1, -1, math.inf
    for worker in range(len(team.ready_s)):
        code, more_j, _, left_j, _ = judge_visit(team, visits, routes, worker, visit)
        if code == FITS:
            code = NO_ENERGY + 1
        elif code == NO_ENERGY:
            more_j = -left_j
        if code > best_code or (code == best_code and more_j < best_more_j):
            best, best_code, best_more_j = worker, code, more_j
    return best


def reasons(problem: Problem, arrays: ProblemArrays, plan: Plan, known: Mapping[str, PlanReason | None]) -> Plan:
    """Return the plan with a reason for each unassigned job.

    The reason names a robot that could do the job at more than its prize; otherwise the robot that came closest.
    `known` holds reasons from earlier; those of assigned jobs are ignored.
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
            reason: PlanReason = arrays.refused[index]
        elif missing and one.job not in known:
            reason = after_undone(missing)
        else:
            reason = known.get(one.job) or _reason(problem, arrays, routes, job, visit_of[index])
        found.append(Unassigned(one.job, reason))
    return msgspec.structs.replace(plan, unassigned=tuple(found))


def _reason(problem: Problem, arrays: ProblemArrays, routes: RouteBatch, job: Job, visit: int) -> PlanReason:
    if not problem.workers:
        return plain("no_robots", "there are no robots")
    nearest = int(_nearest_to_it(arrays.team, arrays.visits, routes, visit))
    worker = problem.workers[nearest]
    best = judge(arrays, routes, nearest, visit)
    if best.code == LACKS:
        has_plugins = any(job.needs <= other.offers for other in problem.workers)
        if has_plugins:
            return plain("nobody_allowed", "no robot that has what it takes is to be given it now")
        needs = tuple(sorted(job.needs))
        return plain("nobody_has", f"no robot has {' and '.join(needs)}", plugins=needs)
    out = exclusion(best, worker, job, problem.horizon_s)
    if out is not None:
        return NearestOut(worker.name, out)
    if job.robots > 1:
        text = f"no {job.robots} robots can be at it at once for what it is worth"
        return plain("not_together_for_it", text, count=job.robots)
    worth_j, needed_j = _figure(job.prize_j), _figure(best.more_j)
    text = f"it is worth {worth_j:.0f} J and would take {worker.name}, the cheapest, {needed_j:.0f} J"
    return plain("not_worth_it", text, worth_j=worth_j, robot=worker.name, needed_j=needed_j)


def routes_of(problem: Problem, arrays: ProblemArrays, plan: Plan) -> RouteBatch:
    """A plan's routes in the kernels' form, without pinned jobs.

    Charges within a route count as energy at its start; their time does not count.
    """
    rows: dict[str, list[int]] = {}
    for visit, index in enumerate(arrays.visits.job):
        rows.setdefault(problem.jobs[index].id, []).append(visit)
    routes = empty_routes(arrays.team, arrays.visits)
    for worker, route in enumerate(plan.routes):
        order = [rows[stop.job].pop(0) for stop in route.stops if stop.job in rows]
        routes.order[worker, : len(order)] = order
        routes.length[worker] = len(order)
        arrays.team.usable_j[worker] += sum(charge.gained_j for charge in route.charges)
        refresh(arrays.team, arrays.visits, routes, worker)
    return routes
