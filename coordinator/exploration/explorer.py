"""The explorer: finds the frontiers of the team's map and hands each idle robot its own."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robrain.coordinator.exploration.assignment import Candidate, Choice, Seeker, assign_frontiers
from robrain.coordinator.roster import Robot
from robrain.coordinator.team_map import TeamMap
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.clock import to_ns

if TYPE_CHECKING:
    from robrain.protocol.model.navigation import NavigationGrid
    from robrain.protocol.model.occupancy_grid import OccupancyGrid

MARGIN_M = 0.08
SHUN_NS = to_ns(15.0)
LOOK_M = 0.6
"""Robots call a frontier done by what is unknown within 0.5 m of it, and its edge."""


class _Failure(NamedTuple):
    robot: str
    place: Point2D
    until_ns: int


class Explorer:
    """Chooses goals; remembers for a while which robot failed where."""

    def __init__(self, team_map: TeamMap) -> None:
        self.candidates: list[Candidate] = []
        """The frontiers of the map as it was last looked at."""
        self._map = team_map
        self._navigation: NavigationGrid | None = None
        self._version = 0
        self._failures: list[_Failure] = []
        self._vain: tuple[int, float, list[Seeker], list[Point2D]] | None = None
        """What was last asked with nothing found: the same question has the same answer."""
        self._visited: dict[Point2D, int] = {}
        """What was unknown around each frontier when a robot had been there, in cells."""

    def note_failure(self, robot: str, place: Point2D, now_ns: int) -> None:
        """A robot could not get to a place: others may, it shuns the place for a while."""
        self._failures.append(_Failure(robot, place, now_ns + SHUN_NS))

    def note_visit(self, place: Point2D) -> None:
        """A robot has been at a place: what it has not seen of the unknown there, nobody will, as the map stands."""
        grid = self._map.grid
        if grid is not None:
            self._visited = {place: cells for place, cells in self._visited.items() if self._is_spent(place)}
            self._visited[place] = _unknown_around(grid, place)
            self._vain = None

    @property
    def has_failures(self) -> bool:
        """Whether some robot shuns some place at the moment."""
        return bool(self._failures)

    def choose(self, idle: list[Robot], taken: list[Point2D], now_ns: int) -> list[Choice]:
        """Goals for the idle robots.

        Args:
            idle: robots without a task.
            taken: goals of the others.
            now_ns: the time of the run.

        """
        self._failures = [failure for failure in self._failures if failure.until_ns > now_ns]
        needed_m = MARGIN_M + max((robot.state.radius_m for robot in idle if robot.state is not None), default=0.0)
        seekers = [
            Seeker(robot.name, Point2D(robot.state.pose.x_m, robot.state.pose.y_m), self._shunned(robot.name))
            for robot in idle
            if robot.state is not None and robot.state.pose is not None
        ]
        question = (self._map.version, needed_m, seekers, taken)
        if question == self._vain:
            return []
        navigation = self._look(needed_m)
        if navigation is None:
            return []
        candidates = [candidate for candidate in self.candidates if not self._is_spent(candidate.place)]
        choices = assign_frontiers(navigation, candidates, seekers, taken)
        self._vain = None if choices else question
        return choices

    def _look(self, needed_m: float) -> "NavigationGrid | None":
        grid = self._map.grid
        if grid is None:
            return None
        # Here: they bring the map's kernels, which a coordinator loads when it is up (coordinator/live.py).
        from robrain.protocol.model.frontier import find_frontiers
        from robrain.protocol.model.navigation import NavigationGrid

        known = self._navigation
        if known is None or self._version != grid.version or known.needed_m != needed_m:
            self._version = grid.version
            classes = grid.classes()
            if known is None or known.needed_m != needed_m:
                self._navigation = known = NavigationGrid(classes, grid.geometry, needed_m)
            else:
                known.update(classes)
            self.candidates = [
                Candidate(grid.geometry.center_of(found.row, found.column), found.cells * grid.geometry.resolution_m)
                for found in find_frontiers(classes)
            ]
        return known

    def _is_spent(self, place: Point2D) -> bool:
        """Whether a robot has been at a place, and nobody has seen more there since."""
        before = self._visited.get(place)
        return before is not None and self._map.grid is not None and before == _unknown_around(self._map.grid, place)

    def _shunned(self, robot: str) -> tuple[Point2D, ...]:
        return tuple(failure.place for failure in self._failures if failure.robot == robot)


def _unknown_around(grid: "OccupancyGrid", place: Point2D) -> int:
    """How many of the cells around a place nobody has seen."""
    row, column = grid.geometry.cell_of(place.x_m, place.y_m)
    reach = round(LOOK_M / grid.geometry.resolution_m)
    box = np.s_[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
    return int(np.count_nonzero(grid.log_odds[box] == 0))
