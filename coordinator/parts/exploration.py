"""Exploration: the robots that explore, their goals, the reasons of the others, and the remaining regions."""

import math
from collections.abc import Mapping, Sequence
from operator import attrgetter

from msgspec.structs import replace

from robrain.algorithms.exploration import reach
from robrain.algorithms.exploration.explorer import Explorer, Scout
from robrain.algorithms.exploration.situation import Busy, Choice
from robrain.algorithms.exploration.strategies import NO_EXPLORATION, Strategy, strategy_of
from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.team.roster import Robot
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.maps.map_messages import COORDINATOR_LEFT, COORDINATOR_LEFT_NOW, ExplorationLeft
from robrain.protocol.messages.robots.robot_messages import RobotState, TaskStatus
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.messages.team.team_messages import FrontierSummary, TeamState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.tasks.stock_kinds import EXPLORE
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import IdleReason, LacksRange, OfferRefusal, PositionLost, plain
from robrain.protocol.wire.endpoint import Serve

SHOWN_FRONTIERS = 64
EXPLORATION_OFF = plain("exploration_off", "idle because the team explores only if a task tells it to")
PLAN_PENDING = plain("plan_pending", "idle because tasks are being planned")
TASK_SOON = plain("task_soon", "idle because its next task begins soon")
SETTLED_NS = to_ns(3.0)
"""The floor counts as explored when for this long no robot could be given a frontier."""
GAP = "gap_m"
"""Key in a task's result: width of the gap that the robot did not fit through."""
REMAINING_PERIOD_NS = to_ns(5.0)
"""Shortest time between two checks of the map; each takes some tens of milliseconds."""

CHANGED_M2, CHANGED_SHARE = 0.5, 0.1
"""A region is published again when its area has changed by more than both (chosen)."""


class Exploration(CoordinatorPart):
    """Decides which frontier each robot that may explore is sent to.

    Args:
        core: the team.

    """

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self.explorer = Explorer(core.team_map, self._strategy(core.planning.policy))
        self._team_map, self._tasks, self._roster = core.team_map, core.tasks, core.roster
        self._planning, self._backoff = core.planning, core.lifecycle.backoff
        self._kept_idle: dict[str, IdleReason] = {}
        """Why idle robots were not considered for a frontier, by name."""
        self._revise_due_ns = 0
        self._busy_ns = core.wire.clock.now_ns()
        self._is_reported = False
        self._publisher = core.wire.publisher(COORDINATOR_LEFT)
        self._published: ExplorationLeft | None = None
        self._checked_version = 0
        """Of the map in which remaining regions were last searched."""
        self._remaining_due_ns = 0
        core.wire.answer(COORDINATOR_LEFT_NOW, lambda _request: self._remaining(), serve=Serve.IN_STEP)

    def policy_changed(self, policy: PlanningPolicy) -> None:
        """Explore by another strategy."""
        self.explorer.strategy = self._strategy(policy)

    def assign(self, robots: Sequence[Robot], now_ns: int) -> None:
        """Send robots to frontiers."""
        choices = self.choose(robots, self.core.idle(robots), now_ns)
        self._planning.lack_range = {
            name for name, reason in self.explorer.idle.items() if isinstance(reason, LacksRange)
        }

        def explore(choice: Choice) -> None:
            task = Task(id=self.core.new_id("explore"), kind=EXPLORE, place=choice.place)
            self.core.offer_own(task, choice.robot, now_ns)

        self.core.guard.records(choices, explore, attrgetter("robot"), "frontier")

    def summary(self, state: TeamState, now_ns: int) -> TeamState:
        """Add the frontiers, and whether exploration has ended."""
        self._is_reported = self.is_settled(now_ns)
        frontiers = [
            FrontierSummary(place=found.place, length_m=found.length_m)
            for found in self.explorer.candidates[:SHOWN_FRONTIERS]
        ]
        return replace(state, frontiers=frontiers, all_explored=self._is_reported)

    def reported(self, now_ns: int) -> None:
        """Once exploration has ended, publish the remaining regions, and again whenever they have changed much."""
        version = self._team_map.version
        if self._is_reported and version != self._checked_version and now_ns >= self._remaining_due_ns:
            self._remaining_due_ns = now_ns + REMAINING_PERIOD_NS
            self._checked_version = version
            left = self._remaining()
            if left is not None and (self._published is None or _differ(left, self._published)):
                self._publish(left)

    def publish_remaining(self) -> ExplorationLeft | None:
        """Publish the remaining regions if they have changed; returns them, None before anything is known."""
        left = self._remaining()
        if left is not None and left != self._published:
            self._publish(left)
        return left

    def _publish(self, left: ExplorationLeft) -> None:
        self._published = left
        self._publisher.put(left)

    def _remaining(self) -> ExplorationLeft | None:
        """Regions that remain to explore; the floor around lost robots counts as reached."""
        return self.explorer.left([scout for robot in self._roster.robots.values() if (scout := _last_known(robot))])

    def task_ended(self, record: TaskRecord, robot: str, status: TaskStatus, now_ns: int) -> None:
        """The place of a task counts as visited, or as one that cannot be reached for a while."""
        task = record.task
        if status.state is TaskState.FAILED:
            self.explorer.record_failure(robot, task.place, now_ns)
            self._record_gap(robot, status, now_ns)
        elif task.kind == EXPLORE:
            self.explorer.record_visit(task.place)

    def task_refused(self, record: TaskRecord, robot: str, refusal: OfferRefusal, now_ns: int) -> None:
        """A robot may have refused a frontier."""
        if record.task.kind == EXPLORE and not record.by and not isinstance(refusal, PositionLost):
            self.explorer.record_failure(robot, record.task.place, now_ns)

    def _strategy(self, policy: PlanningPolicy) -> Strategy:
        def record(name: str, failure: str) -> None:
            self.core.wire.refusals.record_failure("exploration_strategy", name, failure)

        return strategy_of(policy.exploration, record)

    def choose(self, up: Sequence[Robot], idle: Sequence[Robot], now_ns: int) -> list[Choice]:
        """A frontier for each robot that gets one, or another one than it has.

        Args:
            up: the robots that may act.
            idle: those without a task.
            now_ns: the time.

        """
        if self._planning.policy.exploration == NO_EXPLORATION:
            self._kept_idle, self._busy_ns = {robot.name: EXPLORATION_OFF for robot in idle}, now_ns
            return []
        pauses, is_unplanned = self._backoff.robots, self._planning.has_unplanned()
        free = [robot for robot in idle if not (is_unplanned or self._planning.is_reserved(robot.name, now_ns))]
        reason, names = PLAN_PENDING if is_unplanned else TASK_SOON, {robot.name for robot in free}
        self._kept_idle = {robot.name: reason for robot in idle if robot.name not in names}
        paused = {robot.name for robot in free if pauses.pause_reason(robot.name, now_ns)}
        scouts = [self._scout(robot) for robot in free if robot.name not in paused]
        active = self._active_goals(up, now_ns)
        scouts += [self._scout(self._roster.robots[name], goal) for name, goal in active.items()]
        bound = [record for record in self._tasks.open if record.robot and record.robot not in active]
        busy = [Busy(self._place_of(record), record.task.place) for record in bound]
        choices = self.explorer.choose(scouts, busy, now_ns) if scouts else []
        is_busy = bool(choices or paused or bound or active) or self.explorer.has_failures
        # A team whose robots are all lost has not explored the regions that it cannot reach.
        is_lost = all(robot.state is None or robot.state.lost for robot in up)
        if is_busy or is_lost or not self._team_map.version:
            self._busy_ns = now_ns
        return choices

    def idle_reasons(self) -> Mapping[str, IdleReason]:
        """Why each robot that was considered got no frontier."""
        return {**self.explorer.idle, **self._kept_idle}

    def is_settled(self, now_ns: int) -> bool:
        """Whether nothing is left to explore: for a while no robot could be given a frontier."""
        return self._team_map.version > 0 and now_ns - self._busy_ns > SETTLED_NS

    def _scout(self, robot: Robot, goal: Point2D | None = None) -> Scout:
        assert robot.state is not None
        pose = robot.state.pose
        homes = tuple(charger.place for charger in self._planning.chargers.of.get(robot.name, ()))
        return Scout(
            robot.name,
            None if pose is None else Point2D(pose.x_m, pose.y_m),
            robot.state.radius_m,
            goal,
            reach_m(robot.state, self._planning.policy) if homes else math.inf,
            homes,
        )

    def _active_goals(self, up: Sequence[Robot], now_ns: int) -> dict[str, Point2D]:
        """Goals of the robots that explore and may get another, by name, if it is time to revise goals.

        A robot that is alone keeps its goal, since no other robot can explore it first.
        """
        period_s = self._planning.policy.revise_s
        if not period_s or now_ns < self._revise_due_ns or len(up) < 2:
            return {}
        self._revise_due_ns = now_ns + to_ns(period_s)
        goals = {}
        for robot in up:
            bound = self._tasks.bound_to(robot.name)
            if len(bound) != 1 or bound[0].state is not TaskState.RUNNING or not bound[0].own:
                continue
            if bound[0].task.kind == EXPLORE and not self._backoff.robots.pause_reason(robot.name, now_ns):
                goals[robot.name] = bound[0].task.place
        return goals

    def _place_of(self, record: TaskRecord) -> Point2D:
        """Where the robot of a record is; the task's place if that is unknown."""
        robot = self._roster.robots.get(record.robot)
        pose = robot.state.pose if robot is not None and robot.state is not None else None
        return record.task.place if pose is None else Point2D(pose.x_m, pose.y_m)

    def _record_gap(self, robot: str, status: TaskStatus, now_ns: int) -> None:
        """Record the gap that a robot failed to pass, if its result contains one."""
        known = self._roster.robots.get(robot)
        pose = known.state.pose if known is not None and known.state is not None else None
        if pose is not None and GAP in status.result:
            self.explorer.record_gap(Point2D(pose.x_m, pose.y_m), status.result[GAP], now_ns)


def _differ(one: ExplorationLeft, other: ExplorationLeft) -> bool:
    """Whether regions have come or gone, are left for another reason, or have grown or shrunk much."""
    if [region.kind for region in one.regions] != [region.kind for region in other.regions]:
        return True
    return any(
        abs(now.area_m2 - before.area_m2) > max(CHANGED_M2, CHANGED_SHARE * before.area_m2)
        for now, before in zip(one.regions, other.regions, strict=True)
    )


def _last_known(robot: Robot) -> Scout | None:
    """A robot with its last known place; None if it has never published its state."""
    state = robot.state
    if state is None:
        return None
    place = None if state.pose is None or state.frame != ARENA else Point2D(state.pose.x_m, state.pose.y_m)
    return Scout(robot.name, place, state.radius_m)


def reach_m(state: RobotState, policy: PlanningPolicy) -> float:
    """Length of path that a robot can surely drive and keep its reserve, metres (`algorithms/exploration/reach.py`)."""
    reserve_share, confidence = policy.reserve_share, policy.confidence
    return reach.reach_m(state.energy, state.battery, reserve_share=reserve_share, confidence=confidence)
