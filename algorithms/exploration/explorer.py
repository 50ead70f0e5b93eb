"""The explorer: finds the frontiers of the team's map and hands each idle robot its own."""

import math
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.exploration.narrow_passages import KEPT, NarrowPassages, Tried, record_tried
from robrain.algorithms.exploration.situation import (
    SAME_GOAL_M,
    Busy,
    Choice,
    FrontierCandidate,
    FrontierFields,
    FrontierPaths,
    Seeker,
    Situation,
    is_avoided,
)
from robrain.algorithms.exploration.strategies import Strategy, joint
from robrain.algorithms.navigation.clearance import PREFERRED_MARGIN_M, least_gap_m, mapped_gap_cells
from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.reasons import IdleReason, LacksRange, NothingUnknown, borders_text, plain

if TYPE_CHECKING:
    from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
    from robrain.algorithms.navigation.frontier import Frontier
    from robrain.algorithms.navigation.navigation_grid import NavigationGrid
    from robrain.protocol.messages.maps.map_messages import ExplorationLeft
    from robrain.protocol.model.grid_geometry import GridGeometry


SAME_M = 0.6
"""Attempts within this distance of each other are attempts at one place."""
AROUND_M = 0.6
"""Robots judge a frontier by the unknown cells within 0.5 m of it; this adds the edge."""
VISIT, FAILURE, GIVEN_UP = 2, 1, 6
"""Weights of the attempts at a place, and the sum without a gain at which the place is given up (chosen). A robot that
failed may have been blocked for a moment."""
LOST_SHARE = 0.2
"""Share of the cells around a place that become unknown again before a robot is sent there again (chosen)."""
PITCH_M = 0.5
"""Places within one square of this size are kept as one."""
KEPT_BEEN = 16_384


class _Attempts(NamedTuple):
    place: Point2D
    unknown: int
    """Unknown cells around the place after the first of these attempts."""
    weight: int


class Attempts:
    """Remembers a bounded number of attempts at frontiers, and the unknown floor around each.

    A frontier inside of furniture moves by some cells whenever the map changes. Places within `SAME_M` therefore count
    as one place, and attempts at it are in vain while the unknown around it does not become less.
    """

    def __init__(self) -> None:
        self._visited: dict[Point2D, int] = {}
        self._places: deque[_Attempts] = deque(maxlen=KEPT)
        self._in_vain: list[_Attempts] = []

    def record_visit(self, place: Point2D, grid: "OccupancyGrid") -> None:
        """Record that a robot was at a frontier."""
        self._visited = {known: self._visited[known] for known in self.visited(grid)}
        self._visited[place] = unknown_around(grid, place)
        self._record(place, grid, VISIT)

    def record_failure(self, place: Point2D, grid: "OccupancyGrid") -> None:
        """Record that a robot failed to get to a frontier."""
        self._record(place, grid, FAILURE)

    def _record(self, place: Point2D, grid: "OccupancyGrid", weight: int) -> None:
        known = next((one for one in self._places if one.place.distance_m(place) < SAME_M), None)
        if known is not None:
            self._places.remove(known)
        if known is None or not _is_unchanged(known, grid):
            known = _Attempts(place, unknown_around(grid, place), 0)
        self._places.append(known._replace(weight=known.weight + weight))
        self._in_vain = [one for one in self._places if one.weight >= GIVEN_UP]

    def visited(self, grid: "OccupancyGrid") -> list[Point2D]:
        """Frontiers at which a robot was, while the unknown around them is as it was then."""
        return [place for place, cells in self._visited.items() if cells == unknown_around(grid, place)]

    def is_spent(self, place: Point2D, grid: "OccupancyGrid") -> bool:
        """Whether a frontier is given up, or the unknown around it is as it was when a robot was there."""
        cells = self._visited.get(place)
        if cells is not None and cells == unknown_around(grid, place):
            return True
        return bool(self._in_vain) and self.is_given_up(place, grid)

    def is_given_up(self, place: Point2D, grid: "OccupancyGrid") -> bool:
        """Whether attempts at a frontier were in vain, and the map has not changed there since."""
        return any(one.place.distance_m(place) < SAME_M and _is_unchanged(one, grid) for one in self._in_vain)


def _is_unchanged(attempts: _Attempts, grid: "OccupancyGrid") -> bool:
    """Whether nothing new has been seen around a place since, and little has become unknown again."""
    lost_max = LOST_SHARE * (2 * round(AROUND_M / grid.geometry.resolution_m) + 1) ** 2
    return 0 <= unknown_around(grid, attempts.place) - attempts.unknown <= lost_max


def unknown_around(grid: "OccupancyGrid", place: Point2D) -> int:
    """Number of unseen cells around a place."""
    row, column = grid.geometry.cell_of(place.x_m, place.y_m)
    reach = round(AROUND_M / grid.geometry.resolution_m)
    box = np.s_[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
    return int(np.count_nonzero(grid.log_odds[box] == 0))


NARROW_CHECK_NS = to_ns(2.0)
"""Period of the search for narrow paths for idle robots; each search takes some milliseconds."""
GAP_M = (0.0, 10.0)
"""Plausible range of a gap's width reported by a robot."""
AVOID_NS = to_ns(15.0)
BEYOND_M = 2.0
"""Unknown floor within this distance of a frontier, by rows and columns, is the frontier's expected gain."""


class KnownFloor(Protocol):
    """Knowledge about the floor; the coordinator's `TeamMap` is one implementation."""

    @property
    def grid(self) -> "OccupancyGrid | None":
        """The map; None before anything is known."""
        ...

    @property
    def version(self) -> int:
        """Grows whenever the class of a cell changes; 0 while nothing is known."""
        ...


class Scout(NamedTuple):
    """A robot that can explore."""

    name: str
    place: Point2D | None
    """Its place, arena frame; None if it is unknown."""
    radius_m: float
    goal: Point2D | None = None
    """The frontier to which it drives."""
    reach_m: float = math.inf
    """Length of path that its energy lasts for, with the reserve kept."""
    homes: tuple[Point2D, ...] = ()
    """Its chargers; without one it may go as far as there is a path."""


class _Failure(NamedTuple):
    robot: str
    place: Point2D
    until_ns: int


class _Question(NamedTuple):
    version: int
    needed_m: float
    seekers: list[Seeker]
    claimed: list[Point2D]


class Explorer:
    """Chooses goals; remembers for a while which robot failed where.

    Args:
        team_map: knowledge about the floor.
        strategy: which robot is sent to which frontier.

    """

    def __init__(self, team_map: KnownFloor, strategy: Strategy = joint) -> None:
        self.strategy = strategy
        self.candidates: list[FrontierCandidate] = []
        """The frontiers of the map at the last check."""
        self._map = team_map
        self._navigation: NavigationGrid | None = None
        self._version = 0
        self._failures: list[_Failure] = []
        self._vain: _Question | None = None
        """The last question without a result: the same question has the same answer."""
        self._attempts = Attempts()
        self.idle: dict[str, IdleReason] = {}
        """Reason why each robot got no goal at the last decision."""
        self._fields = FrontierFields()
        self._narrow = NarrowPassages()
        self._narrow_due_ns = 0
        self._narrow_goals: set[Point2D] = set()
        """Goals to which robots were sent along narrow paths."""
        self._tried: deque[Tried] = deque(maxlen=KEPT)
        self._been: dict[tuple[int, int], Point2D] = {}
        self._seen_again: set[Point2D] = set()
        """Frontiers to which robots were sent when no others remained."""

    def record_failure(self, robot: str, place: Point2D, now_ns: int) -> None:
        """A robot could not get to a place: others may, it shuns the place for a while."""
        self._failures.append(_Failure(robot, place, now_ns + AVOID_NS))
        record_tried(self._tried, place)
        if self._map.grid is not None:
            self._attempts.record_failure(place, self._map.grid)
        if place in self._narrow_goals:
            self._narrow_goals.remove(place)
            self._narrow.record_failure(place)

    def record_gap(self, place: Point2D, gap_m: object, now_ns: int) -> None:
        """A robot at `place` does not fit through a gap of this width; implausible widths are ignored."""
        if isinstance(gap_m, float | int) and GAP_M[0] < gap_m < GAP_M[1]:
            self._narrow.record_gap(place, float(gap_m), now_ns + AVOID_NS)
            self._vain = None

    def record_visit(self, place: Point2D) -> None:
        """A robot has been at a place: floor that it did not see there stays unseen on the present map."""
        self._narrow_goals.discard(place)
        grid = self._map.grid
        if grid is not None:
            self._attempts.record_visit(place, grid)
            self._vain = None

    def _record_place(self, place: Point2D) -> None:
        """Record that a robot was at a place; of too many places the oldest are forgotten."""
        cell = round(place.x_m / PITCH_M), round(place.y_m / PITCH_M)
        self._been.pop(cell, None)
        self._been[cell] = place
        if len(self._been) > KEPT_BEEN:
            del self._been[next(iter(self._been))]

    @property
    def has_failures(self) -> bool:
        """Whether some robot shuns some place at the moment."""
        return bool(self._failures)

    def choose(self, scouts: Sequence[Scout], busy: Sequence[Busy], now_ns: int) -> list[Choice]:
        """Frontiers for robots.

        Args:
            scouts: robots without a task, and robots under way to a frontier whose goal may be changed.
            busy: the other robots that are bound for a place.
            now_ns: the time of the run.

        Returns: New goals; robots that keep theirs are omitted.

        """
        self._failures = [failure for failure in self._failures if failure.until_ns > now_ns]
        radius_m = max((scout.radius_m for scout in scouts if scout.place is not None), default=0.0)
        needed_m = PREFERRED_MARGIN_M + radius_m
        narrow = [scout for scout in scouts if scout.goal in self._narrow_goals]
        busy = [*busy, *(Busy(scout.place or scout.goal, scout.goal) for scout in narrow if scout.goal is not None)]
        seekers = [
            Seeker(
                scout.name,
                scout.place,
                tuple(one.place for one in self._failures if one.robot == scout.name),
                scout.goal,
                scout.reach_m,
                scout.homes,
            )
            for scout in scouts
            if scout.place is not None and scout not in narrow
        ]
        question = _Question(self._map.version, needed_m, seekers, [robot.goal for robot in busy])
        if question == self._vain:
            return []
        self.idle = {
            name: reason for name, reason in self.idle.items() if any(name == seeker.name for seeker in seekers)
        }
        self.idle |= {
            scout.name: plain("place_unknown", "idle because its position is unknown")
            for scout in scouts
            if scout.place is None
        }
        grid, navigation = self._map.grid, self._check(needed_m)
        if grid is None or navigation is None:
            return []
        # Here: it brings the map's kernels, as in `_check`.
        from robrain.algorithms.exploration.map_survey import MapSurvey

        candidates = [candidate for candidate in self.candidates if not self._attempts.is_spent(candidate.place, grid)]
        survey = MapSurvey(grid, [candidate.place for candidate in candidates])
        paths = FrontierPaths(navigation, candidates)
        between = self._fields.costs_between(paths, navigation, now_ns)
        situation = Situation(candidates, seekers, busy, paths.costs_m, costs_between=between, floor=survey)
        choices = _changed(self.strategy(situation), seekers)
        chosen = {choice.robot for choice in choices}
        left = [seeker for seeker in seekers if seeker.name not in chosen and seeker.goal is None]
        is_narrow_due = bool(left) and now_ns >= self._narrow_due_ns
        if is_narrow_due:
            self._narrow_due_ns = now_ns + NARROW_CHECK_NS
            bound = [Busy(choice.place, choice.place) for choice in choices]
            choices += self._squeeze(candidates, left, [*busy, *bound], radius_m, now_ns)
        for choice in choices:
            self.idle.pop(choice.robot, None)
            self._record_place(next(seeker.place for seeker in seekers if seeker.name == choice.robot))
        self._vain = None if choices or not is_narrow_due else question
        return choices

    def left(self, robots: Sequence[Scout]) -> "ExplorationLeft | None":
        """Regions that remain if exploration ends now; None before anything is known.

        Takes some tens of milliseconds.

        Args:
            robots: all robots of the team.

        """
        grid = self._map.grid
        if grid is None:
            return None
        from robrain.algorithms.exploration.remaining_regions import Evidence, exploration_left

        known = [robot.place for robot in robots if robot.place is not None]
        evidence = Evidence(
            robots=known,
            radius_m=min((robot.radius_m for robot in robots), default=0.0),
            gaps=list(self._narrow.gaps),
            failures=list(self._tried),
            been=list(self._been.values()),
            spent=self._attempts.visited(grid),
        )
        return exploration_left(grid.classes(), grid.geometry, evidence)

    def _squeeze(
        self, candidates: list[FrontierCandidate], seekers: list[Seeker], busy: list[Busy], radius_m: float, now_ns: int
    ) -> list[Choice]:
        """Choose goals along narrow paths for robots without any other; set `idle` for those that get none."""
        grid = self._map.grid
        if grid is None:
            self.idle |= {seeker.name: NothingUnknown() for seeker in seekers}
            return []
        navigation = self._narrow.navigation(grid, radius_m, PREFERRED_MARGIN_M + radius_m)
        shut = self._narrow.shut(now_ns)
        choices = self._along_narrow(navigation, candidates, seekers, busy, shut)
        if not choices and not (candidates and busy):
            choices = self._along_narrow(navigation, self._last(grid, navigation, radius_m), seekers, busy, shut)
            self._seen_again |= {choice.place for choice in choices}
        self._narrow_goals |= {choice.place for choice in choices}
        paths = FrontierPaths(navigation, candidates, shut)
        for seeker in seekers:
            reached = np.isfinite(paths.costs_m(seeker.place)).tolist() if candidates else []
            within = [candidate for candidate, is_reached in zip(candidates, reached, strict=True) if is_reached]
            too_far = Situation(candidates, [seeker], [], paths.costs_m).too_far
            if too_far.any() and too_far.sum() == len(within):
                self.idle[seeker.name] = LacksRange(frontiers=len(within), reach_m=seeker.reach_m)
            else:
                self.idle[seeker.name] = self._idle_reason(seeker, candidates, within, radius_m)
        return choices

    def _along_narrow(
        self,
        navigation: "NavigationGrid",
        candidates: list[FrontierCandidate],
        seekers: list[Seeker],
        busy: list[Busy],
        shut: list[tuple[float, float, float]],
    ) -> list[Choice]:
        claimed = {robot.goal for robot in busy}
        open_to = [one for one in candidates if one.place not in claimed and not self._narrow.is_given_up(one.place)]
        if not open_to:
            return []
        paths = FrontierPaths(navigation, open_to, shut)
        return self.strategy(Situation(open_to, seekers, busy, paths.costs_m, is_narrow=True))

    def _last(self, grid: "OccupancyGrid", navigation: "NavigationGrid", radius_m: float) -> list[FrontierCandidate]:
        """Frontiers that a robot may enter, for use when no others remain: short ones, and visited ones once more.

        Behind a bend of the narrowest passable corridor, the length of the frontier is only the width of the corridor
        on the map. A visited frontier may have been observed from too far away.
        """
        from robrain.algorithms.navigation.frontier import MIN_CELLS, find_frontiers

        least = min(MIN_CELLS, mapped_gap_cells(radius_m, grid.geometry.resolution_m))
        classes, near_m = grid.classes(), grid.geometry.resolution_m
        found = [_candidate(classes, grid.geometry, one) for one in find_frontiers(classes, min_cells=least)]
        return [
            one
            for one in found
            if navigation.snap(one.place, near_m)
            and not self._attempts.is_given_up(one.place, grid)
            and not (one.place in self._seen_again and self._attempts.is_spent(one.place, grid))
        ]

    def _idle_reason(
        self, seeker: Seeker, candidates: list[FrontierCandidate], within: list[FrontierCandidate], radius_m: float
    ) -> IdleReason:
        """Reason why a robot has nothing to explore, given its reachable frontiers."""
        if not candidates:
            return NothingUnknown()
        tried = [one for one in within if is_avoided(one, seeker) or self._narrow.is_given_up(one.place)]
        if len(tried) < len(within):
            borders = len(within) - len(tried)
            text = f"idle because other robots go to {borders_text(borders)}"
            return plain("others_explore", text, frontiers=borders)
        needed_m, borders = round(least_gap_m(radius_m), 3), len(tried or candidates)
        named = borders_text(borders)
        if self._narrow.gaps:
            gap = min(self._narrow.gaps, key=lambda gap: gap.place.distance_m(seeker.place))
            gap_m, place = round(gap.gap_m, 3), gap.place
            text = (
                f"idle because the way to {named} is {gap_m:.2f} m wide at x {place.x_m:.1f}, y {place.y_m:.1f} and "
                f"the robot needs {needed_m:.2f} m"
            )
            values = {"needed_m": needed_m, "gap_m": gap_m, "x_m": place.x_m, "y_m": place.y_m}
            return plain("too_narrow", text, frontiers=borders, **values)
        if tried:
            text = f"idle because it has just tried without success to get to {named}"
            return plain("tried_in_vain", text, frontiers=borders)
        text = f"idle because no way of at least {needed_m:.2f} m leads to {named}"
        return plain("no_way", text, frontiers=borders, needed_m=needed_m)

    def _check(self, needed_m: float) -> "NavigationGrid | None":
        grid = self._map.grid
        if grid is None:
            return None
        # Here: they bring the map's kernels, which a coordinator loads when it is up (coordinator/live.py).
        from robrain.algorithms.navigation.frontier import find_frontiers
        from robrain.algorithms.navigation.navigation_grid import NavigationGrid

        known = self._navigation
        if known is None or self._version != grid.version or known.needed_m != needed_m:
            self._version = grid.version
            classes = grid.classes()
            if known is None or known.needed_m != needed_m:
                self._navigation = known = NavigationGrid(classes, grid.geometry, needed_m)
            else:
                known.update(classes)
            self.candidates = [_candidate(classes, grid.geometry, found) for found in find_frontiers(classes)]
        return known


def _changed(choices: list[Choice], seekers: Sequence[Seeker]) -> list[Choice]:
    """The choices that give a robot another goal than it has."""
    goals = {seeker.name: seeker.goal for seeker in seekers}
    return [
        choice
        for choice in choices
        if (goal := goals[choice.robot]) is None or choice.place.distance_m(goal) > SAME_GOAL_M
    ]


def _candidate(classes: NDArray[np.int8], geometry: "GridGeometry", found: "Frontier") -> FrontierCandidate:
    from robrain.algorithms.navigation.frontier import unknown_beyond

    reach = round(BEYOND_M / geometry.resolution_m)
    unknown_m2 = unknown_beyond(classes, found.row, found.column, reach) * geometry.resolution_m**2
    place = geometry.center_of(found.row, found.column)
    return FrontierCandidate(place, found.cells * geometry.resolution_m, unknown_m2)
