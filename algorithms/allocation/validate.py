"""The only checker of plans. It shares no code with the allocators and recomputes every figure."""

import math

from robrain.algorithms.allocation.plan import Plan, Route, Stop
from robrain.algorithms.allocation.problem import Job, Problem, Worker

SLACK = 1e-4
"""Tolerance, in joules and seconds, for figures and limits: rounding."""


def validate(problem: Problem, plan: Plan) -> list[str]:
    """Return the faults of a plan as sentences; empty if the plan is feasible."""
    faults: list[str] = []
    if [route.worker for route in plan.routes] != [worker.name for worker in problem.workers]:
        return ["the routes are not those of the problem's workers, in their order"]
    for worker, route in zip(problem.workers, plan.routes, strict=True):
        unknown = [stop.job for stop in route.stops if stop.job not in problem.job_index]
        if unknown:
            faults.append(f"{worker.name} does jobs that nobody asked for: {', '.join(unknown)}")
            continue
        faults += _check_route(problem, worker, route)
    return faults or [*_check_jobs(problem, plan), *_check_sums(problem, plan)]


def _check_route(problem: Problem, worker: Worker, route: Route) -> list[str]:
    faults = []
    now_s, place, left_j, load_kg = worker.ready_s, worker.start, worker.usable_j, worker.load_kg
    for position, stop in enumerate(route.stops):
        job = problem.jobs[problem.job_index[stop.job]]
        faults += _check_fit(worker, job, position, [other.job for other in route.stops[:position]], problem)
        charged, now_s, place, left_j = _check_charges(problem, worker, route, position, (now_s, place, left_j))
        faults += charged
        arrive_s = now_s + float(problem.time_s[worker.profile, place, job.place])
        if not math.isfinite(arrive_s):
            faults.append(f"{worker.name} has no way to {job.id}")
        if not (abs(arrive_s - stop.arrive_s) <= SLACK and stop.start_s >= arrive_s - SLACK):
            faults.append(f"{worker.name} cannot be at {job.id} before {arrive_s:.3f} s")
        if not stop.start_s >= job.earliest_s - SLACK:
            faults.append(f"{job.id} starts at {stop.start_s:.3f} s, before {job.earliest_s:.3f} s")
        if not stop.end_s <= job.latest_s + SLACK:
            faults.append(f"{job.id} ends at {stop.end_s:.3f} s, after {job.latest_s:.3f} s")
        if not abs(stop.end_s - stop.start_s - job.service_s) <= SLACK:
            faults.append(f"{job.id} does not take {job.service_s:.3f} s")
        left_j -= float(problem.energy_j[worker.profile, place, job.place])
        left_j -= worker.wait_w * (stop.start_s - arrive_s) + job.service_j
        if not abs(left_j - stop.left_j) <= SLACK:
            faults.append(f"{worker.name} has {left_j:.3f} J after {job.id}, not {stop.left_j:.3f} J")
        load_kg += job.load_kg
        if not -SLACK <= load_kg <= worker.capacity_kg + SLACK:
            faults.append(f"{worker.name} carries {load_kg:g} kg after {job.id}, of {worker.capacity_kg:g} kg at most")
        now_s, place = stop.end_s, job.place if job.end_place is None else job.end_place
    if not route.stops:
        return faults
    if route.end_place not in worker.ends:
        faults.append(f"{worker.name} ends at place {route.end_place}, which is none of its chargers")
        return faults
    charged, now_s, place, left_j = _check_charges(problem, worker, route, len(route.stops), (now_s, place, left_j))
    faults += charged
    now_s += float(problem.time_s[worker.profile, place, route.end_place])
    left_j -= float(problem.energy_j[worker.profile, place, route.end_place])
    if not left_j >= -SLACK:
        faults.append(f"{worker.name} lacks {-left_j:.3f} J on the way to its charger")
    if not now_s <= problem.horizon_s + SLACK:
        faults.append(f"{worker.name} is at its charger at {now_s:.3f} s, after {problem.horizon_s:.3f} s")
    if not (abs(left_j - route.left_j) <= SLACK and abs(now_s - route.end_s) <= SLACK):
        faults.append(f"{worker.name} ends at {now_s:.3f} s with {left_j:.3f} J, which its route says otherwise")
    return faults


def _check_charges(
    problem: Problem, worker: Worker, route: Route, position: int, state: tuple[float, int, float]
) -> tuple[list[str], float, int, float]:
    """Follow the charges before a stop; returns the faults, and time, place and energy after the last one."""
    faults = []
    now_s, place, left_j = state
    for charge in route.charges:
        if charge.before != position:
            continue
        if charge.place not in worker.chargers:
            faults.append(f"{worker.name} charges at place {charge.place}, which is none of its chargers")
        now_s += float(problem.time_s[worker.profile, place, charge.place])
        left_j -= float(problem.energy_j[worker.profile, place, charge.place])
        if not left_j >= -SLACK:
            faults.append(f"{worker.name} lacks {-left_j:.3f} J on the way to place {charge.place}")
        gained_j = worker.full_j - left_j
        end_s = now_s + gained_j / worker.charge_w if worker.charge_w > 0 else math.inf
        differences = (charge.arrive_s - now_s, charge.end_s - end_s, charge.gained_j - gained_j)
        if not all(abs(difference) <= SLACK for difference in differences):
            faults.append(
                f"{worker.name} charges {gained_j:.3f} J from {now_s:.3f} s to {end_s:.3f} s, not as reported"
            )
        now_s, place, left_j = end_s, charge.place, worker.full_j
    return faults, now_s, place, left_j


def _check_fit(worker: Worker, job: Job, position: int, before: list[str], problem: Problem) -> list[str]:
    faults = []
    if not job.needs <= worker.offers:
        faults.append(f"{worker.name} lacks {', '.join(sorted(job.needs - worker.offers))} for {job.id}")
    if worker.name in job.forbidden_workers:
        faults.append(f"{worker.name} is not to be given {job.id}")
    if job.pinned_to and job.pinned_to != worker.name:
        faults.append(f"{job.id} is given to {worker.name} while {job.pinned_to} is at it")
    if job.pinned_to and any(not problem.jobs[problem.job_index[other]].pinned_to for other in before):
        faults.append(f"{worker.name} is at {job.id}, but does it as number {position + 1}")
    return faults


def _check_jobs(problem: Problem, plan: Plan) -> list[str]:
    faults = []
    stops: dict[str, list[Stop]] = {}
    workers: dict[str, list[str]] = {}
    for route in plan.routes:
        for stop in route.stops:
            stops.setdefault(stop.job, []).append(stop)
            workers.setdefault(stop.job, []).append(route.worker)
    for job in problem.jobs:
        visits = stops.get(job.id, [])
        if job.same_worker_as in problem.job_index:
            pickup = problem.jobs[problem.job_index[job.same_worker_as]]
            if workers.get(job.id) != workers.get(pickup.id) and (visits or not pickup.pinned_to):
                faults.append(f"{job.id} and {pickup.id} are not done by the same robot")
        if not visits:
            continue
        if len(visits) != job.robots or len(set(workers[job.id])) != job.robots:
            faults.append(f"{job.id} asks for {job.robots} robots and is given to {', '.join(workers[job.id])}")
        if max(stop.start_s for stop in visits) - min(stop.start_s for stop in visits) > SLACK:
            faults.append(f"the robots of {job.id} do not start it at once")
        for other in job.after:
            if other not in problem.job_index:
                continue
            if other not in stops:
                faults.append(f"{job.id} comes after {other}, which nobody does")
            elif max(stop.end_s for stop in stops[other]) > min(stop.start_s for stop in visits) + SLACK:
                faults.append(f"{job.id} starts before {other} has ended")
    return faults


def _check_sums(problem: Problem, plan: Plan) -> list[str]:
    faults = []
    done = {stop.job for route in plan.routes for stop in route.stops}
    left_out = [job for job in problem.jobs if job.id not in done]
    if sorted(job.id for job in left_out) != sorted(one.job for one in plan.unassigned):
        faults.append("a job is neither on a route nor among the unassigned, or on both")
    sums = (
        ("cost_j", plan.cost_j, sum(route.energy_j for route in plan.routes)),
        ("energy of the routes", plan.cost_j, _spent_j(problem, plan)),
        ("lost_prize_j", plan.lost_prize_j, sum(job.prize_j for job in left_out)),
        ("makespan_s", plan.makespan_s, max((route.end_s for route in plan.routes if route.stops), default=0.0)),
        ("least_left_j", plan.least_left_j, min((route.left_j for route in plan.routes), default=math.inf)),
    )
    for name, reported, counted in sums:
        if reported != counted and not abs(reported - counted) <= SLACK * (1 + len(plan.routes)):
            faults.append(f"{name} is {counted:.3f}, not {reported:.3f}")
    return faults


def _spent_j(problem: Problem, plan: Plan) -> float:
    both = zip(problem.workers, plan.routes, strict=True)
    gained_j = sum(charge.gained_j for route in plan.routes for charge in route.charges)
    return gained_j + sum(worker.usable_j - route.left_j for worker, route in both if route.stops)
