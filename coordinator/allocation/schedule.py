"""From orders of jobs to a plan with times and energies: everybody starts each job as early as it can."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from robrain.coordinator.allocation.plan import Plan, Route, Stop, Unassigned
from robrain.coordinator.allocation.problem import Objective, Problem, Worker


def make_plan(problem: Problem, orders: Sequence[Sequence[str]], objective: Objective) -> Plan | None:
    """The plan in which each worker does its jobs in this order.

    A job starts when its robots are all there, its time has come and what comes before it has ended. Limits (energy,
    deadlines, needs) are not looked at here; `validate` does.

    Args:
        problem: what is asked.
        orders: ids of jobs for each of the problem's workers.
        objective: of the plan.

    Returns:
        Its unassigned jobs without reasons (see `refusal.py`); None if the orders wait for each other in a ring.

    """
    starts_s = _earliest_starts(problem, orders)
    if starts_s is None:
        return None
    routes = tuple(
        _route(problem, worker, order, starts_s) for worker, order in zip(problem.workers, orders, strict=True)
    )
    done = {job for order in orders for job in order}
    left_out = [job for job in problem.jobs if job.id not in done]
    return Plan(
        objective=objective,
        routes=routes,
        unassigned=tuple(Unassigned(job.id) for job in left_out),
        cost_j=math.fsum(route.energy_j for route in routes),
        lost_prize_j=math.fsum(job.prize_j for job in left_out),
        makespan_s=max((route.end_s for route in routes if route.stops), default=0.0),
        least_left_j=min((route.left_j for route in routes), default=math.inf),
    )


def _earliest_starts(problem: Problem, orders: Sequence[Sequence[str]]) -> dict[str, float] | None:
    """Starts of the jobs: the least fixed point, found by going over the routes until nothing moves."""
    jobs = problem.jobs
    index = problem.job_index
    starts_s: dict[str, float] = {}
    coupled = any(jobs[index[job]].robots > 1 or problem.predecessors(jobs[index[job]]) for o in orders for job in o)
    for _ in range(sum(len(order) for order in orders) + 1):
        is_settled = True
        for worker, order in zip(problem.workers, orders, strict=True):
            time_s = problem.time_s[worker.profile]
            now_s, place = worker.ready_s, worker.start
            for name in order:
                job = jobs[index[name]]
                start_s = max(now_s + float(time_s[place, job.place]), job.earliest_s)
                if coupled:
                    for other in problem.predecessors(job):
                        start_s = max(start_s, starts_s.get(other, 0.0) + jobs[index[other]].service_s)
                    start_s = max(start_s, starts_s.get(name, 0.0))
                if start_s != starts_s.get(name):
                    starts_s[name] = start_s
                    is_settled = False
                now_s, place = start_s + job.service_s, job.place
        if is_settled or not coupled:
            return starts_s
    return None


def _route(problem: Problem, worker: Worker, order: Sequence[str], starts_s: Mapping[str, float]) -> Route:
    if not order:
        return Route(worker.name, (), worker.start, worker.ready_s, 0.0, worker.usable_j)
    energy_j, time_s = problem.energy_j[worker.profile], problem.time_s[worker.profile]
    now_s, place, spent_j = worker.ready_s, worker.start, 0.0
    stops = []
    for name in order:
        job = problem.jobs[problem.job_index[name]]
        arrive_s = now_s + float(time_s[place, job.place])
        start_s = starts_s[name]
        spent_j += float(energy_j[place, job.place]) + job.service_j + worker.wait_w * (start_s - arrive_s)
        now_s, place = start_s + job.service_s, job.place
        stops.append(Stop(name, arrive_s, start_s, now_s, worker.usable_j - spent_j))
    end_place = nearest_end(problem, worker, place)
    spent_j += float(energy_j[place, end_place])
    end_s = now_s + float(time_s[place, end_place])
    return Route(worker.name, tuple(stops), end_place, end_s, spent_j, worker.usable_j - spent_j)


def nearest_end(problem: Problem, worker: Worker, place: int) -> int:
    """The charger that it takes a worker least energy to reach from a place."""
    ends = sorted(set(worker.ends))
    return ends[int(np.argmin(problem.energy_j[worker.profile, place, ends]))]
