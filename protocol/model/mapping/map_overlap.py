"""How two maps lie to each other that were made in different frames, found from the walls that both show.

The walls about a place of one map are looked for on the other map; each answer is refined and held against all that
either map knows: walls of one that are floor on the other speak against it (Birk, Carpin, *Merging occupancy grid maps
from multiple robots*, Proceedings of the IEEE 94(7), 2006).
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.kernel_array import INT8, kernel_array
from robrain.protocol.model.mapping.place_search import search_places
from robrain.protocol.model.occupancy_grid import OccupancyGrid
from robrain.protocol.model.scan_match import match_walls
from robrain.protocol.model.scan_match_kernels import distance_window
from robrain.protocol.model.small_linear_algebra import least_solution

ABOUT_M = 8.0
"""Walls within this distance of a place are looked for."""
WALLS_MIN = 60
"""With fewer wall cells there a place is not looked for."""
SEARCH_WALLS = 120
"""Number of these wall cells that the search uses."""
REFINE_WALLS = 600
"""Number of these wall cells that the refinement uses."""
PLACES = 512
TRIED, TRY_WALLS = 100, 200
"""Number of places that are tried, and of wall cells used for each."""
REFINED = 8
"""Number of the best places tried that are refined."""
REACHES_M = (0.4, 0.4, 0.2)
WHOLE_WALLS = 1500
WHOLE_REACH_M = 0.4
APART_M, APART_RAD = 0.5, 0.2
"""Answers that differ by less are one."""
NEAR_CELLS = 2.3
"""Walls of both maps that are this near to each other are the same wall."""
CLUSTER_MIN = 4
"""Least number of connected cells for a contradiction: single cells are noise of the lidar."""
BODY_MARGIN_M = 0.3
"""Cells within this distance of a robot's hull may show the robot."""
NOBODY = np.empty((0, 3))
AGREES_MIN = 0.995
"""Share of the compared wall cells that must agree. Measured on six floors: where maps truly overlap, 155 of 169
answers have no cluster of contradicting cells; at wrong places of floors that repeat themselves 1.4 to 16 % do."""
COMMON_MIN = 80
"""Wall cells that must be the same: 8 m of wall at 0.1 m."""
CONTRADICTION = 2.0
"""Number of agreeing wall cells that one contradicting wall cell outweighs."""
FLOOR_MIN = 500
"""Cells that must be floor on both: 5 m² at 0.1 m. A wall alone may be known from either side."""
SECOND_MAX = 0.6
"""The second best answer may have at most this share of the best one's weight."""


class Overlap(NamedTuple):
    """What two maps say of each other."""

    agreeing: int
    """Wall cells of the one that are walls on the other."""
    contradicting: int
    """Wall cells of either that are floor on the other."""
    floor: int
    """Cells that are floor on both."""

    @property
    def share(self) -> float:
        """Share of the compared wall cells that agree."""
        return self.agreeing / max(self.agreeing + self.contradicting, 1)

    @property
    def weight(self) -> float:
        """Wall cells that agree, less those that contradict."""
        return max(self.agreeing - CONTRADICTION * self.contradicting, 0.0)

    @property
    def is_match(self) -> bool:
        """Whether the maps show the same place."""
        return self.agreeing >= COMMON_MIN and self.floor >= FLOOR_MIN and self.share >= AGREES_MIN


class Found(NamedTuple):
    """How a map lies on another."""

    T_other_own: Pose2D
    overlap: Overlap


class MapMatcher:
    """Looks for places of one map on another; made for one pair of maps as they are now.

    Args:
        own: the map whose place is looked for.
        other: the map on which it is looked for, with cells of the same size.
        own_bodies: (K, 3) x, y, radius in metres of robots in the frame of the own map: what either map shows there may
            be a robot, and contradicts nothing.
        other_bodies: (M, 3) the same in the frame of the other map.

    """

    def __init__(
        self,
        own: OccupancyGrid,
        other: OccupancyGrid,
        own_bodies: NDArray[np.float64] = NOBODY,
        other_bodies: NDArray[np.float64] = NOBODY,
    ) -> None:
        self._own = own
        self._other = other
        self._own_bodies = own_bodies
        self._other_bodies = other_bodies
        self._walls = _walls_of(own)
        self._own_distance = _distances(own)
        self._other_distance = _distances(other)

    def find(self, at: Pose2D) -> Found | None:
        """T_other_own, found from the walls about a place of the own map; None if it is nowhere, or ambiguous."""
        about = self._walls - (at.x_m, at.y_m)
        about = about[about[:, 0] ** 2 + about[:, 1] ** 2 < ABOUT_M**2]
        if len(about) < WALLS_MIN:
            return None
        other = self._other
        T_own_place = Pose2D(at.x_m, at.y_m, 0.0)
        places = search_places(other.log_odds, other.geometry, _some(about, SEARCH_WALLS), PLACES)
        seen: list[Pose2D] = []
        for _, guess in places:
            if len(seen) < TRIED and not any(_is_same(guess, each) for each in seen):
                seen.append(guess)
        some = _some(about, TRY_WALLS)
        tried = [self._laid(self._refined(guess, some, REACHES_M[:1]), T_own_place) for guess in seen]
        tried.sort(key=lambda each: each.overlap.contradicting - each.overlap.agreeing)
        found: list[Found] = []
        for each in tried[:REFINED]:
            walls = _some(about, REFINE_WALLS)
            better = self._laid(self._refined(each.T_other_own.compose(T_own_place), walls, REACHES_M), T_own_place)
            place = better.T_other_own.compose(T_own_place)
            if not any(_is_same(place, other.T_other_own.compose(T_own_place)) for other in found):
                found.append(better)
        found.sort(key=lambda each: -each.overlap.weight)
        if not found:
            return None
        best = self._settled(found[0], T_own_place)
        if not best.overlap.is_match:
            return None
        if len(found) > 1:
            second = self._settled(found[1], T_own_place)
            is_other = not _is_same(second.T_other_own.compose(T_own_place), best.T_other_own.compose(T_own_place))
            if is_other and second.overlap.weight > SECOND_MAX * best.overlap.weight:
                return None
        return best

    def overlap(self, T_other_own: Pose2D) -> Overlap:
        """What the maps say of each other if they lie so."""
        own, other = self._own.geometry, self._other.geometry
        # The middle of the own map's cell (0, 0), in cells of the other map.
        x_m, y_m = own.origin_x_m + 0.5 * own.resolution_m, own.origin_y_m + 0.5 * own.resolution_m
        cos, sin = math.cos(T_other_own.yaw_rad), math.sin(T_other_own.yaw_rad)
        first_x = (T_other_own.x_m + cos * x_m - sin * y_m - other.origin_x_m) / other.resolution_m
        first_y = (T_other_own.y_m + sin * x_m + cos * y_m - other.origin_y_m) / other.resolution_m
        contradicts = np.zeros(own.shape, np.uint8)
        agreeing, floor = _compare(
            kernel_array(self._own.log_odds, INT8),
            self._own_distance,
            kernel_array(self._other.log_odds, INT8),
            self._other_distance,
            (cos, sin, first_x, first_y),
            NEAR_CELLS,
            contradicts,
        )
        self._leave_out_bodies(contradicts, T_other_own)
        return Overlap(agreeing, _in_clusters(contradicts), floor)

    def _leave_out_bodies(self, contradicts: NDArray[np.uint8], T_other_own: Pose2D) -> None:
        rows, columns = np.nonzero(contradicts)
        geometry = self._own.geometry
        x_m = geometry.origin_x_m + (columns + 0.5) * geometry.resolution_m
        y_m = geometry.origin_y_m + (rows + 0.5) * geometry.resolution_m
        T_own_other = T_other_own.inverse()
        others = [(T_own_other.compose(Pose2D(x, y, 0.0)), radius_m) for x, y, radius_m in self._other_bodies.tolist()]
        bodies = [*self._own_bodies.tolist(), *((at.x_m, at.y_m, radius_m) for at, radius_m in others)]
        for body_x_m, body_y_m, radius_m in bodies:
            is_body = (x_m - body_x_m) ** 2 + (y_m - body_y_m) ** 2 < (radius_m + BODY_MARGIN_M) ** 2
            contradicts[rows[is_body], columns[is_body]] = 0

    def _laid(self, place: Pose2D, T_own_place: Pose2D) -> Found:
        T_other_own = place.compose(T_own_place.inverse())
        return Found(T_other_own, self.overlap(T_other_own))

    def _settled(self, found: Found, T_own_place: Pose2D) -> Found:
        """Refined by all walls of the own map, if that is better."""
        walls = _some(self._walls, WHOLE_WALLS) - (T_own_place.x_m, T_own_place.y_m)
        place = self._refined(found.T_other_own.compose(T_own_place), walls, (WHOLE_REACH_M, WHOLE_REACH_M))
        T_other_own = place.compose(T_own_place.inverse())
        overlap = self.overlap(T_other_own)
        return Found(T_other_own, overlap) if overlap.weight > found.overlap.weight else found

    def _refined(self, guess: Pose2D, walls: NDArray[np.float64], reaches_m: tuple[float, ...]) -> Pose2D:
        for reach_m in reaches_m:
            held = match_walls(self._other.log_odds, self._other.geometry, guess, walls, reach_m).directions
            if not held:
                return guess
            rows, offsets_m = np.array([each.row for each in held]), np.array([each.offset_m for each in held])
            x_m, y_m, yaw_rad = least_solution(rows, offsets_m).tolist()
            guess = Pose2D(guess.x_m + x_m, guess.y_m + y_m, math.remainder(guess.yaw_rad + yaw_rad, math.tau))
        return guess


def _walls_of(grid: OccupancyGrid) -> NDArray[np.float64]:
    """(K, 2) the middles of the occupied cells, metres."""
    geometry = grid.geometry
    rows, columns = np.nonzero(grid.log_odds > 0)
    walls = np.empty((len(rows), 2))
    walls[:, 0] = geometry.origin_x_m + (columns + 0.5) * geometry.resolution_m
    walls[:, 1] = geometry.origin_y_m + (rows + 0.5) * geometry.resolution_m
    return walls


def _distances(grid: OccupancyGrid) -> NDArray[np.float32]:
    return distance_window(grid.log_odds, 0, 0, *grid.geometry.shape, math.ceil(NEAR_CELLS) + 1)


def _some(points: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """At most `count` of the points, spread over all of them."""
    return points[np.linspace(0, len(points) - 1, min(count, len(points))).astype(np.int64)]


def _is_same(one: Pose2D, other: Pose2D) -> bool:
    turn_rad = math.remainder(one.yaw_rad - other.yaw_rad, math.tau)
    return one.distance_m(other) < APART_M and abs(turn_rad) < APART_RAD


@njit(cache=True, nogil=True)
def _compare(
    own: NDArray[np.int8],
    own_distance: NDArray[np.float32],
    other: NDArray[np.int8],
    other_distance: NDArray[np.float32],
    placed: tuple[float, float, float, float],
    near: float,
    contradicts: NDArray[np.uint8],
) -> tuple[int, int]:
    """Wall cells of `own` that agree, and cells that are floor on both maps.

    Marks in `contradicts` where one map has a wall and the other has floor.
    """
    cos, sin, first_x, first_y = placed
    agreeing, floor = 0, 0
    for i in range(own.shape[0]):
        for j in range(own.shape[1]):
            if own[i, j] == 0:
                continue
            row = math.floor(first_y + sin * j + cos * i)
            column = math.floor(first_x + cos * j - sin * i)
            if row < 0 or column < 0 or row >= other.shape[0] or column >= other.shape[1] or other[row, column] == 0:
                continue
            if own[i, j] > 0:
                if other_distance[row, column] <= near:
                    agreeing += 1
                elif other[row, column] < 0:
                    contradicts[i, j] = 1
            elif other[row, column] < 0:
                floor += 1
            elif own_distance[i, j] > near:
                contradicts[i, j] = 1
    return agreeing, floor


@njit(cache=True, nogil=True)
def _in_clusters(marked: NDArray[np.uint8]) -> int:
    """Marked cells that are connected with at least `CLUSTER_MIN` − 1 others, of the eight around each; unmarks all."""
    height, width = marked.shape
    stack = np.empty((marked.size, 2), np.int32) if marked.any() else np.empty((0, 2), np.int32)
    total = 0
    for i in range(height):
        for j in range(width):
            if not marked[i, j]:
                continue
            marked[i, j] = 0
            stack[0, 0], stack[0, 1] = i, j
            waiting, cells = 1, 0
            while waiting:
                waiting -= 1
                row, column = stack[waiting, 0], stack[waiting, 1]
                cells += 1
                for up in range(max(row - 1, 0), min(row + 2, height)):
                    for right in range(max(column - 1, 0), min(column + 2, width)):
                        if marked[up, right]:
                            marked[up, right] = 0
                            stack[waiting, 0], stack[waiting, 1] = up, right
                            waiting += 1
            if cells >= CLUSTER_MIN:
                total += cells
    return total
