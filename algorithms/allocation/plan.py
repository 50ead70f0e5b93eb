"""An allocator's plan: assignments, times and remaining energy; and `make_plan`, which builds one from orders of jobs.

`make_plan` starts each job as early as possible, and charges where this costs least energy.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from robrain.algorithms.allocation.problem import Objective, Problem, Worker
from robrain.protocol.reasons import PlanReason


class Stop(msgspec.Struct, frozen=True):
    """One job on a robot's route."""

    job: str
    arrive_s: float
    start_s: float
    end_s: float
    left_j: float
    """Remaining energy of the worker's `usable_j` after the job, before the path to the charger."""


class RouteCharge(msgspec.Struct, frozen=True):
    """A charge between two stops of a route, to `Worker.full_j`."""

    place: int
    before: int
    """Index of the stop that follows; the number of stops if the end follows."""
    arrive_s: float
    end_s: float
    gained_j: float


class Route(msgspec.Struct, frozen=True):
    """The stops of one robot. A robot without stops stays where it is, at no cost."""

    worker: str
    stops: tuple[Stop, ...]
    end_place: int
    """The charger at the end; the robot's start if it has no stops."""
    end_s: float
    """Arrival there."""
    energy_j: float
    left_j: float
    """Remaining energy of `usable_j` there."""
    charges: tuple[RouteCharge, ...] = ()
    """In order; without the one at the end of the route."""

    @property
    def jobs(self) -> tuple[str, ...]:
        """Ids in order."""
        return tuple(stop.job for stop in self.stops)


class Unassigned(msgspec.Struct, frozen=True):
    """A job that no robot does, and why."""

    job: str
    reason: PlanReason | None = None
    """None until `explain.reasons` fills it."""


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """Routes of all workers, in the order of the problem's workers."""

    objective: Objective
    routes: tuple[Route, ...]
    unassigned: tuple[Unassigned, ...] = ()
    cost_j: float
    lost_prize_j: float
    delay_j: float = 0.0
    """Sum of the jobs' `delay_w` times the seconds from their earliest starts to their ends."""
    makespan_s: float
    """Time when the last robot with a job arrives at its charger; 0 if no robot has one."""
    least_left_j: float
    """The least remaining energy of any robot; infinite without robots."""

    @property
    def value(self) -> float:
        """The objective's figure: joules (energy), seconds (makespan), joules (lifetime; more is better)."""
        if self.objective is Objective.ENERGY:
            return self.cost_j + self.delay_j + self.lost_prize_j
        return self.makespan_s if self.objective is Objective.MAKESPAN else self.least_left_j

    @property
    def rank(self) -> tuple[float, float, float]:
        """Of two plans for one problem and objective, the one with the lesser rank is better."""
        match self.objective:
            case Objective.ENERGY:
                return (_coarse(self.value), self.makespan_s, 0.0)
            case Objective.MAKESPAN:
                return (_coarse(self.lost_prize_j), self.makespan_s, self.cost_j)
            case Objective.LIFETIME:
                return (_coarse(self.lost_prize_j), -self.least_left_j, self.cost_j)

    @property
    def orders(self) -> tuple[tuple[str, ...], ...]:
        """Job ids of each route."""
        return tuple(route.jobs for route in self.routes)


def _coarse(value_j: float) -> float:
    """Rounded to a millijoule, so that the order of summation does not matter."""
    return round(value_j, 3) if math.isfinite(value_j) else value_j


def make_plan(problem: Problem, orders: Sequence[Sequence[str]], objective: Objective) -> Plan | None:
    """Return the plan in which each worker does its jobs in this order.

    A job starts when all its robots are there, its earliest time has come and its predecessors have ended. Limits
    (energy, deadlines, needs) are not checked here; `validate` does.

    Args:
        problem: the problem.
        orders: ids of jobs for each of the problem's workers.
        objective: of the plan.

    Returns:
        The plan, its unassigned jobs without reasons (see `explain.py`); None if the orders form a cycle.

    """
    chargers: list[list[tuple[int, ...]]] = [[()] * (len(order) + 1) for order in orders]
    if any(worker.chargers for worker in problem.workers):
        # Here: it imports the kernels, which a live coordinator does without.
        from robrain.algorithms.allocation.recharging import charges_of

        chargers = charges_of(problem, orders)
    starts_s = _earliest_starts(problem, orders, chargers)
    if starts_s is None:
        return None
    routes = tuple(
        _route(problem, worker, order, places, starts_s)
        for worker, order, places in zip(problem.workers, orders, chargers, strict=True)
    )
    ends_s = {stop.job: stop.end_s for route in routes for stop in route.stops}
    left_out = [job for job in problem.jobs if job.id not in ends_s]
    return Plan(
        objective=objective,
        routes=routes,
        unassigned=tuple(Unassigned(job.id) for job in left_out),
        cost_j=math.fsum(route.energy_j for route in routes),
        lost_prize_j=math.fsum(job.prize_j for job in left_out),
        delay_j=math.fsum(job.delay_w * (ends_s[job.id] - job.earliest_s) for job in problem.jobs if job.id in ends_s),
        makespan_s=max((route.end_s for route in routes if route.stops), default=0.0),
        least_left_j=min((route.left_j for route in routes), default=math.inf),
    )


def _earliest_starts(
    problem: Problem, orders: Sequence[Sequence[str]], chargers: Sequence[Sequence[tuple[int, ...]]]
) -> dict[str, float] | None:
    """Starts of the jobs: the least fixed point, by passes over the routes until no time changes.

    `chargers` has the places where each worker charges before each job.
    """
    jobs = problem.jobs
    index = problem.job_index
    starts_s: dict[str, float] = {}
    coupled = any(jobs[index[job]].robots > 1 or problem.predecessors(jobs[index[job]]) for o in orders for job in o)
    for _ in range(sum(len(order) for order in orders) + 1):
        is_settled = True
        for worker, order, places in zip(problem.workers, orders, chargers, strict=True):
            now_s, place, left_j = worker.ready_s, worker.start, worker.usable_j
            for name, before in zip(order, places, strict=False):
                job = jobs[index[name]]
                leg = _drive(problem, worker, (place, *before, job.place), now_s, left_j)
                start_s = max(leg.arrive_s, job.earliest_s)
                if coupled:
                    for other in problem.predecessors(job):
                        start_s = max(start_s, starts_s.get(other, 0.0) + jobs[index[other]].service_s)
                    start_s = max(start_s, starts_s.get(name, 0.0))
                if start_s != starts_s.get(name):
                    starts_s[name] = start_s
                    is_settled = False
                left_j = leg.left_j - job.service_j - worker.wait_w * (start_s - leg.arrive_s)
                now_s, place = start_s + job.service_s, job.exit_place
        if is_settled or not coupled:
            return starts_s
    return None


class _Leg(NamedTuple):
    """A drive from one stop to the next, with charges on the way."""

    arrive_s: float
    spent_j: float
    left_j: float
    charges: tuple[tuple[int, float, float, float], ...]
    """Place, arrival, end and joules gained of each charge."""


def _drive(problem: Problem, worker: Worker, places: Sequence[int], now_s: float, left_j: float) -> _Leg:
    """Drive from the first place to the last, and charge at those between."""
    energy_j, time_s = problem.energy_j[worker.profile], problem.time_s[worker.profile]
    spent_j = 0.0
    charges: list[tuple[int, float, float, float]] = []
    for before, after in itertools.pairwise(places):
        leg_j = float(energy_j[before, after])
        now_s, spent_j, left_j = now_s + float(time_s[before, after]), spent_j + leg_j, left_j - leg_j
        if len(charges) < len(places) - 2:
            gained_j = worker.full_j - left_j
            charges.append((after, now_s, now_s + gained_j / worker.charge_w, gained_j))
            now_s, left_j = charges[-1][2], worker.full_j
    return _Leg(now_s, spent_j, left_j, tuple(charges))


def _route(
    problem: Problem,
    worker: Worker,
    order: Sequence[str],
    chargers: Sequence[tuple[int, ...]],
    starts_s: Mapping[str, float],
) -> Route:
    if not order:
        return Route(worker.name, (), worker.start, worker.ready_s, 0.0, worker.usable_j)
    now_s, place, spent_j, gained_j = worker.ready_s, worker.start, 0.0, 0.0
    stops: list[Stop] = []
    charges: list[RouteCharge] = []
    end = _Leg(now_s, 0.0, worker.usable_j, ())
    for index, before in enumerate(chargers):
        job = problem.jobs[problem.job_index[order[index]]] if index < len(order) else None
        target = nearest_end(problem, worker, before[-1] if before else place) if job is None else job.place
        end = _drive(problem, worker, (place, *before, target), now_s, worker.usable_j + gained_j - spent_j)
        charges += [RouteCharge(at, index, arrive_s, end_s, more_j) for at, arrive_s, end_s, more_j in end.charges]
        gained_j = math.fsum(charge.gained_j for charge in charges)
        spent_j += end.spent_j
        if job is not None:
            start_s = starts_s[job.id]
            spent_j += job.service_j + worker.wait_w * (start_s - end.arrive_s)
            now_s, place = start_s + job.service_s, job.exit_place
            stops.append(Stop(job.id, end.arrive_s, start_s, now_s, worker.usable_j + gained_j - spent_j))
    left_j = worker.usable_j + gained_j - spent_j
    return Route(worker.name, tuple(stops), target, end.arrive_s, spent_j, left_j, tuple(charges))


def nearest_end(problem: Problem, worker: Worker, place: int) -> int:
    """The charger that a worker reaches from a place with least energy."""
    ends = sorted(set(worker.ends))
    return ends[int(np.argmin(problem.energy_j[worker.profile, place, ends]))]
