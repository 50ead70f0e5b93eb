"""Which robots explore, where they are sent, and why others get no frontier."""

import math
from collections.abc import Sequence

from robrain.algorithms.exploration.explorer import Explorer, Scout
from robrain.algorithms.exploration.situation import Busy, Choice
from robrain.algorithms.exploration.strategies import NO_EXPLORATION
from robrain.coordinator.charging.explorer_reach import reach_m
from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.tasks.backoff import TaskBackoff
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.team.roster import Robot, Roster
from robrain.coordinator.team.team_map import TeamMap
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import EXPLORE
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import IdleReason, LacksRange, plain

SETTLED_NS = to_ns(3.0)
"""The floor counts as explored when for this long no robot could be given a frontier."""
GAP = "gap_m"
"""Key in a task's result: width of the gap that the robot did not fit through."""

EXPLORATION_OFF = plain("exploration_off", "idle because the team explores only if a task tells it to")
PLAN_PENDING = plain("plan_pending", "idle because tasks are being planned")
TASK_SOON = plain("task_soon", "idle because its next task begins soon")


class FrontierDesk:
    """Decides which frontier each robot that may explore is sent to.

    Args:
        explorer: has the floor that is unknown, and the strategy.
        team_map: what the team knows.
        tasks: who has which task.
        roster: the robots.
        planning: which robots are kept for tasks.
        backoff: which robots rest.
        now_ns: the time.

    """

    def __init__(
        self,
        explorer: Explorer,
        team_map: TeamMap,
        tasks: TaskBook,
        roster: Roster,
        planning: Planning,
        backoff: TaskBackoff,
        now_ns: int,
    ) -> None:
        self._explorer, self._team_map, self._tasks, self._roster = explorer, team_map, tasks, roster
        self._planning, self._backoff = planning, backoff
        self._kept_idle: dict[str, IdleReason] = {}
        """Why idle robots were not considered for a frontier, by name."""
        self._revise_due_ns = 0
        self._busy_ns = now_ns

    def choose(self, up: list[Robot], idle: Sequence[Robot], now_ns: int) -> list[Choice]:
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
        why, names = PLAN_PENDING if is_unplanned else TASK_SOON, {robot.name for robot in free}
        self._kept_idle = {robot.name: why for robot in idle if robot.name not in names}
        paused = {robot.name for robot in free if pauses.why(robot.name, now_ns)}
        scouts = [self._scout(robot) for robot in free if robot.name not in paused]
        under_way = self._active_goals(up, now_ns)
        scouts += [self._scout(self._roster.robots[name], goal) for name, goal in under_way.items()]
        bound = [record for record in self._tasks.open if record.robot and record.robot not in under_way]
        busy = [Busy(self._place_of(record), record.task.place) for record in bound]
        choices = self._explorer.choose(scouts, busy, now_ns) if scouts else []
        is_busy = bool(choices or paused or bound or under_way) or self._explorer.has_failures
        # A team whose robots are all lost has not explored what it cannot get to.
        is_lost = all(robot.state is None or robot.state.lost for robot in up)
        if is_busy or is_lost or not self._team_map.version:
            self._busy_ns = now_ns
        return choices

    @property
    def lack_range(self) -> set[str]:
        """Robots that get no frontier for lack of energy."""
        return {name for name, why in self._explorer.idle.items() if isinstance(why, LacksRange)}

    def idle_reasons(self) -> dict[str, IdleReason]:
        """Why each robot that was looked at got no frontier."""
        return {**self._explorer.idle, **self._kept_idle}

    def is_settled(self, now_ns: int) -> bool:
        """Whether nothing is left to explore: for a while no robot could be given a frontier."""
        return self._team_map.version > 0 and now_ns - self._busy_ns > SETTLED_NS

    def record_end(self, robot: str, task: Task, status: TaskStatus, now_ns: int) -> None:
        """A robot's task has ended: its place counts as visited, or as one that cannot be reached for a while."""
        if status.state is TaskState.FAILED:
            self._explorer.record_failure(robot, task.place, now_ns)
            self._record_gap(robot, status, now_ns)
        elif task.kind == EXPLORE:
            self._explorer.record_visit(task.place)

    def record_refusal(self, robot: str, task: Task, now_ns: int) -> None:
        """A robot has refused a frontier."""
        self._explorer.record_failure(robot, task.place, now_ns)

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

    def _active_goals(self, up: list[Robot], now_ns: int) -> dict[str, Point2D]:
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
            if bound[0].task.kind == EXPLORE and not self._backoff.robots.why(robot.name, now_ns):
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
            self._explorer.record_gap(Point2D(pose.x_m, pose.y_m), status.result[GAP], now_ns)
