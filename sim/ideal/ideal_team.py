"""A team of points at top speed that explores a floor with exact poses, one shared map and no communication.

It uses the same grid, scan evidence, frontiers, strategies and path planning as the full stack, and nothing else, so
the difference between both is what motion, localisation, mapping and messages cost.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.exploration.explorer import Explorer, Scout
from robrain.algorithms.exploration.situation import Busy
from robrain.algorithms.exploration.strategies import Strategy
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.mapping.ray_cast import cast_rays_of
from robrain.algorithms.navigation.clearance import PREFERRED_MARGIN_M, least_clearance_m, mapped_clearance_m
from robrain.algorithms.navigation.frontier import MIN_CELLS, frontier_mask
from robrain.algorithms.navigation.navigation_grid import NavigationGrid
from robrain.algorithms.navigation.path_planning import standpoint
from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.robot.lidar import LidarSpec
from robrain.sim.world.referee import floor_weights, team_geometry

SPEED_M_S = 0.6
"""Top speed, as of the stock driver."""
SNAP_M = 0.8
LOOK_M = 1.5
"""A frontier is looked at from no farther away, as by the stock explore behavior."""
SEEN_M = 0.5
"""A goal is reached when no frontier remains within this distance of it."""
REPLAN_S = 2.0
NOBODY = np.empty((0, 3))


class _Point:
    """A robot."""

    def __init__(self, name: str, start: Pose2D) -> None:
        self.name = name
        self.x_m, self.y_m, self.yaw_rad = start.x_m, start.y_m, start.yaw_rad
        self.goal: Point2D | None = None
        self.path: list[Point2D] = []
        self.planned_s = -math.inf
        self.distance_m = 0.0
        self.standing_s = 0.0

    @property
    def place(self) -> Point2D:
        return Point2D(self.x_m, self.y_m)

    def drive(self, step_s: float) -> None:
        left_m = SPEED_M_S * step_s
        if not self.path:
            self.standing_s += step_s
        while self.path and left_m > 0:
            to = self.path[0]
            away_m = math.hypot(to.x_m - self.x_m, to.y_m - self.y_m)
            step_m = min(left_m, away_m)
            share = step_m / away_m if away_m else 1.0
            self.x_m += share * (to.x_m - self.x_m)
            self.y_m += share * (to.y_m - self.y_m)
            self.distance_m += step_m
            left_m -= step_m
            if step_m == away_m:
                self.path.pop(0)


class IdealTeam:
    """Steps once per turn of the lidars.

    Args:
        plan: the true floor.
        starts: where the robots start, arena frame.
        radius_m: of each robot.
        lidar: of each robot.
        strategy: which robot is sent to which frontier.
        revise_s: period in which robots may be given another goal; 0: they keep theirs.
        rng: draws the lidars' noise.

    """

    def __init__(
        self,
        plan: FloorPlan,
        starts: Sequence[Pose2D],
        radius_m: float,
        lidar: LidarSpec,
        strategy: Strategy,
        revise_s: float,
        rng: np.random.Generator,
    ) -> None:
        self.grid = OccupancyGrid(team_geometry(plan))
        self.robots = [_Point(f"r{number}", start) for number, start in enumerate(starts, 1)]
        self.time_s = 0.0
        self._explorer = Explorer(self, strategy)
        self._radius_m = radius_m
        self._lidar = lidar
        self._angles_rad = np.linspace(-math.pi, math.pi, lidar.rays, endpoint=False)
        self._walls = plan.occupied.copy()  # writable: a read-only array would be copied for every scan
        height, width = plan.occupied.shape
        self._geometry = GridGeometry(plan.resolution_m, plan.origin_x_m, plan.origin_y_m, width, height)
        self._rng = rng
        places = [robot.place for robot in self.robots]
        self._weights = floor_weights(plan, places, least_clearance_m(radius_m), self.grid.geometry)
        self._total = int(self._weights.sum())
        self._revise_s, self._revise_due_s = revise_s, 0.0
        self._grids: dict[bool, tuple[NavigationGrid, int]] = {}
        """By whether narrow places are included, with the map's version."""
        self._scan()

    @property
    def version(self) -> int:
        """Of the shared map."""
        return self.grid.version

    @property
    def explored_fraction(self) -> float:
        """Share of the reachable floor that is known, 0 to 1."""
        return int(self._weights[self.grid.known()].sum()) / self._total

    @property
    def is_at_work(self) -> bool:
        """Whether a robot has a goal."""
        return any(robot.goal is not None for robot in self.robots)

    def step(self) -> None:
        """Decide, drive and look."""
        self._finish_goals()
        self._hand_out()
        step_s = 1.0 / self._lidar.rate_hz
        for robot in self.robots:
            if robot.goal is not None and (not robot.path or self.time_s - robot.planned_s >= REPLAN_S):
                self._plan(robot, robot.goal)
            robot.drive(step_s)
        self.time_s += step_s
        self._scan()

    def _scan(self) -> None:
        lidar = self._lidar
        for robot in self.robots:
            pose = Pose2D(robot.x_m, robot.y_m, robot.yaw_rad)
            ranges_m = cast_rays_of(self._walls, self._geometry, pose, self._angles_rad, lidar.range_max_m, NOBODY)
            noisy_m = ranges_m + lidar.noise_m * self._rng.standard_normal(lidar.rays)
            noisy_m[(ranges_m >= lidar.range_max_m) | (noisy_m >= lidar.range_max_m)] = math.inf
            stamp_ms = round(1000.0 * self.time_s)
            self.grid.integrate_scan(pose, self._angles_rad, noisy_m, lidar.range_max_m, stamp_ms, NOBODY)

    def _finish_goals(self) -> None:
        classes = None
        for robot in self.robots:
            if robot.goal is None:
                continue
            classes = self.grid.classes() if classes is None else classes
            is_there = not robot.path and robot.planned_s >= 0
            if is_there or self._is_seen(classes, robot.goal):
                self._explorer.record_visit(robot.goal)
                robot.goal, robot.path = None, []

    def _is_seen(self, classes: NDArray[np.int8], goal: Point2D) -> bool:
        row, column = self.grid.geometry.cell_of(goal.x_m, goal.y_m)
        reach = round(SEEN_M / self.grid.geometry.resolution_m) + 1
        box = classes[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
        return int(np.count_nonzero(frontier_mask(box)[1:-1, 1:-1])) < MIN_CELLS

    def _hand_out(self) -> None:
        is_due = bool(self._revise_s) and self.time_s >= self._revise_due_s and len(self.robots) > 1
        if is_due:
            self._revise_due_s = self.time_s + self._revise_s
        scouts = [
            Scout(robot.name, robot.place, self._radius_m, robot.goal)
            for robot in self.robots
            if is_due or robot.goal is None
        ]
        if not scouts:
            return
        names = {scout.name for scout in scouts}
        busy = [
            Busy(robot.place, robot.goal) for robot in self.robots if robot.goal is not None and robot.name not in names
        ]
        now_ns = to_ns(self.time_s)
        by_name = {robot.name: robot for robot in self.robots}
        for choice in self._explorer.choose(scouts, busy, now_ns):
            robot = by_name[choice.robot]
            if not self._plan(robot, choice.place):
                self._explorer.record_failure(robot.name, choice.place, now_ns)

    def _plan(self, robot: _Point, goal: Point2D) -> bool:
        """Set out for a place from which the goal can be seen; False, and nothing changes, if there is no path."""
        for is_narrow in (False, True):
            grid = self._navigation(is_narrow=is_narrow)
            reach = round(LOOK_M / grid.geometry.resolution_m)
            classes = self.grid.classes()
            cell = standpoint(classes, grid.traversable, grid.geometry.cell_of(goal.x_m, goal.y_m), reach)
            place = goal if cell is None else grid.geometry.center_of(*cell)
            path = grid.path(robot.place, place, snap_m=SNAP_M)
            if path is not None:
                robot.goal, robot.path, robot.planned_s = goal, path, self.time_s
                return True
        return False

    def _navigation(self, *, is_narrow: bool) -> NavigationGrid:
        known, version = self._grids.get(is_narrow, (None, -1))
        classes, geometry = self.grid.classes(), self.grid.geometry
        if known is None:
            preferred_m = self._radius_m + PREFERRED_MARGIN_M
            least_m = min(preferred_m, mapped_clearance_m(self._radius_m, geometry.resolution_m))
            known = NavigationGrid(classes, geometry, least_m if is_narrow else preferred_m, None, preferred_m)
        elif version != self.grid.version:
            known.update(classes)
        self._grids[is_narrow] = known, self.grid.version
        return known
