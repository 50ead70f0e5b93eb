"""Explore: goes to the frontier that the coordinator hands out, until there is nothing unknown left around it.

Without a coordinator the robot chooses the nearest frontier for itself (Yamauchi 1997).
"""

import msgspec
import numpy as np

from robrain.agent.plugin import Behavior, external
from robrain.plugins.skill.localisation.interface import LocalisationInterface
from robrain.plugins.skill.mapper.interface import MapperInterface, MapView
from robrain.plugins.skill.planner.interface import Circle, PlannerInterface
from robrain.plugins.unit.driver.interface import DriverInterface
from robrain.plugins.unit.teammates.interface import TeammatesInterface
from robrain.protocol.model.frontier import find_frontiers, frontier_mask
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.task import Explore, TaskState
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.messages import PlannedPath, TaskAnswer
from robrain.protocol.wire.topics import ROBOT_PATH

MATE_NEAR_M = 2.5
"""Teammates farther away than this are not planned around: they will have moved."""
OWN_CHOICES = 12


class ExploreBehavior(Behavior):
    """Explores one frontier after the other."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """When a frontier counts as explored, and how long the robot bears with obstacles."""

        seen_radius_m: float = 0.5
        """A goal is done when no frontier is left within this distance of it."""
        arrived_m: float = 0.3
        replan_s: float = 2.0
        replan_blocked_s: float = 0.5
        """As long as something stands in the way, another way is looked for this often."""
        patience_s: float = 3.0
        """After standing before an obstacle this long the robot gives the task back."""
        alone_s: float = 3.0
        """With no word from a coordinator for this long the robot chooses for itself."""
        mate_margin_m: float = 0.15

    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        self._task: Explore | None = None
        self._path: list[Point2D] = []
        self._planned_ns = 0
        self._own_choices = 0

    def activate(self) -> None:
        self._driver = self.env.use("driver", DriverInterface)
        self._teammates = self.env.use("teammates", TeammatesInterface)
        self._localisation = self.env.use("localisation", LocalisationInterface)
        self._mapper = self.env.use("mapper", MapperInterface)
        self._planner = self.env.use("planner", PlannerInterface)
        self._paths = self.env.wire.publisher(ROBOT_PATH, robot=self.env.robot)
        self.env.do_tasks(Explore, self._accept, self._let_go)
        self.env.board.behavior = "idle"
        self._started_ns = self.env.clock.now_ns()

    def deactivate(self) -> None:
        self._let_go("deactivated")

    def emergency_halt(self) -> None:
        self._task = None
        self._path = []
        self.env.board.behavior = "halted"

    @external
    def goal(self) -> Point2D | None:
        """The frontier that the robot is after; null if none."""
        return None if self._task is None else self._task.goal

    def step(self) -> None:
        view, pose = self._mapper.view(), self._localisation.pose()
        if self._task is None and self._is_alone():
            self._choose(view, pose)
        if self._task is not None:
            self._pursue(self._task, view, pose)

    # -- deciding -------------------------------------------------------------------------------------------

    def _pursue(self, task: Explore, view: MapView, pose: Pose2D) -> None:
        if self._is_seen(view, task.goal):
            self._finish(TaskState.DONE, "nothing unknown is left there")
        elif self._path and pose.distance_m(self._path[-1]) < self.parameters.arrived_m:
            self._finish(TaskState.DONE, "arrived")
        elif self._driver.blocked_s() > self.parameters.patience_s:
            self._finish(TaskState.FAILED, "the way is blocked")
        elif self._must_replan() and not self._replan(task, view, pose):
            self._finish(TaskState.FAILED, "no way there")

    def _must_replan(self) -> bool:
        since_ns = self.env.clock.now_ns() - self._planned_ns
        if not self._path or since_ns > to_ns(self.parameters.replan_s):
            return True
        # The driver has stopped before something that was not on the map when the path was planned.
        return self._driver.blocked_s() > 0 and since_ns > to_ns(self.parameters.replan_blocked_s)

    def _replan(self, task: Explore, view: MapView, pose: Pose2D) -> bool:
        start = Point2D(pose.x_m, pose.y_m)
        path = self._planner.plan(view, start, task.goal, self._circles(pose))
        self._planned_ns = self.env.clock.now_ns()
        if path is None:
            return False
        self._follow(path)
        return True

    def _circles(self, pose: Pose2D) -> list[Circle]:
        own_radius_m = self._driver.radius_m()
        return [
            (mate.pose.x_m, mate.pose.y_m, own_radius_m + mate.radius_m + self.parameters.mate_margin_m)
            for mate in self._teammates.others()
            if pose.distance_m(mate.pose) < MATE_NEAR_M
        ]

    def _is_seen(self, view: MapView, goal: Point2D) -> bool:
        geometry = view.geometry
        row, column = geometry.cell_of(goal.x_m, goal.y_m)
        reach = round(self.parameters.seen_radius_m / geometry.resolution_m)
        # One cell more around, because whether a cell is a frontier depends on its neighbours.
        rows = slice(max(row - reach - 1, 0), row + reach + 2)
        columns = slice(max(column - reach - 1, 0), column + reach + 2)
        return not bool(np.any(frontier_mask(view.classes[rows, columns])[1:-1, 1:-1]))

    def _is_alone(self) -> bool:
        heard_ns = self.env.tasks.coordinator_heard_ns
        since_ns = self.env.clock.now_ns() - (self._started_ns if heard_ns is None else heard_ns)
        return since_ns > to_ns(self.parameters.alone_s)

    def _choose(self, view: MapView, pose: Pose2D) -> None:
        start = Point2D(pose.x_m, pose.y_m)
        frontiers = [view.geometry.center_of(found.row, found.column) for found in find_frontiers(view.classes)]
        frontiers.sort(key=pose.distance_m)
        for goal in frontiers[:OWN_CHOICES]:
            path = self._planner.plan(view, start, goal, self._circles(pose))
            if path is not None:
                self._own_choices += 1
                self._task = Explore(id=f"own-{self.env.robot}-{self._own_choices}", goal=goal)
                self._planned_ns = self.env.clock.now_ns()
                self.env.board.behavior = "explore alone"
                self._follow(path)
                return

    # -- acting ---------------------------------------------------------------------------------------------

    def _accept(self, task: Explore) -> TaskAnswer:
        view, pose = self._mapper.view(), self._localisation.pose()
        before = self._task
        self._task = task
        if not self._replan(task, view, pose):
            self._task = before
            return TaskAnswer(accepted=False, why="no way there")
        self.env.board.behavior = "explore"
        return TaskAnswer(accepted=True)

    def _let_go(self, _why: str) -> None:
        self._task = None
        self._stand()

    def _finish(self, state: TaskState, why: str) -> None:
        task, self._task = self._task, None
        if state is TaskState.FAILED:
            self._stand()
        if task is not None:
            self.env.tasks.end(task.id, state, why)
        self.env.board.behavior = "idle"

    def _follow(self, path: list[Point2D]) -> None:
        self._path = path
        self._driver.follow(self._localisation.to_odom(path))
        self._paths.put(PlannedPath(robot=self.env.robot, points=path))

    def _stand(self) -> None:
        self._path = []
        self._driver.stop()
        self.env.board.behavior = "idle"
        self._paths.put(PlannedPath(robot=self.env.robot, points=[]))
