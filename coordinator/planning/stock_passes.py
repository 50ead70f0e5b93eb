"""The stock refinement passes, in their default order.

`stability` keeps the previous orders unless the new plan is worth the change. `charging_robots` gives charging robots
the jobs that the ready ones leave over. `early_start` moves jobs earlier where that does not make the plan worse.
"""

from collections.abc import Mapping, Sequence

import msgspec

from robrain.algorithms.allocation.allocator import Allocator
from robrain.algorithms.allocation.explain import reasons
from robrain.algorithms.allocation.plan import Plan, Route, Stop, Unassigned, make_plan
from robrain.algorithms.allocation.problem import Problem, make_arrays
from robrain.algorithms.allocation.repair import keep, repaired
from robrain.algorithms.allocation.validate import validate
from robrain.coordinator.planning.plan_passes import PlanDraft
from robrain.protocol.model.tasks.objective import Objective

LOOK_AHEAD = 8
"""Number of later jobs that are tried in place of one that a robot would wait for."""
TRIES_MAX = 200
TRIED_JOBS_MAX = 20_000
"""Limits for alternative orders per plan, and for the jobs in all of them together: a job takes some microseconds
(chosen)."""
WAITS_S = 0.05


def stability(draft: PlanDraft) -> PlanDraft:
    """Keep the previous orders unless the new plan is better by `gain_min`."""
    best, before = draft.plan, plan_of(draft.orders, draft.plan.objective)
    was = {job: robot for robot, jobs in draft.orders.items() for job in jobs}
    if all(was.get(job, route.worker) == route.worker for route in best.routes for job in route.jobs):
        return draft
    kept = keep(draft.problem, before, best.objective) if before is not None else None
    if kept is None or {one.job for one in kept.unassigned} != {one.job for one in best.unassigned}:
        return draft
    if _gain(kept, best) >= draft.gain_min:
        return draft
    known = {one.job: one.reason for one in best.unassigned}
    return draft.with_plan(reasons(draft.problem, make_arrays(draft.problem), kept, known))


def charging_robots(draft: PlanDraft) -> PlanDraft:
    """Give robots that charge the jobs that the ready robots leave over.

    For an objective in joules, a robot that is free in five minutes is as good as one that is free now. So the plan is
    made first for the robots that are ready (`for_ready_robots`).
    """
    problem, plan = with_charging_robots(draft.asked, draft.plan, draft.orders, draft.allocator)
    return msgspec.structs.replace(draft, problem=problem, plan=plan)


def early_start(draft: PlanDraft) -> PlanDraft:
    """Among equally good plans, prefer the one that starts earlier: objectives ignore that, people do not."""
    return draft.with_plan(without_idling(draft.problem, draft.plan))


def plan_of(orders: Mapping[str, Sequence[str]], objective: Objective) -> Plan | None:
    """A plan with orders only, for a warm start; None without orders."""
    if not orders:
        return None
    routes = tuple(_in_this_order(robot, jobs) for robot, jobs in orders.items())
    return Plan(
        objective=objective, routes=routes, cost_j=0.0, lost_prize_j=0.0, makespan_s=0.0, least_left_j=0.0
    )  # fmt: skip


def _gain(kept: Plan, best: Plan) -> float:
    """Relative improvement of the best plan over the kept one."""
    match best.objective:
        case Objective.ENERGY:
            return _share(kept.cost_j - best.cost_j, kept.cost_j)
        case Objective.MAKESPAN:
            return _share(kept.makespan_s - best.makespan_s, kept.makespan_s)
        case Objective.LIFETIME:
            return _share(best.least_left_j - kept.least_left_j, kept.least_left_j)


def _share(gain: float, of: float) -> float:
    return gain / of if of > 0 else float(gain > 0)


def for_ready_robots(problem: Problem) -> Problem:
    """Restrict all jobs to robots that are ready; the same problem if all robots are ready, or none is.

    Args:
        problem: workers with `ready_s` above 0 are charging.

    """
    return _for_ready_only(problem, {job.id for job in problem.jobs if not job.pinned_to})


def with_charging_robots(
    problem: Problem, plan: Plan, orders: Mapping[str, Sequence[str]], allocator: Allocator
) -> tuple[Problem, Plan]:
    """Add the charging robots to a plan of the ready ones.

    Args:
        problem: as it was posed.
        plan: of `for_ready_robots(problem)`.
        orders: of the previous plan.
        allocator: assigns the remaining jobs.

    Returns:
        The problem, in which no charging robot may do a job of a ready one; and its plan.

    Raises:
        BadPlan: another distribution's allocator returned an infeasible plan for the remaining jobs.

    """
    late = _charging(problem)
    if not late:
        return problem, plan
    done = {job for route in plan.routes if route.worker not in late for job in route.jobs}
    shared = _for_ready_only(problem, {job.id for job in problem.jobs if not job.pinned_to and job.id in done})
    left = tuple(job for job in problem.jobs if job.pinned_to in late or not (job.pinned_to or job.id in done))
    if all(job.pinned_to for job in left):
        return shared, plan
    workers = tuple(worker for worker in problem.workers if worker.name in late)
    rest = msgspec.structs.replace(problem, jobs=left, workers=workers)
    before = msgspec.structs.replace(plan, routes=tuple(_in_this_order(name, orders.get(name, ())) for name in late))
    found = allocator.plan(rest, warm_start=before, iterations=1)
    of_late = {route.worker: route.jobs for route in found.routes}
    both = repaired(shared, [of_late.get(route.worker, route.jobs) for route in plan.routes], plan.objective)
    if both is None or both.rank > plan.rank:
        return shared, plan
    known = {one.job: one.reason for one in (*plan.unassigned, *found.unassigned)}
    return shared, reasons(shared, make_arrays(shared), both, known)


def _charging(problem: Problem) -> list[str]:
    late = [worker.name for worker in problem.workers if worker.ready_s > 0]
    return late if len(late) < len(problem.workers) else []


def _for_ready_only(problem: Problem, names: set[str]) -> Problem:
    if not names or not _charging(problem):
        return problem
    jobs = (msgspec.structs.replace(job, ready_only=True) if job.id in names else job for job in problem.jobs)
    return msgspec.structs.replace(problem, jobs=tuple(jobs))


def _in_this_order(worker: str, jobs: Sequence[str]) -> Route:
    return Route(worker, tuple(Stop(job, 0.0, 0.0, 0.0, 0.0) for job in jobs), 0, 0.0, 0.0, 0.0)


def without_idling(problem: Problem, plan: Plan) -> Plan:
    """Move valuable jobs earlier where that makes nothing worse.

    A route can be driven in either direction at the same length, and a robot that would wait for a job's earliest time
    can do another job first. Pinned jobs stay first.
    """
    tries = min(TRIES_MAX, TRIED_JOBS_MAX // max(1, len(problem.jobs)))
    for worker in range(len(plan.routes)):
        pinned = sum(bool(problem.jobs[problem.job_index[job]].pinned_to) for job in plan.routes[worker].jobs)
        order = plan.routes[worker].jobs
        if len(order) - pinned < 2 or tries <= 0:
            continue
        tries -= 1
        plan = _better(problem, plan, worker, (*order[:pinned], *reversed(order[pinned:]))) or plan
        while tries > 0:
            at = _first_wait(plan.routes[worker])
            if at is None:
                break
            order = plan.routes[worker].jobs
            for later in range(max(pinned, at + 1), min(len(order), at + 1 + LOOK_AHEAD)):
                tries -= 1
                moved = (*order[:at], order[later], *order[at:later], *order[later + 1 :])
                found = _better(problem, plan, worker, moved)
                if found is not None:
                    plan = found
                    break
            else:
                break
    return plan


def _first_wait(route: Route) -> int | None:
    for index, stop in enumerate(route.stops):
        if stop.start_s - stop.arrive_s > WAITS_S:
            return index
    return None


def _better(problem: Problem, plan: Plan, worker: int, order: tuple[str, ...]) -> Plan | None:
    orders = [order if index == worker else route.jobs for index, route in enumerate(plan.routes)]
    found = make_plan(problem, orders, plan.objective)
    if (
        found is None
        or found.rank > plan.rank
        or _lateness(problem, found) >= _lateness(problem, plan)
        or validate(problem, found)
    ):
        return None
    reasons = {one.job: one.reason for one in plan.unassigned}
    unassigned = tuple(Unassigned(one.job, reasons[one.job]) for one in found.unassigned)
    return msgspec.structs.replace(found, unassigned=unassigned)


def _lateness(problem: Problem, plan: Plan) -> float:
    """Sum of the start times, weighted by the prizes."""
    index = problem.job_index
    return sum(stop.start_s * problem.jobs[index[stop.job]].prize_j for route in plan.routes for stop in route.stops)
