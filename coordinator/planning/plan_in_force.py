"""A plan as the coordinator follows it: assignments with order and times."""

from typing import TYPE_CHECKING

import msgspec

from robrain.algorithms.allocation.plan import Plan, Route
from robrain.algorithms.allocation.problem import Problem, Worker
from robrain.coordinator.planning.plan_passes import PlanFailure
from robrain.coordinator.planning.snapshot import ChargerDistances, Orders, Snapshot
from robrain.protocol.messages.tasks.plan_messages import PlanProblem
from robrain.protocol.messages.tasks.task_messages import RobotVerdict
from robrain.protocol.reasons import PlanReason, TaskReason

if TYPE_CHECKING:
    from robrain.coordinator.planning.problem_builder import BuiltProblem


class PlannedStep(msgspec.Struct, frozen=True):
    """One task of a robot's route."""

    task: str
    leave_ns: int
    """Latest time for its robot to set out."""
    travel_s: float
    start_ns: int
    service_s: float = 0.0
    """Time at its place."""
    energy_j: float = 0.0
    """Of the path there and the work at the place, without waiting."""
    charge_s: float = 0.0
    """Duration of the charges on the way there, which `travel_s` does not include; 0 if there are none."""
    has_begun: bool = False
    """Whether its robot had it already when the plan was made."""


class PlanInForce(msgspec.Struct, frozen=True, kw_only=True):
    """A plan, and on request the costs of one task."""

    problem: PlanProblem
    steps: dict[str, tuple[PlannedStep, ...]]
    """Tasks of each robot, running ones first."""
    left_out: dict[str, PlanReason]
    """Tasks that no robot does, and why."""
    waiting: dict[str, TaskReason]
    """Tasks that could not be part of the plan, and why."""
    bids: tuple[RobotVerdict, ...] = ()
    """Costs of the task that was asked for, for each robot."""
    failures: tuple[PlanFailure, ...] = ()
    """Failures of other distributions' code while the plan was made."""
    duration_s: float = 0.0
    charger_distances: dict[str, ChargerDistances] = {}
    """Path lengths to the chargers, for each robot that was free."""
    route_energy_j: dict[str, float] = {}
    """Energy of each robot's first trip with tasks that it has not begun, to a charger; of robots with such tasks."""

    charging: tuple[str, ...] = ()
    """Robots that charge between two tasks, or before the first one."""

    @property
    def orders(self) -> Orders:
        """The tasks of each robot that it had not begun, in order."""
        found = {robot: tuple(one.task for one in steps if not one.has_begun) for robot, steps in self.steps.items()}
        return {robot: tasks for robot, tasks in found.items() if tasks}


def planned(
    snapshot: Snapshot,
    asked: "BuiltProblem",
    problem: Problem,
    plan: Plan,
    written: PlanProblem,
    duration_s: float,
    failures: tuple[PlanFailure, ...] = (),
    only: str = "",
) -> PlanInForce:
    """Convert an allocator's plan to the form that the coordinator follows; see `Draft.planned`."""
    # Here: it imports the allocators' kernels, which a live coordinator does without.
    from robrain.algorithms.allocation.explain import explain

    pinned = {job.id for job in problem.jobs if job.pinned_to}
    steps: dict[str, tuple[PlannedStep, ...]] = {}
    route_energy_j: dict[str, float] = {}
    for worker, route in zip(problem.workers, plan.routes, strict=True):
        found, free_s, left_j = [], worker.ready_s, worker.usable_j
        for position, stop in enumerate(route.stops):
            asked_job = problem.jobs[problem.job_index[stop.job]]
            charges = [charge for charge in route.charges if charge.before == position]
            charge_s = sum(charge.end_s - charge.arrive_s for charge in charges)
            left_j += sum(charge.gained_j for charge in charges)
            travel_s = max(0.0, stop.arrive_s - free_s - charge_s)
            step = PlannedStep(
                task=stop.job,
                leave_ns=_at(snapshot, max(stop.arrive_s, asked_job.earliest_s) - travel_s - charge_s),
                travel_s=travel_s,
                start_ns=_at(snapshot, stop.start_s),
                service_s=asked_job.service_s,
                energy_j=left_j - stop.left_j - worker.wait_w * (stop.start_s - stop.arrive_s),
                has_begun=bool(asked_job.pinned_to),
                charge_s=charge_s,
            )
            found.append(step)
            free_s, left_j = stop.end_s, stop.left_j
        steps[route.worker] = tuple(found)
        first = next((position for position, step in enumerate(found) if not step.has_begun), None)
        if first is not None:
            route_energy_j[route.worker] = _trip_energy_j(worker, route, first)
    left_out: dict[str, PlanReason] = {}
    for one in plan.unassigned:
        if one.job not in pinned:
            assert one.reason is not None  # allocators give one for each
            left_out[one.job] = one.reason
    return PlanInForce(
        problem=written,
        steps=steps,
        left_out=left_out,
        waiting=asked.waiting,
        bids=explain(problem, plan, only, snapshot.pauses) if only else (),
        failures=failures,
        duration_s=duration_s,
        charger_distances=asked.charger_distances,
        route_energy_j=route_energy_j,
        charging=tuple(route.worker for route in plan.routes if route.charges),
    )


def _trip_energy_j(worker: Worker, route: Route, first: int) -> float:
    """Energy between the last charge before a stop, or the start, and the next charge."""
    begins_j = worker.full_j if any(charge.before <= first for charge in route.charges) else worker.usable_j
    ends_j = next((worker.full_j - one.gained_j for one in route.charges if one.before > first), route.left_j)
    return begins_j - ends_j


def _at(snapshot: Snapshot, in_s: float) -> int:
    return snapshot.now_ns + round(1e9 * in_s)
