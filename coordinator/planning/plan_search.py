"""From a snapshot to a refined plan: the allocator's first, then improved ones while the caller asks for more.

Equal problems, seeds, rounds and iterations give equal plans in both drives. In live the clock determines the number of
rounds, which is recorded with the plan.

`LockstepPlanner` plans synchronously, with a fixed number of rounds. `rehearse` makes a small plan, so that the first
real one does not wait for code to be loaded.
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from types import MappingProxyType

import msgspec
import numpy as np

from robrain.algorithms.allocation.allocator import Searching
from robrain.algorithms.allocation.auction import keep, repaired
from robrain.algorithms.allocation.checked_allocator import CheckedAllocator, allocator_of
from robrain.algorithms.allocation.explain import reasons
from robrain.algorithms.allocation.plan import Plan, Route, Stop, Unassigned, make_plan, nearest_end
from robrain.algorithms.allocation.problem import Problem, Worker, make_arrays
from robrain.algorithms.allocation.validate import validate
from robrain.algorithms.allocation.warm_up import warm_up
from robrain.algorithms.navigation.clearance import mapped_clearance_m
from robrain.coordinator.planning.live_planner import Supposed, Supposition
from robrain.coordinator.planning.path_lengths import PathLengths
from robrain.coordinator.planning.plan_in_force import PlanInForce, planned
from robrain.coordinator.planning.plan_passes import PlanDraft, PlanFailure, refined
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.problem_builder import BuiltProblem, build_problem, greatest_radius_m, needed_m
from robrain.coordinator.planning.remedies import cut_off, variants
from robrain.coordinator.planning.snapshot import Floor, PlanningRobot, Snapshot
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.plan_messages import PlanProblem
from robrain.protocol.messages.tasks.task_messages import RemedyKind, TaskRecord
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import FREE, GridGeometry
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.tasks.stock_kinds import VISIT
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import BelowReserve, LacksEnergy, NearestOut, PlanReason, TaskReason, plain

logger = logging.getLogger(__name__)

SIDE = 40
"""Cells of the floor."""

FRUITLESS = 2
"""Consecutive rounds without improvement after which the search ends."""


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
    """Add trips after a charge, which contain only jobs that the plan leaves out for lack of energy."""
    while any(_lacks_energy(one.reason) for one in draft.plan.unassigned):
        more = _with_trips(draft)
        if more is None:
            break
        draft = msgspec.structs.replace(draft, problem=draft.asked, plan=more)
    return draft


def _lacks_energy(reason: PlanReason | None) -> bool:
    return isinstance(reason, NearestOut) and isinstance(reason.because, BelowReserve | LacksEnergy)


def _with_trips(draft: PlanDraft) -> Plan | None:
    """The plan with one more trip for each robot that can charge after its route; None if that makes it no better."""
    problem, plan = draft.asked, draft.plan
    pairs = zip(problem.workers, plan.routes, strict=True)
    workers = [one for worker, route in pairs if (one := after_trip(problem, worker, route)) is not None]
    left = {one.job for one in plan.unassigned}
    jobs = tuple(job for job in problem.jobs if job.id in left and not job.pinned_to)
    if not (workers and jobs):
        return None
    rest = msgspec.structs.replace(problem, jobs=jobs, workers=tuple(workers))
    before = plan_of({one.name: draft.orders.get(one.name, ()) for one in workers}, plan.objective)
    found = draft.allocator.plan(rest, warm_start=before, iterations=1)
    added = {route.worker: route.jobs for route in found.routes}
    orders = [dict.fromkeys((*route.jobs, *added.get(route.worker, ()))) for route in plan.routes]
    made = repaired(problem, [list(order) for order in orders], plan.objective)
    if made is None or not made.rank < plan.rank:
        return None
    return reasons(problem, make_arrays(problem), made, {})


def after_trip(problem: Problem, worker: Worker, route: Route) -> Worker | None:
    """The worker after its route and a charge at the end of it; None if it cannot charge there."""
    place, end_s, left_j = route.end_place, route.end_s, route.left_j
    if not route.stops:
        place = nearest_end(problem, worker, worker.start)
        end_s += float(problem.time_s[worker.profile, worker.start, place])
        left_j -= float(problem.energy_j[worker.profile, worker.start, place])
    if place not in worker.chargers or not left_j >= 0:
        return None
    ready_s = end_s + max(0.0, worker.full_j - left_j) / worker.charge_w
    return msgspec.structs.replace(worker, chargers=(), start=place, ready_s=ready_s, usable_j=worker.full_j)


def early_start(draft: PlanDraft) -> PlanDraft:
    """Among equally good plans, prefer the one that starts earlier, which matters to people."""
    return draft.with_plan(without_idling(draft.problem, draft.plan))


def plan_of(orders: Mapping[str, Sequence[str]], objective: Objective) -> Plan | None:
    """A plan with orders only, for a warm start; None without orders."""
    if not orders:
        return None
    routes = tuple(_in_this_order(robot, jobs) for robot, jobs in orders.items())
    return Plan(
        objective=objective, routes=routes, cost_j=0.0, lost_prize_j=0.0, makespan_s=0.0, least_left_j=0.0
    )  # fmt: skip


def without_chargers(problem: Problem) -> Problem:
    """The problem without charges between two jobs."""
    if not any(worker.chargers for worker in problem.workers):
        return problem
    workers = tuple(msgspec.structs.replace(worker, chargers=()) for worker in problem.workers)
    return msgspec.structs.replace(problem, workers=workers)


def _gain(kept: Plan, best: Plan) -> float:
    """Relative improvement of the best plan over the kept one."""
    match best.objective:
        case Objective.ENERGY:
            kept_j = kept.cost_j + kept.delay_j
            return _share(kept_j - best.cost_j - best.delay_j, kept_j)
        case Objective.MAKESPAN:
            return _share(kept.makespan_s - best.makespan_s, kept.makespan_s)
        case Objective.LIFETIME:
            return _share(best.least_left_j - kept.least_left_j, kept.least_left_j)


def _share(gain: float, of: float) -> float:
    return gain / of if of > 0 else float(gain > 0)


def _in_this_order(worker: str, jobs: Sequence[str]) -> Route:
    return Route(worker, tuple(Stop(job, 0.0, 0.0, 0.0, 0.0) for job in jobs), 0, 0.0, 0.0, 0.0)


def without_idling(problem: Problem, plan: Plan) -> Plan:
    """Move valuable jobs earlier where that makes nothing worse.

    A route can be driven in either direction at the same length. A robot that would wait for a job's earliest time can
    do another job first. Pinned jobs stay first.
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
    waits = (index for index, stop in enumerate(route.stops) if stop.start_s - stop.arrive_s > WAITS_S)
    return next(waits, None)


def _better(problem: Problem, plan: Plan, worker: int, order: tuple[str, ...]) -> Plan | None:
    orders = [order if index == worker else route.jobs for index, route in enumerate(plan.routes)]
    found = make_plan(problem, orders, plan.objective)
    if found is None or found.rank > plan.rank or _lateness(problem, found) >= _lateness(problem, plan):
        return None
    if validate(problem, found):
        return None
    reasons = {one.job: one.reason for one in plan.unassigned}
    unassigned = tuple(Unassigned(one.job, reasons[one.job]) for one in found.unassigned)
    return msgspec.structs.replace(found, unassigned=unassigned)


def _lateness(problem: Problem, plan: Plan) -> float:
    """Sum of the start times, weighted by the prizes."""
    index = problem.job_index
    return sum(stop.start_s * problem.jobs[index[stop.job]].prize_j for route in plan.routes for stop in route.stops)


class PlanSearch:
    """Makes plans from snapshots, the auction's first; caches path lengths until the floor changes."""

    def __init__(self) -> None:
        self._paths: PathLengths | None = None

    def draft(self, snapshot: Snapshot, policy: PlanningPolicy) -> "Draft":
        """Start a plan; tasks that cannot be planned are set aside, each with its reason.

        Re-raises the planner's error if it is not due to single tasks.
        """
        try:
            return self._draft(snapshot, policy)
        except Exception:
            # The figures come from outside and the solver may raise anything; one bad task must not block all others.
            logger.exception("no plan %d can be made; looking for the tasks that prevent it", snapshot.number)
            wrong = self._find_wrong(snapshot, policy)
            if not wrong:
                raise
        sound = tuple(record for record in snapshot.records if record.task.id not in wrong)
        draft = self._draft(msgspec.structs.replace(snapshot, records=sound), policy)
        draft.asked.waiting.update(wrong)
        return draft

    def suppose(self, asked: Supposition) -> Supposed:
        """Make a plan that is not executed, and find out what keeps its task from being done."""
        try:
            planned = self.draft(asked.snapshot, asked.policy).planned(only=asked.task)
            if any(step.task == asked.task for steps in planned.steps.values() for step in steps):
                return Supposed(asked.number, planned, blocks=cut_off(asked.snapshot, asked.task))
            remedies = []
            for variant in variants(asked.snapshot, asked.task, asked.absent):
                # Another floor has other paths, and a search keeps those of one floor.
                search = PlanSearch() if variant.remedy.kind is RemedyKind.PATH else self
                plan = search.draft(variant.snapshot, asked.policy).solver.plan
                ends_s = [stop.end_s for route in plan.routes for stop in route.stops if stop.job == asked.task]
                if ends_s:
                    remedies.append(msgspec.structs.replace(variant.remedy, ends_in_s=round(max(ends_s), 1)))
            return Supposed(asked.number, planned, sorted(remedies, key=lambda one: one.ends_in_s or 0.0))
        except Exception:  # as for a plan
            logger.exception("no plan can be made for the supposed task %s", asked.task)
            return Supposed(asked.number, None)

    def _find_wrong(self, snapshot: Snapshot, policy: PlanningPolicy) -> dict[str, TaskReason]:
        wrong: dict[str, TaskReason] = {}
        for record in snapshot.records:
            alone = msgspec.structs.replace(snapshot, records=(record,), orders={})
            try:
                self._draft(alone, policy)
            except Exception as error:  # see `draft`
                logger.exception("task %s cannot be planned", record.task.id)
                text = cut(f"it cannot be planned: {type(error).__name__}: {error}")
                wrong[record.task.id] = plain("cannot_be_planned", text)
        return wrong

    def _draft(self, snapshot: Snapshot, policy: PlanningPolicy) -> "Draft":
        needed = needed_m(snapshot)
        version = 0 if snapshot.floor is None else snapshot.floor.version
        paths, key = self._paths, (version, needed, policy.unknown_cost)
        if paths is None or (paths.version, paths.needed_m, paths.unknown_cost) != key:
            floor, radius_m = snapshot.floor, greatest_radius_m(snapshot)
            narrow_m = None if floor is None else mapped_clearance_m(radius_m, floor.geometry.resolution_m)
            paths = self._paths = PathLengths(floor, needed, policy.unknown_cost, narrow_m)
        return Draft(snapshot, policy, build_problem(snapshot, paths, policy))


class Draft:
    """A plan in progress."""

    def __init__(self, snapshot: Snapshot, policy: PlanningPolicy, asked: BuiltProblem) -> None:
        self._snapshot, self._policy, self.asked = snapshot, policy, asked
        self.solver = PlanSolver(asked.question.problem(), policy, snapshot.orders)

    def planned(self, duration_s: float = 0.0, only: str = "") -> PlanInForce:
        """The best plan up to now; with the costs of the task `only`, if that is given."""
        snapshot, policy = self._snapshot, self._policy
        plan = self.solver.plan
        written = PlanProblem(
            plan=snapshot.number,
            asked_ns=snapshot.now_ns,
            objective=policy.objective,
            method=policy.method,
            seed=policy.seed,
            rounds=self.solver.rounds,
            iterations=self.solver.iterations,
            gain_min=policy.gain_min,
            question=self.asked.question.encode(),
            warm_start=tuple(snapshot.orders.items()),
            routes=tuple((route.worker, route.jobs) for route in plan.routes if route.stops),
            cause=snapshot.cause,
            passes=list(policy.passes),
        )
        return planned(snapshot, self.asked, self.solver.problem, plan, written, duration_s, self.solver.failures, only)


def rehearse() -> None:
    """Load and call the code that makes plans: the kernels of allocators and path lengths, and the search."""
    warm_up()
    places = [Point2D(1.0, 1.0), Point2D(3.0, 1.0), Point2D(1.0, 3.0)]
    here = Point2D(2.0, 2.0)
    snapshot = Snapshot(
        number=0,
        now_ns=0,
        cause="",
        records=tuple(
            TaskRecord(task=Task(id=f"t{k}", kind=VISIT, place=at), state=TaskState.QUEUED)
            for k, at in enumerate(places)
        ),
        ended=frozenset(),
        members={
            name: PlanningRobot(RobotState(robot=name, pose=Pose2D(here.x_m, here.y_m, 0.0)), None, (), here)
            for name in ("r1", "r2")
        },
        pauses={},
        served_s={},
        floor=Floor(np.full((SIDE, SIDE), FREE), GridGeometry(0.1, 0.0, 0.0, SIDE, SIDE), 1),
        orders={},
    )
    draft = PlanSearch().draft(snapshot, PlanningPolicy(iterations=1))
    draft.solver.run(rounds=1)
    draft.planned(only="t0")


class LockstepPlanner:
    """Plans synchronously, with a fixed number of rounds: equal runs have equal plans."""

    def __init__(self) -> None:
        self._search = PlanSearch()
        self._made: list[PlanInForce] = []
        self._supposed: list[Supposed] = []
        self.failure_reason = ""
        """See `LivePlanner`."""

    def prepare(self) -> None:
        """See `LivePlanner`."""

    def ask(self, snapshot: Snapshot, policy: PlanningPolicy) -> None:
        """See `LivePlanner`."""
        _warm_up_once()  # not before: most runs begin without a task, and this takes seconds on a new computer
        try:
            draft = self._search.draft(snapshot, policy)
            draft.solver.run(policy.rounds)
            self._made.append(draft.planned())
            self.failure_reason = ""
        except Exception as error:  # as in live: a planning error must not end the coordinator
            logger.exception("no plan %d could be made", snapshot.number)
            self.failure_reason = f"{type(error).__name__}: {error}"

    def suppose(self, supposition: Supposition) -> None:
        """See `LivePlanner`."""
        _warm_up_once()
        self._supposed.append(self._search.suppose(supposition))

    def supposed(self) -> list[Supposed]:
        """See `LivePlanner`."""
        found, self._supposed = self._supposed, []
        return found

    def finished_plans(self) -> list[PlanInForce]:
        """See `LivePlanner`."""
        made, self._made = self._made, []
        return made

    @property
    def is_busy(self) -> bool:
        """See `LivePlanner`."""
        return False

    def close(self) -> None:
        """See `LivePlanner`."""


_warm_up_once = cache(warm_up)


class PlanSolver:
    """Makes one plan, round by round.

    Args:
        problem: the problem as posed.
        policy: objective, allocator, seed, passes, and minimum gain for which a task moves to another robot.
        orders: of the previous plan: robots and their tasks in order.
        iterations: per search; those of the policy if None.

    """

    def __init__(
        self,
        problem: Problem,
        policy: PlanningPolicy,
        orders: Mapping[str, Sequence[str]] = MappingProxyType({}),
        iterations: int | None = None,
    ) -> None:
        self.rounds = 0
        """Number of searches up to now."""
        self.failures: tuple[PlanFailure, ...] = ()
        """Failures of other distributions' code when `plan` was last read."""
        self.problem = problem
        """The problem as posed; after `plan` was read, the problem that it solves."""
        visits = sum(job.robots for job in problem.jobs if not job.pinned_to)
        self.iterations = policy.iterations_for(visits) if iterations is None else iterations
        self._policy = policy
        allocator = allocator_of(policy.method, policy.objective)
        uncharged = without_chargers(problem)
        self._draft = PlanDraft(
            asked=problem,
            problem=uncharged,
            plan=allocator.plan(uncharged, warm_start=plan_of(orders, policy.objective), iterations=1),
            orders=orders,
            gain_min=policy.gain_min,
            allocator=allocator,
        )
        self._search = allocator.search() if isinstance(allocator, Searching) and _is_worth_it(uncharged) else None

    def improve(self) -> Iterator[None]:
        """Yield before each search, until no improvement is expected."""
        fruitless = 0
        while self._search is not None and fruitless < FRUITLESS:
            yield
            best, seed = self._draft.plan, self._policy.seed + self.rounds
            found = self._search.plan(self._draft.problem, iterations=self.iterations, seed=seed, warm_start=best)
            self.rounds += 1
            fruitless = 0 if found.rank < best.rank else fruitless + 1
            self._draft = self._draft.with_plan(min(best, found, key=lambda plan: plan.rank))

    def run(self, rounds: int) -> None:
        """Search until no improvement is expected, in at most `rounds` rounds."""
        for _ in self.improve():
            if self.rounds >= rounds:
                break

    @property
    def plan(self) -> Plan:
        """The best plan up to now, refined."""
        draft = refined(self._draft, self._policy.passes)
        self.problem, self.failures = draft.problem, draft.failures
        if isinstance(draft.allocator, CheckedAllocator):
            failures = draft.allocator.failures
            self.failures += tuple(PlanFailure("allocator", self._policy.method, cut(failure)) for failure in failures)
        return draft.plan


def _is_worth_it(problem: Problem) -> bool:
    """Whether a search can improve on the auction, which it cannot with a single unpinned task."""
    return sum(not job.pinned_to for job in problem.jobs) > 1
