"""Nobody waits for a robot that charges if another can do the job now: those who charge get what is left over.

To an objective that counts joules, a robot that is free in five minutes is as good as one that is free now. So the plan
is made for those who are ready first, and what they cannot do is then handed out to the others.
"""

import logging
from collections.abc import Mapping, Sequence

import msgspec

from robrain.coordinator.allocation.allocator import Allocator
from robrain.coordinator.allocation.arrays import make_arrays
from robrain.coordinator.allocation.checked_allocator import BadPlan
from robrain.coordinator.allocation.plan import Plan, Route, Stop
from robrain.coordinator.allocation.problem import Problem
from robrain.coordinator.allocation.refusal import reasons
from robrain.coordinator.allocation.repair import repaired

logger = logging.getLogger(__name__)


def for_the_ready(problem: Problem) -> Problem:
    """The problem in which only those get jobs who are ready; as it is if all are, or nobody is.

    Args:
        problem: workers with `ready_s` above 0 are those who charge.

    """
    return _for_ready_only(problem, {job.id for job in problem.jobs if not job.pinned_to})


def with_those_who_charge(
    problem: Problem, plan: Plan, orders: Mapping[str, Sequence[str]], allocator: Allocator
) -> tuple[Problem, Plan]:
    """A plan of those who are ready, and what they leave to the others.

    Args:
        problem: as it was asked.
        plan: of `for_the_ready(problem)`.
        orders: of the plan before.
        allocator: hands out what is left.

    Returns:
        The problem, in which nobody who charges may do what somebody does who is ready; and its plan.

    """
    late = _late(problem)
    if not late:
        return problem, plan
    done = {job for route in plan.routes for job in route.jobs}
    shared = _for_ready_only(problem, {job.id for job in problem.jobs if not job.pinned_to and job.id in done})
    left = tuple(job for job in problem.jobs if job.pinned_to in late or not (job.pinned_to or job.id in done))
    if all(job.pinned_to for job in left):
        return shared, plan
    workers = tuple(worker for worker in problem.workers if worker.name in late)
    rest = msgspec.structs.replace(problem, jobs=left, workers=workers)
    before = msgspec.structs.replace(plan, routes=tuple(_in_this_order(name, orders.get(name, ())) for name in late))
    try:
        found = allocator.plan(rest, warm_start=before, iterations=1)
    except BadPlan as error:  # the plan of the ready robots is sound
        logger.warning("robots that charge get no tasks in this plan: %s", error)
        return shared, plan
    of_late = {route.worker: route.jobs for route in found.routes}
    both = repaired(shared, [of_late.get(route.worker, route.jobs) for route in plan.routes], plan.objective)
    if both is None or both.rank > plan.rank:
        return shared, plan
    known = {one.job: one.reason for one in (*plan.unassigned, *found.unassigned)}
    return shared, reasons(shared, make_arrays(shared), both, known)


def _late(problem: Problem) -> list[str]:
    late = [worker.name for worker in problem.workers if worker.ready_s > 0]
    return late if len(late) < len(problem.workers) else []


def _for_ready_only(problem: Problem, names: set[str]) -> Problem:
    if not names or not _late(problem):
        return problem
    jobs = (msgspec.structs.replace(job, ready_only=True) if job.id in names else job for job in problem.jobs)
    return msgspec.structs.replace(problem, jobs=tuple(jobs))


def _in_this_order(worker: str, jobs: Sequence[str]) -> Route:
    return Route(worker, tuple(Stop(job, 0.0, 0.0, 0.0, 0.0) for job in jobs), 0, 0.0, 0.0, 0.0)
