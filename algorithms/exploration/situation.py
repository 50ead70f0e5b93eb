"""Input of an exploration strategy: frontiers, robots, and the paths between them.

Imports no kernels: a coordinator loads them once it is up.
"""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Point2D

if TYPE_CHECKING:
    from robrain.algorithms.exploration.map_survey import MapSurvey
    from robrain.algorithms.navigation.navigation_grid import NavigationGrid, PathField

AVOID_RADIUS_M = 1.0
"""A robot that avoids a place is sent to no frontier within this distance of it."""

SAME_GOAL_M = 1.0
"""A frontier within this distance of a robot's goal counts as that goal on the present map."""
HOME_DETOUR = 1.5
"""Assumed ratio of path length to straight line on the way home where the map shows no path (chosen; robots assume the
same)."""
KEEP_M = 3.0
"""Path cost by which that frontier counts as nearer, so that a goal is not changed for little."""


class FrontierCandidate(NamedTuple):
    """A frontier that might be handed out."""

    place: Point2D
    length_m: float
    unknown_m2: float = 0.0
    """Unknown area beyond it, as far as a robot there may see of it at once."""


class Seeker(NamedTuple):
    """A robot that can be sent to a frontier."""

    name: str
    place: Point2D
    avoided: tuple[Point2D, ...] = ()
    """Places that it could not get to a short while ago."""
    goal: Point2D | None = None
    """The frontier to which it drives; None if it is idle."""
    reach_m: float = math.inf
    """Length of path that its energy lasts for, with the reserve kept."""
    homes: tuple[Point2D, ...] = ()
    """Its chargers: a frontier counts as reached only if its energy suffices for the path there and on to one of them.
    """


class Busy(NamedTuple):
    """A robot that keeps its goal."""

    place: Point2D
    goal: Point2D


class Choice(NamedTuple):
    """A robot and its assigned frontier."""

    robot: str
    place: Point2D
    cost_m: float
    is_narrow: bool = False
    """Whether the path passes places with less than the preferred clearance."""


PathCosts = Callable[[Point2D], NDArray[np.float64]]
"""Path cost from a place to each frontier, (frontiers,), metres of open floor; inf where there is no path."""


class Situation:
    """Input of a strategy; read-only.

    Args:
        candidates: the frontiers.
        seekers: the robots to send.
        busy: the robots that keep their goals.
        path_costs: computes path costs from a place to the frontiers.
        is_narrow: whether paths may have less than the preferred clearance; copied into each choice.
        costs_between: the same between frontiers, where a little age does no harm; None: `path_costs`.
        floor: features of the map beside the paths; None: the whole floor is one room.

    """

    def __init__(
        self,
        candidates: Sequence[FrontierCandidate],
        seekers: Sequence[Seeker],
        busy: Sequence[Busy],
        path_costs: PathCosts,
        *,
        is_narrow: bool = False,
        costs_between: PathCosts | None = None,
        floor: "MapSurvey | None" = None,
    ) -> None:
        self.candidates = tuple(candidates)
        self.seekers = tuple(seekers)
        self.busy = tuple(busy)
        self.is_narrow = is_narrow
        self.floor = floor
        self._path_costs = path_costs
        self._costs_between = path_costs if costs_between is None else costs_between

    @cached_property
    def paths_m(self) -> NDArray[np.float64]:
        """Path costs (seekers, frontiers), metres of open floor; inf where there is no path, or the robot avoids it.

        Also inf where the robot's energy does not suffice for the path there and home. The frontier to which a robot
        drives counts as `KEEP_M` nearer.
        """
        paths_m = self._from([seeker.place for seeker in self.seekers])
        paths_m[self.too_far] = math.inf
        for row, seeker in enumerate(self.seekers):
            if seeker.goal is not None and (column := self.column_of(seeker.goal)) is not None:
                paths_m[row, column] = max(0.0, paths_m[row, column] - KEEP_M)
        for row, seeker in enumerate(self.seekers):
            for column, candidate in enumerate(self.candidates if seeker.avoided else ()):
                if is_avoided(candidate, seeker):
                    paths_m[row, column] = math.inf
        return _frozen(paths_m)

    @cached_property
    def too_far(self) -> NDArray[np.bool_]:
        """Whether a robot's energy does not suffice for the path to a frontier and home, (seekers, frontiers).

        Path costs count as lengths; they are at least as long. Frontiers without a path are not too far.
        """
        too_far = np.zeros((len(self.seekers), len(self.candidates)), np.bool_)
        if not self.candidates:
            return too_far
        for row, seeker in enumerate(self.seekers):
            if seeker.homes and math.isfinite(seeker.reach_m):
                paths_m = np.asarray(self._path_costs(seeker.place))
                too_far[row] = np.isfinite(paths_m) & (paths_m + self._home_m(seeker.homes) > seeker.reach_m)
        return too_far

    def _home_m(self, homes: tuple[Point2D, ...]) -> NDArray[np.float64]:
        """Path cost from each frontier to the nearest home, (frontiers,); a straight line and half of it if unknown."""
        least_m = np.full(len(self.candidates), math.inf)
        for home in homes:
            away_m = np.array([HOME_DETOUR * candidate.place.distance_m(home) for candidate in self.candidates])
            paths_m = np.asarray(self._path_costs(home))
            least_m = np.minimum(least_m, np.where(np.isfinite(paths_m), paths_m, away_m))
        return least_m

    @cached_property
    def busy_paths_m(self) -> NDArray[np.float64]:
        """Path costs (busy robots, frontiers), from where the robots are."""
        return _frozen(self._from([robot.place for robot in self.busy]))

    @cached_property
    def goal_paths_m(self) -> NDArray[np.float64]:
        """Path costs (busy robots, frontiers), from the robots' goals."""
        return _frozen(self._from([robot.goal for robot in self.busy]))

    @cached_property
    def between_m(self) -> NDArray[np.float64]:
        """Path costs (frontiers, frontiers), the less of both directions; 0 on the diagonal."""
        return _frozen(self.between(range(len(self.candidates))))

    def between(self, columns: Sequence[int]) -> NDArray[np.float64]:
        """Path costs (columns, columns) between some of the frontiers, the less of both directions; 0 on the diagonal.

        Each row may be some seconds old, as `costs_between` gives it.
        """
        one_path_m = np.full((len(columns), len(columns)), np.inf)
        for row, column in enumerate(columns):
            one_path_m[row] = self._costs_between(self.candidates[column].place)[list(columns)]
        between_m: NDArray[np.float64] = np.minimum(one_path_m, one_path_m.T)
        np.fill_diagonal(between_m, 0.0)
        return between_m

    def column_of(self, goal: Point2D) -> int | None:
        """The number of the frontier that is a robot's goal as the map is now; None if there is none there any more."""
        away_m = [candidate.place.distance_m(goal) for candidate in self.candidates]
        column = min(range(len(away_m)), key=away_m.__getitem__, default=None)
        return column if column is not None and away_m[column] < SAME_GOAL_M else None

    def choice(self, row: int, column: int, cost_m: float | None = None) -> Choice:
        """The choice of a frontier for a seeker, by their numbers; its cost is the path's unless it is given."""
        cost_m = float(self.paths_m[row, column] if cost_m is None else cost_m)
        return Choice(self.seekers[row].name, self.candidates[column].place, cost_m, self.is_narrow)

    def _from(self, places: Sequence[Point2D]) -> NDArray[np.float64]:
        paths_m = np.full((len(places), len(self.candidates)), np.inf)
        for row, place in enumerate(places if self.candidates else ()):
            paths_m[row] = self._path_costs(place)
        return paths_m


def is_avoided(candidate: FrontierCandidate, seeker: Seeker) -> bool:
    """Whether a robot must not be sent to a frontier now."""
    return any(candidate.place.distance_m(place) < AVOID_RADIUS_M for place in seeker.avoided)


def _frozen(array: NDArray[np.float64]) -> NDArray[np.float64]:
    array.setflags(write=False)
    return array


SNAP_M = 0.8
"""Greatest distance of a path's ends from the robot and from the frontier."""
FIELD_KEPT_NS = to_ns(5.0)
"""Costs between frontiers are computed again after this long (chosen: little changes far from the robots)."""


class FrontierPaths:
    """Path costs on one map, each place computed once.

    Args:
        navigation: the team's map.
        candidates: frontiers.
        shut: circles (x, y, radius in metres) whose narrow places are impassable.

    """

    def __init__(
        self,
        navigation: "NavigationGrid",
        candidates: Sequence[FrontierCandidate],
        shut: Sequence[tuple[float, float, float]] = (),
    ) -> None:
        self._navigation = navigation
        self._shut = shut
        cells = [navigation.snap(candidate.place, SNAP_M) for candidate in candidates]
        self._columns = [column for column, cell in enumerate(cells) if cell is not None]
        self._cells = [cell for cell in cells if cell is not None]
        self.count = len(cells)
        """Number of frontiers."""
        self._known: dict[Point2D, NDArray[np.float64]] = {}

    def costs_m(self, place: Point2D) -> NDArray[np.float64]:
        """Path cost from a place to each frontier, (frontiers,), metres of open floor; inf where there is no path."""
        paths_m = self._known.get(place)
        if paths_m is None:
            paths_m = np.full(self.count, np.inf)
            paths_m[self._columns] = self._navigation.costs_m(place, self._cells, snap_m=SNAP_M, shut=self._shut)
            self._known[place] = paths_m
        return paths_m

    def costs_along(self, field: "PathField") -> NDArray[np.float64]:
        """Path costs to each frontier from where a field was computed, (frontiers,)."""
        paths_m = np.full(self.count, np.inf)
        paths_m[self._columns] = field.to(self._cells)
        return paths_m


class FrontierFields:
    """Path costs from frontiers to everywhere, each kept for some seconds while the frontier is there.

    Otherwise the costs between frontiers would be most of the time of a decision. A new frontier has a new field. A
    path between older frontiers that has closed counts as open until their fields are due.
    """

    def __init__(self) -> None:
        self._fields: dict[Point2D, tuple[int, PathField | None]] = {}
        self._navigation: NavigationGrid | None = None

    def costs_between(self, paths: FrontierPaths, navigation: "NavigationGrid", now_ns: int) -> PathCosts:
        """A function that gives the path costs from a frontier to all frontiers, (frontiers,)."""
        known = {} if navigation is not self._navigation else self._fields
        self._navigation = navigation
        self._fields = {place: one for place, one in known.items() if now_ns - one[0] <= FIELD_KEPT_NS}
        used = self._fields

        def costs_m(place: Point2D) -> NDArray[np.float64]:
            if place not in used:
                used[place] = now_ns, navigation.cost_field(place, snap_m=SNAP_M)
            field = used[place][1]
            return paths.costs_along(field) if field is not None else np.full(paths.count, np.inf)

        return costs_m
