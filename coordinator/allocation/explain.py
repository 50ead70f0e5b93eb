"""Why a plan is as it is: for each job what each robot would take for it, or the reason that it is out."""

import math
from collections.abc import Iterable, Sequence

import msgspec

from robrain.coordinator.allocation.arrays import ProblemArrays, make_arrays
from robrain.coordinator.allocation.coupling import coupled_jobs, windows_of
from robrain.coordinator.allocation.insertion import Routes, refresh, remove
from robrain.coordinator.allocation.plan import Plan, Stop
from robrain.coordinator.allocation.problem import Job, Problem
from robrain.coordinator.allocation.refusal import FITS, judge, routes_of, why_not
from robrain.protocol.wire.reasons.plans import BestTogether, Cheapest, Chosen, IsAtIt, LeftOut, OnlyThese
from robrain.protocol.wire.reasons.robots import RobotReason


class Option(msgspec.Struct, frozen=True, omit_defaults=True):
    """One robot and one job."""

    worker: str
    energy_j: float | None = None
    """What the job takes it, on top of the rest of its route; None if it is out."""
    time_s: float | None = None
    """By how much later it is at its charger for it."""
    start_s: float | None = None
    """When it would start with it."""
    why_not: RobotReason | None = None
    """Why it is out; None if it is not."""


class Decision(msgspec.Struct, frozen=True, omit_defaults=True):
    """What was decided of one job. Encodes as JSON."""

    job: str
    robots: tuple[str, ...] = ()
    """Who does it; empty if nobody."""
    start_s: float | None = None
    reason: Chosen | LeftOut | None = None
    """Why it is these robots, or why nobody does it."""
    options: tuple[Option, ...] = ()
    """One for each robot, in the problem's order."""


def explain(problem: Problem, plan: Plan, jobs: Iterable[str] | None = None) -> list[Decision]:
    """The decisions of a plan.

    Each robot's figures are those of the cheapest place in its route of the plan, with all other jobs where they are;
    a robot that does the job is asked as if it did not do it yet. Jobs that others wait for keep their windows.

    Args:
        problem: what was asked.
        plan: what was answered.
        jobs: ids; all if None.

    """
    arrays = make_arrays(problem)
    if coupled_jobs(problem):
        arrays = _narrowed(problem, arrays, plan)
    routes = routes_of(problem, arrays, plan)
    visit_of = {int(index): visit for visit, index in reversed(list(enumerate(arrays.visits.job)))}
    stops: dict[str, list[tuple[str, Stop]]] = {}
    for route in plan.routes:
        for stop in route.stops:
            stops.setdefault(stop.job, []).append((route.worker, stop))
    left_out = {one.job: one.reason for one in plan.unassigned}
    decisions = []
    for name in [job.id for job in problem.jobs] if jobs is None else jobs:
        index = problem.job_index[name]
        job, done_by = problem.jobs[index], stops.get(name, [])
        robots = tuple(worker for worker, _ in done_by)
        if job.pinned_to:
            start_s = done_by[0][1].start_s if done_by else None
            decisions.append(Decision(name, robots, start_s, left_out.get(name) or IsAtIt(job.pinned_to)))
            continue
        taken = _take_out(problem, arrays, routes, index)
        options = tuple(
            _option(problem, arrays, routes, worker, job, visit_of[index]) for worker in range(len(problem.workers))
        )
        for worker, order in taken.items():
            routes.order[worker, : len(order)] = order
            routes.length[worker] = len(order)
            refresh(arrays.team, arrays.visits, routes, worker)
        reason = _why_these(robots, options) if robots else left_out.get(name)
        decisions.append(Decision(name, robots, done_by[0][1].start_s if done_by else None, reason, options))
    return decisions


def _narrowed(problem: Problem, arrays: ProblemArrays, plan: Plan) -> ProblemArrays:
    windows = windows_of(problem, arrays, plan, 0.5, plan.makespan_s)
    for full, narrow in (
        (arrays.visits.earliest_s, windows.visits.earliest_s),
        (arrays.visits.latest_s, windows.visits.latest_s),
    ):
        full[windows.rows] = narrow
    return arrays


def _take_out(problem: Problem, arrays: ProblemArrays, routes: Routes, index: int) -> dict[int, list[int]]:
    """Remove a job's visits from the routes that have them; those routes as they were."""
    taken: dict[int, list[int]] = {}
    for worker in range(len(problem.workers)):
        order = [int(visit) for visit in routes.order[worker, : routes.length[worker]]]
        for position, visit in enumerate(order):
            if int(arrays.visits.job[visit]) == index:
                taken[worker] = order
                remove(arrays.team, arrays.visits, routes, worker, position)
                break
    return taken


def _option(problem: Problem, arrays: ProblemArrays, routes: Routes, index: int, job: Job, visit: int) -> Option:
    worker = problem.workers[index]
    judged = judge(arrays, routes, index, visit)
    if judged.code != FITS:
        return Option(worker.name, why_not=why_not(judged, worker, job, problem.horizon_s))
    return Option(worker.name, round(judged.more_j, 3), round(judged.more_s, 3), round(judged.start_s, 3))


def _why_these(robots: tuple[str, ...], options: Sequence[Option]) -> Chosen:
    """Whether they are the cheapest, and if not that the plan as a whole is."""
    costs = sorted((option.energy_j, option.worker) for option in options if option.energy_j is not None)
    cheapest = {worker for _, worker in costs[: len(robots)]}
    if set(robots) <= cheapest:
        others = [cost for cost, worker in costs if worker not in robots]
        if not others or not math.isfinite(others[0]):
            return OnlyThese(robots)
        return Cheapest(robots, others[0])
    return BestTogether(robots)
