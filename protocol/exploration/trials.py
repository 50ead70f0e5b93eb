"""Where robots were, where they failed, and which frontiers are not worth another attempt."""

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robrain.protocol.model.geometry import Point2D

if TYPE_CHECKING:
    from robrain.protocol.model.mapping.occupancy_grid import OccupancyGrid

SAME_M = 0.6
"""Attempts within this distance of each other are attempts at one place."""
LOOK_M = 0.6
"""Robots judge a frontier by the unknown cells within 0.5 m of it; this adds the edge."""
VISIT, FAILURE, GIVEN_UP = 2, 1, 6
"""Weights of the attempts at a place, and the sum without a gain at which it is given up (chosen): a robot that failed
may have been blocked for a moment."""
LOST_SHARE = 0.2
"""Share of the cells around a place that become unknown again before a robot is sent there again (chosen)."""
PITCH_M = 0.5
"""Places within one square of this size are kept as one."""
KEPT = 256
KEPT_BEEN = 16_384


class Trials:
    """Remembers a bounded number of places; the oldest are forgotten."""

    def __init__(self) -> None:
        self._failures: deque[tuple[Point2D, int]] = deque(maxlen=KEPT)
        self._been: dict[tuple[int, int], Point2D] = {}

    @property
    def failures(self) -> list[tuple[Point2D, int]]:
        """Places that robots failed to get to, arena frame, with the number of failures there."""
        return list(self._failures)

    @property
    def been(self) -> list[Point2D]:
        """Places where robots were, arena frame."""
        return list(self._been.values())

    def note_failure(self, place: Point2D) -> None:
        """Record that a robot failed to get to a place."""
        tries = 0
        for known in list(self._failures):
            if known[0].distance_m(place) < SAME_M:
                self._failures.remove(known)
                tries = max(tries, known[1])
        self._failures.append((place, tries + 1))

    def note_been(self, place: Point2D) -> None:
        """Record that a robot was at a place."""
        cell = round(place.x_m / PITCH_M), round(place.y_m / PITCH_M)
        self._been.pop(cell, None)
        self._been[cell] = place
        if len(self._been) > KEPT_BEEN:
            del self._been[next(iter(self._been))]


class _Attempts(NamedTuple):
    place: Point2D
    unknown: int
    """Unknown cells around the place after the first of these attempts."""
    weight: int


class Attempts:
    """Remembers a bounded number of attempts at frontiers, and what was unknown around each.

    A frontier inside of furniture moves by some cells whenever the map changes. Places within `SAME_M` therefore count
    as one place, and attempts at it are in vain while the unknown around it does not become less.
    """

    def __init__(self) -> None:
        self._visited: dict[Point2D, int] = {}
        self._places: deque[_Attempts] = deque(maxlen=KEPT)
        self._in_vain: list[_Attempts] = []

    def note_visit(self, place: Point2D, grid: "OccupancyGrid") -> None:
        """Record that a robot was at a frontier."""
        self._visited = {known: self._visited[known] for known in self.visited(grid)}
        self._visited[place] = unknown_around(grid, place)
        self._note(place, grid, VISIT)

    def note_failure(self, place: Point2D, grid: "OccupancyGrid") -> None:
        """Record that a robot failed to get to a frontier."""
        self._note(place, grid, FAILURE)

    def _note(self, place: Point2D, grid: "OccupancyGrid", weight: int) -> None:
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
    """Whether no more has been seen around a place since, and little has become unknown again."""
    lost_max = LOST_SHARE * (2 * round(LOOK_M / grid.geometry.resolution_m) + 1) ** 2
    return 0 <= unknown_around(grid, attempts.place) - attempts.unknown <= lost_max


def unknown_around(grid: "OccupancyGrid", place: Point2D) -> int:
    """Number of cells around a place that nobody has seen."""
    row, column = grid.geometry.cell_of(place.x_m, place.y_m)
    reach = round(LOOK_M / grid.geometry.resolution_m)
    box = np.s_[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
    return int(np.count_nonzero(grid.log_odds[box] == 0))
