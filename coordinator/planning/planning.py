"""Makes a new plan when one is needed, and follows it until the next.

A robot that finishes is offered the next task of its route in the same step in which it reports the end. A robot that
explores is called away for a task, and one whose next task begins soon is not sent exploring.
"""

import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from robrain.coordinator.planning.energy_budget import CHARGED_SOC, PLENTY_J, capacity_j, profile_of
from robrain.coordinator.planning.forecast import Forecast
from robrain.coordinator.planning.live_planner import LivePlanner, Supposed, Supposition
from robrain.coordinator.planning.plan_in_force import PlanInForce, PlannedStep
from robrain.coordinator.planning.policy import NEAREST, PlanningPolicy
from robrain.coordinator.planning.snapshot import AfterCharge, ChargerDistances, PlanningRobot, Snapshot, end_of
from robrain.coordinator.planning.snapshot_builder import (
    HOMEWARD,
    LATEST_S,
    SnapshotBuilder,
    exclusion,
    free_in_s,
    is_ending,
)
from robrain.coordinator.tasks.admission import NEAR_M
from robrain.coordinator.tasks.task_costs import TaskCosts
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.team.chargers import KnownChargers
from robrain.coordinator.team.roster import Robot
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks import plan_messages
from robrain.protocol.messages.tasks.plan_messages import ObjectiveRequest, PlannedCharge, PlanningStatus, TaskEstimates
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.stock_kinds import EXPLORE
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.model.zone import Zone
from robrain.protocol.reasons import (
    NO_ROUND_TRIP,
    NearestOut,
    PlainReason,
    PlanLeavesOut,
    PlanReason,
    RobotReason,
    Shut,
    TaskReason,
    plain,
    shut,
)
from robrain.protocol.wire.endpoint import Drive, Endpoint, Request, Serve

if TYPE_CHECKING:
    from robrain.coordinator.planning.plan_search import LockstepPlanner

DRAINED_SHARE = 0.02
"""A robot that has used this share of its full battery more than planned triggers a new plan."""
DEARER_SHARE = 0.05
"""A robot whose learned path costs have changed by this share triggers a new plan."""
GROWN_SHARE = 0.05
"""Growth of the map after which it is read again."""


class PlanInputs:
    """The part of the team's state whose changes need a new plan.

    Args:
        records: the tasks.
        members: the robots.
        pauses: tasks and robots that must not be offered them now, and why.
        area_m2: area of the known floor.
        zones: those that hold.

    """

    def __init__(
        self,
        records: Iterable[TaskRecord] = (),
        members: Mapping[str, PlanningRobot] = MappingProxyType({}),
        pauses: Mapping[tuple[str, str], RobotReason] = MappingProxyType({}),
        area_m2: float = 0.0,
        zones: tuple[Zone, ...] = (),
    ) -> None:
        self.records, self.members, self.pauses = tuple(records), members, pauses
        self.tasks = _tasks(self.records)
        self._terms = {
            task.id: (task.priority, task.earliest_ns, task.deadline_ns, task.needs, task.paused)
            for task in [record.task for record in self.records if not record.robot]
        }
        self._figures = {name: _figures(member) for name, member in members.items()}
        self._area_m2, self._zones = area_m2, zones

    def cause(self, now: "PlanInputs", *, left_out: int) -> str:
        """Why a new plan is needed, given the inputs of now; empty if it is not."""
        if now.tasks != self.tasks:
            return _difference(now.tasks, self.tasks)
        if now.members.keys() != self.members.keys():
            came = sorted(now.members.keys() - self.members.keys())
            gone = sorted(self.members.keys() - now.members.keys())
            return "; ".join([*(f"{name} is there" for name in came), *(f"{name} is out" for name in gone)])
        if not now.tasks:
            return ""
        if now._zones != self._zones:
            return "zones have changed"
        for name, terms in now._terms.items():
            if terms != self._terms.get(name, terms):
                return f"{name} has changed"
        for name, member in now.members.items():
            if _abilities(member) != _abilities(self.members[name]):
                return f"{name} can do other things than before"
        for task, robot in sorted(now.pauses.keys() ^ self.pauses.keys()):
            return f"whether {robot} may be asked for {task}"
        for name, member in now.members.items():
            (usable_j, j_per_m), (now_j, now_j_per_m) = self._figures[name], now._figures[name]
            battery = member.state.battery
            full_j = PLENTY_J if battery is None else capacity_j(battery)
            if abs(usable_j - now_j) > DRAINED_SHARE * full_j:
                return f"{name} has {now_j:.0f} J left, and had {usable_j:.0f} J"
            if abs(now_j_per_m - j_per_m) > DEARER_SHARE * j_per_m:
                return f"{name} takes {now_j_per_m:.1f} J a metre, and took {j_per_m:.1f} J"
        if now._area_m2 > self._area_m2 * (1.0 + GROWN_SHARE) and (left_out or self._area_m2 == 0.0):
            return f"the map has grown to {now._area_m2:.0f} m²"
        return ""

    def begun(self, task_id: str, robot: str) -> None:
        """Record that a task has begun as planned, which needs no new plan."""
        before = (task_id, TaskState.QUEUED, "")
        if before in self.tasks:
            self.tasks = self.tasks - {before} | {(task_id, TaskState.RUNNING, robot)}


def _tasks(records: Iterable[TaskRecord]) -> frozenset[tuple[str, TaskState, str]]:
    running = (TaskState.OFFERED, TaskState.RUNNING)
    return frozenset(
        (record.task.id, TaskState.RUNNING if record.state in running else record.state, record.robot)
        for record in records
    )


def _difference(now: frozenset[tuple[str, TaskState, str]], before: frozenset[tuple[str, TaskState, str]]) -> str:
    """The first few tasks that have changed."""
    names = {task: state for task, state, _ in now}
    changed = sorted({task for task, _, _ in now ^ before})
    words = [f"{task} is {names[task].replace('_', ' ')}" if task in names else f"{task} has ended" for task in changed]
    return ", ".join(words[:3]) + (f" and {len(words) - 3} more" if len(words) > 3 else "")


def _abilities(member: PlanningRobot) -> tuple[frozenset[str] | None, tuple[Point2D, ...], bool]:
    return member.offers, member.chargers, member.free_ns > 0


def _figures(member: PlanningRobot) -> tuple[float, float]:
    model = member.state.energy
    return (PLENTY_J if model is None else model.usable_j, profile_of(model, 1.0).j_per_m)


logger = logging.getLogger(__name__)

CHECK_NS = to_ns(0.5)
"""Interval between checks of robots and map for changes that need a new plan; tasks are checked at each step."""
FORECAST_NS = to_ns(1.0)
"""Interval at which estimates follow the robots; they follow a new plan at once."""
SOON_NS = to_ns(30.0)
"""A robot whose next task begins within this is not sent exploring (chosen)."""
SUPPOSITIONS_MAX = 16


class Due(NamedTuple):
    """A task to offer now."""

    task: str
    robot: str
    after: str
    """The task that the robot must end first; empty if it is to begin at once."""


class Unplanned(NamedTuple):
    """A task that is not in the plan."""

    reason: PlanReason
    since_ns: int


class Planning:
    """Makes and follows plans.

    Args:
        lifecycle: of the tasks, with the book and the robots.
        policy: parameters of planning.

    """

    def __init__(self, lifecycle: TaskLifecycle, policy: PlanningPolicy) -> None:
        wire = lifecycle.wire
        self.policy = policy
        self.chargers = KnownChargers(wire, lifecycle.capabilities.plugins)
        self.after_charge: dict[str, AfterCharge] = {}
        """Predicted state of charging robots after their charge; maintained by charging."""
        self.charges: tuple[PlannedCharge, ...] = ()
        """Which robots charge where and when; maintained by charging."""
        self.lack_range: set[str] = set()
        """Idle robots that lack only the energy to explore the remaining regions; maintained by exploration."""
        self.held: dict[str, PlainReason] = {}
        """Robots that work on a task with others."""
        self.left_out: dict[str, Unplanned] = {}
        """Tasks that are not in the plan, with reason and time."""
        self.waiting: dict[str, TaskReason] = {}
        """Tasks that could not be part of the plan, and why."""
        self._wire = wire
        self._book, self._roster, self._backoff = lifecycle.book, lifecycle.roster, lifecycle.backoff
        self._team_map = lifecycle.team_map
        self._builder = SnapshotBuilder(lifecycle, self.chargers, self.exclusion, self.after_charge)
        self._eligibility = lifecycle.eligibility
        self._costs = TaskCosts(wire, lifecycle.capabilities)
        self.forecast = Forecast(self._book, self._roster, self.after_charge, policy.time_margin)
        self._forecast_ns = 0
        self._supposed: list[tuple[TaskRecord, Callable[[Supposed], None]]] = []
        """Suppositions without a plan, in order. The cost of the first one's task is asked for."""
        self._suppositions: dict[int, Callable[[Supposed], None]] = {}
        self._supposition = 0
        """Number of the last one."""
        self._inputs = PlanInputs()
        """Of the last plan."""
        self._planner = _planner_of(wire)
        self._failure_reason = ""
        self._plan: PlanInForce | None = None
        self._number = 0
        self._ending_ns: dict[str, int] = {}
        """Since when each robot is about to end its task."""
        self._check_ns = 0
        self._not_before_ns = 0
        self._seen_version = -1
        self._asked_ns: int | None = None
        self._cause = ""
        self._estimates_publisher = wire.publisher(plan_messages.TASK_ESTIMATES)
        self._problem_publisher = wire.publisher(plan_messages.TASK_PROBLEM)
        wire.answer(plan_messages.COORDINATOR_PLANNING, lambda _: self.status(), serve=Serve.IN_STEP)
        wire.answer(plan_messages.COORDINATOR_OBJECTIVE, self._choose, serve=Serve.IN_STEP)

    @property
    def is_on(self) -> bool:
        """Whether plans are made at all."""
        return self.policy.method != NEAREST

    def prepare(self) -> None:
        """Prepare for the first plan beside the coordinator's loop, if plans are made."""
        if self.is_on:
            self._planner.prepare()

    def close(self) -> None:
        """End all activity beside the coordinator's loop."""
        self._planner.close()

    # -- making plans ---------------------------------------------------------------------------------------

    def step(self, now_ns: int) -> bool:
        """Detect changes, request a plan if one is needed, and take finished plans; True if there is a new plan."""
        has_plan = False
        if self.is_on:
            if now_ns >= self._check_ns or self._seen_version != self._book.version or self._costs.is_waiting:
                self._update_cause(now_ns)
            if self._cause and now_ns >= self._not_before_ns:
                self._ask(now_ns)
            if self._supposed or self._suppositions:
                self._plan_suppositions(now_ns)
            has_plan = self._follow_finished(now_ns)
        if has_plan or now_ns >= self._forecast_ns:
            self._forecast_ns = now_ns + FORECAST_NS
            self.forecast.update(self._plan, now_ns)
            if self.forecast.has_moved():
                tasks = (self.forecast.estimate(task, times, now_ns) for task, times in self.forecast.times.items())
                self._estimates_publisher.put(TaskEstimates(tasks=tuple(tasks)))
        return has_plan

    def receive(self, before: RobotState | None, state: RobotState) -> None:
        """Compare a robot's new state with its last, and plan without delay if a plan depends on the change."""
        if before is None or _availability(before) != _availability(state):
            self._check_ns = 0

    def blocked(self) -> None:
        """A robot's path was blocked: read the map again."""
        self._builder.is_blocked = True

    def _update_cause(self, now_ns: int) -> None:
        self._seen_version = self._book.version
        if now_ns >= self._check_ns:
            self._check_ns = now_ns + CHECK_NS
            self.chargers.follow(self._builder.places(now_ns), now_ns)
        records = self._plannable(now_ns)
        if not records and not self._inputs.tasks:
            return
        cause = self._inputs.cause(self._inputs_of(records, now_ns), left_out=len(self.left_out))
        if not cause and records and now_ns - (self._asked_ns or now_ns) > to_ns(self.policy.refresh_s):
            cause = "a while has passed"
        self._cause = self._cause or cause

    def _plannable(self, now_ns: int) -> list[TaskRecord]:
        """Open tasks except those whose cost the robots have not reported yet."""
        records = self._builder.records()
        asked = {record.task.id: record.task for record in (*(one for one, _ in self._supposed[:1]), *records)}
        if asked or self._costs.is_waiting:
            self._costs.follow(asked.values(), self._builder.places(now_ns), now_ns)
        return [record for record in records if record.robot or self._costs.of(record.task) is not None]

    def _inputs_of(self, records: Sequence[TaskRecord], now_ns: int) -> PlanInputs:
        members = self._builder.members(now_ns)
        pauses = self._eligibility.pauses(records, members, now_ns)
        return PlanInputs(records, members, pauses, self._team_map.known_area_m2, self._team_map.zones)

    def _ask(self, now_ns: int) -> None:
        cause, self._cause = self._cause, ""
        self._asked_ns = now_ns
        self._inputs = inputs = self._inputs_of(self._plannable(now_ns), now_ns)
        if not inputs.members or not inputs.records:
            self._plan = None
            self.left_out, self.waiting = {}, {}
            return
        self._not_before_ns = now_ns + to_ns(self.policy.settle_s)
        self._number += 1
        self._planner.ask(self._snapshot(inputs, cause, now_ns), self.policy)

    def _snapshot(self, inputs: PlanInputs, cause: str, now_ns: int) -> Snapshot:
        records, members = inputs.records, inputs.members
        open_ids = {record.task.id for record in records}
        works = {record.task.id: self._costs.of(record.task) or () for record in records}
        return Snapshot(
            number=self._number,
            now_ns=now_ns,
            cause=cause,
            records=records,
            ended=self._builder.done_before(records, open_ids),
            held=self._builder.held(records),
            ending=self._builder.ending(members, works),
            members={name: one._replace(charge_w=self.chargers.least_w(name)) for name, one in members.items()},
            pauses={pair: reason for pair, reason in inputs.pauses.items() if pair[0] in open_ids},
            waiting={
                record.task.id: reason
                for record in records
                if not record.robot and (reason := self._eligibility.unplannable(record)) is not None
            },
            works=works,
            served_s=self._builder.served_s(records, now_ns),
            floor=self._builder.floor(now_ns, wanted=bool(self.left_out)),
            orders=self._orders(),
        )

    def suppose(self, record: TaskRecord, now_ns: int, on_plan: Callable[[Supposed], None]) -> None:
        """Make a plan with a task, without executing it.

        Args:
            record: of the task, which may be one more than there are.
            now_ns: the time.
            on_plan: called in a step of the coordinator with the plan.

        Raises:
            CallError: too many wait for such a plan.

        """
        if not self.is_on:
            on_plan(Supposed(0, None))
            return
        if len(self._supposed) + len(self._suppositions) >= SUPPOSITIONS_MAX:
            raise CallError(ErrorCode.BUSY, f"{SUPPOSITIONS_MAX} dry runs are in progress; ask again later")
        self._supposed.append((record, on_plan))
        self._plan_suppositions(now_ns)

    def _plan_suppositions(self, now_ns: int) -> None:
        """Plan with the tasks whose cost is known, in turn, and pass on plans that are made."""
        while self._supposed:
            record, on_plan = self._supposed[0]
            self._plannable(now_ns)  # asks; in lockstep, the answers are then there
            others = [one for one in self._plannable(now_ns) if one.task.id != record.task.id]
            if self._costs.of(record.task) is None and self._wire.drive is Drive.LIVE:
                break
            del self._supposed[0]
            self._supposition += 1
            self._suppositions[self._supposition] = on_plan
            inputs = self._inputs_of([*others, record], now_ns)
            snapshot = self._snapshot(inputs, f"what if {record.task.id}", now_ns)
            absent = {name: robot for name, robot in self._builder.absent().items() if name not in inputs.members}
            self._planner.suppose(Supposition(self._supposition, snapshot, self.policy, record.task.id, absent))
            self._costs.follow((one.task for one in others), self._builder.places(now_ns), now_ns)  # forgets this one
        for answer in self._planner.supposed():
            then = self._suppositions.pop(answer.number, None)
            if then is not None:
                then(answer)

    def _follow_finished(self, now_ns: int) -> bool:
        made = self._planner.finished_plans()
        if self._planner.failure_reason not in ("", self._failure_reason):
            self._wire.refusals.record_failure("planner", self.policy.method, self._planner.failure_reason)
        self._failure_reason = self._planner.failure_reason
        for plan in made:
            self._plan = plan
            self._problem_publisher.put(plan.problem)
            for failure in plan.failures:
                self._wire.refusals.record_failure(failure.what, failure.name, failure.reason)
            self.waiting = plan.waiting
            since_ns = {task: one.since_ns for task, one in self.left_out.items() if not isinstance(one.reason, Shut)}
            reasons = {**plan.left_out, **self._behind_shut(plan.left_out)}
            self.left_out = {task: Unplanned(reason, since_ns.get(task, now_ns)) for task, reason in reasons.items()}
        return bool(made)

    def _behind_shut(self, left_out: Mapping[str, PlanReason]) -> dict[str, Shut]:
        """Tasks that shut zones keep all robots from, or the nearest robot from chargers, with these zones."""
        states = {name: robot.state for name, robot in self._roster.robots.items() if robot.state is not None}
        separation, found = self._team_map.separation([*states.values()]), dict[str, Shut]()
        if separation is None:
            return found
        for task_id, reason in left_out.items():
            record = self._book.find(task_id)
            if record is None or not isinstance(reason, NearestOut) or reason.because.code != NO_ROUND_TRIP:
                continue
            ends_at = end_of(record.task, {task_id: self._costs.of(record.task) or ()})
            zone = separation.shut_before(record.task.place, NEAR_M) or separation.shut_before(ends_at, NEAR_M)
            chargers = self.chargers.of.get(reason.robot, ())
            if zone is None and chargers and (alone := self._team_map.separation([states[reason.robot]])) is not None:
                zone = alone.shut_before(chargers[0].place, NEAR_M)
            if zone is not None:
                found[task_id] = shut(zone)
        return found

    # -- following them -------------------------------------------------------------------------------------

    def due(self, now_ns: int) -> Iterator[Due]:
        """Tasks to offer now, by the plan; a robot that explores must be called away for them."""
        if self._plan is None:
            return
        for name in sorted(self._plan.steps):
            robot, bound = self._roster.robots.get(name), self._book.bound_to(name)
            left_s = math.inf if robot is None else free_in_s(robot, bound)
            step = self._to_offer(name) if left_s < math.inf else None
            if step is None or robot is None or self.exclusion(robot, now_ns) is not None:
                continue
            record = self._book.find(step.task)
            if record is None or record.task.robots > 1:
                continue
            if self._eligibility.wait_reason(record, now_ns, left_s + step.travel_s) is not None:
                continue
            if self._eligibility.unfit_reason(record, robot) is not None:
                continue
            after = "" if not bound or bound[0].own else bound[0].task.id
            if after and left_s > LATEST_S and self._plan.problem.asked_ns < self._ending_ns.get(name, 0):
                continue  # a new plan for this is in progress
            if self._backoff.pause_reason(step.task, name, now_ns) is None:
                yield Due(step.task, name, after)

    def ends_soon(self, before: RobotState | None, state: RobotState, now_ns: int) -> None:
        """If a robot is newly about to end its task, check the plan before the next offer, which then stands."""
        if state.task is not None and is_ending(state) and not is_ending(before) and self.has_route(state.robot):
            self._ending_ns[state.robot] = now_ns
            self._cause = self._cause or f"{state.robot} is about to end {state.task.id}"

    @property
    def has_teamwork(self) -> bool:
        """Whether a task for several robots waits for them."""
        return any(record.task.robots > 1 and record.state is TaskState.QUEUED for record in self._builder.records())

    def due_together(self, now_ns: int) -> Iterator[tuple[str, list[str]]]:
        """Each task for several robots that all its planned robots can begin now, with their names."""
        robots: dict[str, list[str]] = {}
        for name in sorted(self._plan.steps) if self._plan is not None else ():
            step, robot, at = self._to_offer(name), self._roster.robots.get(name), self._book.of_robot(name)
            is_free = at is None or (at.own and at.task.kind == EXPLORE)
            if step is not None and robot is not None and is_free and self.exclusion(robot, now_ns) is None:
                robots.setdefault(step.task, []).append(name)
        for task_id, names in robots.items():
            record = self._book.find(task_id)
            if record is None or not len(names) == record.task.robots > 1:
                continue
            if self._eligibility.wait_reason(record, now_ns, 0.0) is None:
                yield task_id, names

    def begun(self, task_id: str, robot: str) -> None:
        """Record that a planned task was offered and accepted."""
        self._inputs.begun(task_id, robot)

    def is_reserved(self, robot: str, now_ns: int) -> bool:
        """Whether a robot has a task soon and must not be sent elsewhere."""
        if robot in self.held:
            return True
        step = self._next(robot)
        return step is not None and step.leave_ns - now_ns < SOON_NS

    def has_unplanned(self) -> bool:
        """Whether a plan is expected that may use any robot, so that none must be sent elsewhere."""
        if not (self._cause or self._planner.is_busy or self._costs.is_waiting):
            return False
        known = set() if self._plan is None else {step.task for steps in self._plan.steps.values() for step in steps}
        known |= self.left_out.keys() | self.waiting.keys()
        return any(
            record.task.id not in known for record in self._builder.records() if record.state is TaskState.QUEUED
        )

    def has_route(self, robot: str) -> bool:
        """Whether the plan has tasks for a robot that it has not begun."""
        return self._next(robot) is not None

    def to_charge(self) -> set[str]:
        """Robots that the plan has charge before the next task that they have not begun."""
        names = () if self._plan is None else self._plan.charging
        return {name for name in names if self.has_route(name) and self._to_offer(name) is None}

    def route_energy_j(self, robot: str) -> float | None:
        """Energy of a robot's planned route, joules; None if it has none that it has not begun."""
        return self._plan.route_energy_j.get(robot) if self._plan is not None and self.has_route(robot) else None

    def waits_for_charge(self, task_id: str) -> str:
        """The robot that will do a queued task after its charge; empty if the task waits for no charge."""
        steps = {} if self._plan is None else self._plan.steps
        for robot in self.after_charge:
            if any(step.task == task_id for step in steps.get(robot, ())):
                return robot
        return ""

    def charger_distances_m(self, robot: str) -> ChargerDistances | None:
        """Path lengths from a robot to its chargers, when it was last planned for."""
        return None if self._plan is None else self._plan.charger_distances.get(robot)

    def _to_offer(self, robot: str) -> PlannedStep | None:
        """The next task of a robot; None if it has none or has to charge first."""
        step = self._next(robot)
        return None if step is None or step.charge_s > 0 else step

    def _next(self, robot: str) -> PlannedStep | None:
        steps = self._plan.steps.get(robot, ()) if self._plan is not None else ()
        for step in steps:
            if not step.has_begun and self._is_queued(step.task):
                return step
        return None

    # -- publishing -----------------------------------------------------------------------------------------

    def exclusion(self, robot: Robot, now_ns: int) -> RobotReason | None:
        """Why plans exclude a robot now; None if they do not."""
        return exclusion(robot, self._book.of_robot(robot.name), now_ns) or self.held.get(robot.name)

    @property
    def number(self) -> int:
        """Number of the present plan; 0 if there is none."""
        return 0 if self._plan is None else self._plan.problem.plan

    def queued_reason(self, task_id: str, now_ns: int) -> TaskReason | None:
        """The plan's decision about a queued task; None if it has none."""
        if task_id in self.left_out:
            return PlanLeavesOut(self.left_out[task_id].reason)
        if task_id in self.waiting:
            return self.waiting[task_id]
        for robot, steps in self._plan.steps.items() if self._plan is not None else ():
            for position, step in enumerate(steps):
                if step.task == task_id:
                    after = self.after_charge.get(robot)
                    times = self.forecast.times.get(task_id)
                    in_s = max(0.0, to_seconds((step.leave_ns if times is None else times.leave_ns) - now_ns))
                    text = f"{robot} is to set out for it in {in_s:.0f} s"
                    charges = any(one.charge_s and not one.has_begun for one in steps[: position + 1])
                    if after is None and not charges:
                        return plain("to_begin", text, robot=robot, in_s=in_s)
                    to_soc = CHARGED_SOC if after is None else after.soc
                    text += f", when it has charged to {to_soc:.0%}"
                    return plain("to_begin", text, robot=robot, in_s=in_s, to_soc=to_soc)
        failure = self._planner.failure_reason
        return plain("no_plan", f"no plan can be made: {cut(failure)}") if failure else None

    def anybody_out(self, now_ns: int) -> bool:
        """Whether plans exclude a robot of the team now."""
        return any(
            robot.has_token and self.exclusion(robot, now_ns) is not None for robot in self._roster.robots.values()
        )

    def status(self) -> PlanningStatus:
        """The present state of planning."""
        plan = self._plan
        places = {charger.place for known in self.chargers.of.values() for charger in known}
        return PlanningStatus(
            objective=self.policy.objective,
            method=self.policy.method,
            plans=self._number,
            planned=sum(len(tasks) for tasks in self._orders().values()),
            skipped=len(self.left_out),
            duration_s=0.0 if plan is None else round(plan.duration_s, 4),
            chargers=tuple(sorted(places, key=lambda place: (place.x_m, place.y_m))),
            charges=self.charges,
        )

    def _choose(self, request: Request[ObjectiveRequest]) -> PlanningStatus:
        asked = request.asked
        if asked.objective is not self.policy.objective:
            logger.info("plans are for %s from now on%s", asked.objective, f", says {asked.by}" if asked.by else "")
            policy = msgspec.structs.replace(self.policy, objective=asked.objective)
            self.set_policy(policy, f"plans are for {asked.objective} now")
        return self.status()

    def set_policy(self, policy: PlanningPolicy, cause: str) -> None:
        """Plan with other parameters from now on; `cause` is that of the next plan."""
        self.policy = policy
        self.forecast.time_margin = policy.time_margin
        self._cause = cause
        self._not_before_ns = 0

    def _orders(self) -> dict[str, tuple[str, ...]]:
        orders = {}
        for robot, tasks in ({} if self._plan is None else self._plan.orders).items():
            if left := tuple(filter(self._is_queued, tasks)):
                orders[robot] = left
        return orders

    def _is_queued(self, task_id: str) -> bool:
        record = self._book.find(task_id)
        return record is not None and record.state is TaskState.QUEUED


def _availability(state: RobotState) -> tuple[bool, bool, bool, bool]:
    charging = state.battery is not None and state.battery.charging
    return state.pose is None, state.halted, state.behavior in HOMEWARD or bool(state.lost), charging


def _planner_of(wire: Endpoint) -> "LivePlanner | LockstepPlanner":
    if wire.drive is Drive.LIVE:
        return LivePlanner(lambda: _wake(wire))
    # Here: it imports the allocators, which live planning keeps in another process.
    from robrain.coordinator.planning.plan_search import LockstepPlanner

    return LockstepPlanner()


def _wake(wire: Endpoint) -> None:
    if wire.on_receive is not None:
        wire.on_receive()
