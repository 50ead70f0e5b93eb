"""Reuse of earlier orders: jobs that are no longer feasible are left out until the rest is."""

from collections.abc import Sequence

import numpy as np

from robrain.algorithms.allocation.plan import Plan, Route, make_plan
from robrain.algorithms.allocation.problem import Objective, Problem, Worker, make_arrays
from robrain.algorithms.allocation.validate import SLACK, validate


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
    """Remove jobs with too few robots, or with a predecessor that no robot does; in place."""
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
        if not bad:
            return
        orders[:] = [[name for name in order if name not in bad] for order in orders]


def _misfit(problem: Problem, worker: Worker, route: Route) -> str:
    """Return a job of the route to leave out; empty if the route is feasible.

    This is the first job that is too late or, if energy or horizon do not suffice, the job that saves most per prize.
    """
    for stop in route.stops:
        if stop.end_s > problem.jobs[problem.job_index[stop.job]].latest_s + SLACK:
            return stop.job
    if not route.stops or (route.left_j >= -SLACK and route.end_s <= problem.horizon_s + SLACK):
        return ""
    energy_j = problem.energy_j[worker.profile]
    jobs = [problem.jobs[problem.job_index[stop.job]] for stop in route.stops]
    places = [worker.start, *(job.place for job in jobs), route.end_place]
    best, best_ratio = route.stops[-1].job, -np.inf
    for position, job in enumerate(jobs):
        before, here, after = places[position : position + 3]
        saved_j = float(energy_j[before, here] + energy_j[here, after] - energy_j[before, after]) + job.service_j
        ratio = saved_j / max(job.prize_j, 1e-9)
        if not job.pinned_to and ratio > best_ratio:
            best, best_ratio = job.id, ratio
    return best
