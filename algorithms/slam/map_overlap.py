"""Relative pose of two maps in different frames, found from the walls that both show.

The walls around a place of one map are searched for on the other map. Each answer is refined and compared with both
maps. Walls of one map that are floor on the other contradict the answer. Source: Birk, Carpin, *Merging occupancy grid
maps from multiple robots*, Proceedings of the IEEE 94(7), 2006. Walls are compared as points, the middles of their
cells.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.localization.scan_match import distance_window, match_walls
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.numeric.kernel_array import FLOAT64, INT8, Floats, kernel_array
from robrain.algorithms.numeric.small_linear_algebra import least_solution
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

YAWS = 120
"""Directions tried: 3° apart."""
REACH_CELLS = 4
"""Walls within this distance of a wall of the map count, the less the farther."""
LEVELS = 3
"""The coarsest resolution has cells of 2³ of the map's."""
BEST = 255.0
"""Nearness of a point that lies on a wall."""
UNKNOWN = 90.0
"""Nearness of a point on unknown floor: maps may overlap in part only."""
SCORE_MIN = 0.5
"""Mean nearness, as a share of `BEST`, below which a place is none."""
NEARLY = 0.8
"""Default share of the best score that a place needs."""
NODES_MAX = 4096
STRIDE = 61
"""Prime, so that it visits each point once unless their number is a multiple of it."""


def search_places(
    log_odds: NDArray[np.int8], geometry: GridGeometry, points: Floats, places_max: int, nearly: float = NEARLY
) -> list[tuple[float, Pose2D]]:
    """Poses on the floor of a map at which `points` lie on its walls, best first, with their scores (0 to 1).

    Args:
        log_odds: int8 (H, W), an `OccupancyGrid`'s.
        geometry: of that grid.
        points: (K, 2) places of walls, metres, in the searched frame.
        places_max: largest number of poses returned. They may be close to each other.
        nearly: places whose score is at least this share of the best one's are returned.

    """
    rows, columns = np.flatnonzero((log_odds != 0).any(axis=1)), np.flatnonzero((log_odds != 0).any(axis=0))
    if not len(points) or rows.size == 0:
        return []
    row, column = int(rows[0]), int(columns[0])
    box = kernel_array(log_odds[row : int(rows[-1]) + 1, column : int(columns[-1]) + 1], INT8)
    nodes = _search(box, kernel_array(points / geometry.resolution_m, FLOAT64), nearly)
    best_first = sorted(nodes.tolist(), key=lambda node: (-node[0], node[1:]))[:places_max]
    found = []
    for score, i, j, k in best_first:
        middle = geometry.center_of(row + int(i), column + int(j))
        found.append((score / BEST, Pose2D(middle.x_m, middle.y_m, math.remainder(k * math.tau / YAWS, math.tau))))
    return found


@njit(cache=True, nogil=True)
def _pyramid(log_odds: NDArray[np.int8], margin: int) -> NDArray[np.uint8]:
    """(LEVELS + 1, H + 2 margin, W + 2 margin): nearness to a wall, the best of 2^level cells up and right."""
    height, width = log_odds.shape[0] + 2 * margin, log_odds.shape[1] + 2 * margin
    field = distance_window(log_odds, -margin, -margin, height, width, REACH_CELLS)
    levels = np.zeros((LEVELS + 1, height, width), np.uint8)
    for i in range(height):
        for j in range(width):
            levels[0, i, j] = np.uint8(BEST * (1.0 - field[i, j] / REACH_CELLS))
            row, column = i - margin, j - margin
            is_inside = 0 <= row < log_odds.shape[0] and 0 <= column < log_odds.shape[1]
            if not is_inside or log_odds[row, column] == 0:
                levels[0, i, j] = max(levels[0, i, j], np.uint8(UNKNOWN))
    for level in range(1, LEVELS + 1):
        half = 1 << (level - 1)
        for i in range(height):
            for j in range(width):
                most = levels[level - 1, i, j]
                if i + half < height:
                    most = max(most, levels[level - 1, i + half, j])
                    if j + half < width:
                        most = max(most, levels[level - 1, i + half, j + half])
                if j + half < width:
                    most = max(most, levels[level - 1, i, j + half])
                levels[level, i, j] = most
    return levels


@njit(cache=True, nogil=True)
def _score(
    levels: NDArray[np.uint8], level: int, margin: int, i: int, j: int, offsets: NDArray[np.int32], least: float
) -> float:
    """Mean nearness of the points at cell (i, j), or a bound for 2^level cells from there; 0 once below `least`."""
    count = offsets.shape[0]
    height, width = levels.shape[1], levels.shape[2]
    total: float = 0.0
    needed = least * count
    for n in range(count):
        row, column = i + offsets[n, 0] + margin, j + offsets[n, 1] + margin
        inside = 0 <= row < height and 0 <= column < width
        total += float(levels[level, row, column]) if inside else UNKNOWN
        if total + BEST * (count - 1 - n) < needed:
            return 0.0
    mean: float = total / count
    return mean


@njit(cache=True, nogil=True)
def _best_leaf(
    levels: NDArray[np.uint8],
    log_odds: NDArray[np.int8],
    margin: int,
    i: int,
    j: int,
    offsets: NDArray[np.int32],
    least: float,
) -> tuple[float, int, int]:
    """The best free cell among the 2^LEVELS from (i, j) up and right whose score is at least `least`; 0 if none."""
    height, width = log_odds.shape
    best, best_i, best_j = 0.0, 0, 0
    stack = np.empty((4 * (LEVELS + 1), 3), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = LEVELS, i, j
    size = 1
    while size:
        size -= 1
        level, row, column = stack[size, 0], stack[size, 1], stack[size, 2]
        if row >= height or column >= width:
            continue
        score = _score(levels, level, margin, row, column, offsets, max(least, best))
        if score <= best or score < least:
            continue
        if level == 0:
            if log_odds[row, column] < 0:
                best, best_i, best_j = score, row, column
            continue
        half = 1 << (level - 1)
        for up in range(2):
            for right in range(2):
                stack[size, 0] = level - 1
                stack[size, 1], stack[size, 2] = row + up * half, column + right * half
                size += 1
    return best, best_i, best_j


@njit(cache=True, nogil=True)
def _turned(points: Floats, k: int, offsets: NDArray[np.int32]) -> None:
    """The points in cells, turned by the k-th yaw, in an order in which neighbours are far from each other.

    So a sum over the first of them shows early whether a place can match.
    """
    cos, sin = math.cos(k * 2.0 * math.pi / YAWS), math.sin(k * 2.0 * math.pi / YAWS)
    count = points.shape[0]
    for n in range(count):
        m = n * STRIDE % count
        offsets[n, 0] = math.floor(0.5 + sin * points[m, 0] + cos * points[m, 1])
        offsets[n, 1] = math.floor(0.5 + cos * points[m, 0] - sin * points[m, 1])


@njit(cache=True, nogil=True)
def _search(log_odds: NDArray[np.int8], points: Floats, nearly: float) -> Floats:
    """(n, 4) score, row, column, yaw index: the best place of each coarse cell and yaw that does nearly as well."""
    height, width = log_odds.shape
    margin = (1 << LEVELS) + REACH_CELLS  # a bound may count cells before the map's first that are near a wall
    levels = _pyramid(log_odds, margin)
    step = 1 << LEVELS
    up, right = (height + step - 1) // step, (width + step - 1) // step
    bounds = np.empty(YAWS * up * right, np.float32)
    offsets = np.empty((points.shape[0], 2), np.int32)
    for k in range(YAWS):
        _turned(points, k, offsets)
        for i in range(up):
            for j in range(right):
                bounds[(k * up + i) * right + j] = _score(
                    levels, LEVELS, margin, step * i, step * j, offsets, SCORE_MIN * BEST
                )
    # The most promising first: their scores rule out the others.
    order = np.argsort(-bounds, kind="stable")
    found = np.empty((NODES_MAX, 4))
    size = 0
    best = 0.0
    for node in order:
        least = max(SCORE_MIN * BEST, nearly * best)
        if bounds[node] < least or size == NODES_MAX:
            break
        k, i, j = node // (up * right), node // right % up, node % right
        _turned(points, k, offsets)
        score, row, column = _best_leaf(levels, log_odds, margin, step * i, step * j, offsets, least)
        if score >= least:
            best = max(best, score)
            found[size, 0], found[size, 1], found[size, 2], found[size, 3] = score, row, column, k
            size += 1
    return found[:size]


ABOUT_M = 8.0
"""Walls within this distance of a place are searched for."""
WALLS_MIN = 60
"""A place with fewer wall cells is not searched for."""
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
BODY_MARGIN_M = 0.3
"""Cells within this distance of a robot's hull may show the robot."""
SMALL_MAX_M = 0.8
"""A cluster that is no longer and no wider than this may be a robot."""
NOBODY = np.empty((0, 3))
AGREES_MIN = 0.99
"""Share of the compared wall cells that must agree. Measured on six floors, where maps truly overlap: 155 of 169
answers have no cluster of contradicting cells. At wrong places of floors that repeat themselves, 1.4 to 16 % have none.
"""
COMMON_MIN = 100
"""Wall cells that must be the same: 10 m of wall at 0.1 m."""
CONTRADICTION = 2.0
"""Number of agreeing wall cells that one contradicting wall cell outweighs."""
FLOOR_MIN = 1200
"""Cells that must be floor on both: 12 m² at 0.1 m. A wall alone may be seen from either side."""
WALL_WORTH = 5
"""Number of floor cells that one wall cell is worth."""
EVIDENCE_MIN = 4200
"""Both together, in floor cells. Where offices of 25 m² are equal, wrong places reach 3900 without a contradiction."""
SECOND_MAX = 0.6
"""The second best answer may have at most this share of the best one's weight."""
REPEATED_MIN = 0.6
"""Share of the common wall cells that, uncontradicted in a second place of either map, make them no evidence.

Where offices are equal, maps of two of them lie on each other without any contradiction.
"""
REPEATED_NEARLY = 0.7
"""Share of the first place's score that such a second place has."""

NEAR_CELLS = 2.3
"""Walls that are this near to each other are the same wall."""


UNMARKED, CONTRADICTS, COMMON = 0, 1, 2
"""Marks of cells that are known on two maps."""
CLUSTER_MIN = 4
"""Least number of connected cells for a contradiction: single cells are noise of the lidar."""
BESIDE = 3
"""Cells within this number of cells of a wall may be part of it and contradict nothing."""


@njit(cache=True, nogil=True)
def compare(
    own: NDArray[np.int8],
    own_distance: NDArray[np.float32],
    other: NDArray[np.int8],
    other_distance: NDArray[np.float32],
    placed: tuple[float, float, float, float],
    near: float,
    marks: NDArray[np.uint8],
) -> tuple[int, int]:
    """Wall cells of `own` that agree, and cells that are floor on both maps.

    Marks each cell of `own` that is known on both maps: a wall of one map that is floor on the other contradicts.
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
                    marks[i, j] = COMMON
                elif other[row, column] < 0:
                    marks[i, j] = CONTRADICTS
            elif other[row, column] < 0:
                floor += 1
                marks[i, j] = COMMON
            elif own_distance[i, j] > near:
                marks[i, j] = CONTRADICTS
    return agreeing, floor


@njit(cache=True, nogil=True)
def in_clusters(marked: NDArray[np.uint8], own: NDArray[np.int8], small_max: float) -> tuple[int, NDArray[np.int64]]:
    """Contradicting cells connected with at least `CLUSTER_MIN` − 1 others, of the eight around each; unmarks them.

    Returns the number of cells in clusters longer or wider than `small_max` cells or beside a wall of the own map. It
    also returns the number in each other cluster.
    """
    height, width = marked.shape
    stack = np.empty((np.sum(marked == CONTRADICTS), 2), np.int32)
    small = np.empty(stack.shape[0], np.int64)
    large, smalls = 0, 0
    for i in range(height):
        for j in range(width):
            if marked[i, j] != CONTRADICTS:
                continue
            marked[i, j] = UNMARKED
            stack[0, 0], stack[0, 1] = i, j
            waiting, cells = 1, 0
            low, left, right_most, walls = i, j, j, 0
            while waiting:
                waiting -= 1
                row, column = stack[waiting, 0], stack[waiting, 1]
                cells += 1
                walls += own[row, column] > 0
                low, left, right_most = max(low, row), min(left, column), max(right_most, column)
                for up in range(max(row - 1, 0), min(row + 2, height)):
                    for right in range(max(column - 1, 0), min(column + 2, width)):
                        if marked[up, right] == CONTRADICTS:
                            marked[up, right] = UNMARKED
                            stack[waiting, 0], stack[waiting, 1] = up, right
                            waiting += 1
            if cells < CLUSTER_MIN:
                continue
            is_small = low - i < small_max and right_most - left < small_max
            if is_small and _walls_about(own, i, low, left, right_most) == walls:
                small[smalls] = cells
                smalls += 1
            else:
                large += cells
    return large, small[:smalls]


@njit(cache=True, nogil=True)
def _walls_about(own: NDArray[np.int8], first: int, last: int, left: int, right: int) -> int:
    """Wall cells in a box, and beside it."""
    total = 0
    for i in range(max(first - BESIDE, 0), min(last + BESIDE + 1, own.shape[0])):
        for j in range(max(left - BESIDE, 0), min(right + BESIDE + 1, own.shape[1])):
            total += own[i, j] > 0
    return total


class Overlap(NamedTuple):
    """Comparison of two maps."""

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
    def evidence(self) -> int:
        """For the maps' showing the same place, in cells of floor; 0 if that is contradicted."""
        if self.agreeing < COMMON_MIN or self.floor < FLOOR_MIN or self.share < AGREES_MIN:
            return 0
        return self.floor + WALL_WORTH * self.agreeing


class MapOverlap(NamedTuple):
    """Place of a map on another."""

    T_other_own: Pose2D
    overlap: Overlap


class MapMatcher:
    """Searches for places of one map on another; made for one pair of maps in their present state.

    Args:
        own: the map whose place is searched for.
        other: the map on which the search runs, with cells of the same size.
        own_bodies: (K, 3) x, y, radius in metres of robots in the frame of the own map. Obstacles of either map there
            may be robots and contradict nothing.
        other_bodies: (M, 3) the same in the frame of the other map.
        strangers: number of robots that either map may show at unknown places. This number of small, free-standing
            contradicting things is ignored, the largest first.
        evidence_min: least `Overlap.evidence` of an answer.

    """

    def __init__(
        self,
        own: OccupancyGrid,
        other: OccupancyGrid,
        own_bodies: Floats = NOBODY,
        other_bodies: Floats = NOBODY,
        strangers: int = 0,
        evidence_min: int = EVIDENCE_MIN,
    ) -> None:
        self._own = own
        self._other = other
        self._own_bodies = own_bodies
        self._other_bodies = other_bodies
        self._strangers = strangers
        self._evidence_min = evidence_min
        self._walls = wall_points(own)
        self._own_distance = distances_to_walls(own)
        self._other_distance = distances_to_walls(other)

    def find(self, at: Pose2D) -> MapOverlap | None:
        """T_other_own, found from the walls about a place of the own map; None if it is nowhere, or ambiguous."""
        about = self._walls - (at.x_m, at.y_m)
        about = about[about[:, 0] ** 2 + about[:, 1] ** 2 < ABOUT_M**2]
        if len(about) < WALLS_MIN:
            return None
        other = self._other
        T_own_place = Pose2D(at.x_m, at.y_m, 0.0)
        places = search_places(other.log_odds, other.geometry, some_points(about, SEARCH_WALLS), PLACES)
        some = some_points(about, TRY_WALLS)
        tried = [
            self._laid(matched_place(other, guess, some, REACHES_M[:1]), T_own_place)
            for guess in distinct([guess for _, guess in places], TRIED)
        ]
        tried.sort(key=lambda each: each.overlap.contradicting - each.overlap.agreeing)
        found: list[MapOverlap] = []
        for each in tried[:REFINED]:
            guess, walls = each.T_other_own.compose(T_own_place), some_points(about, REFINE_WALLS)
            better = self._laid(matched_place(self._other, guess, walls, REACHES_M), T_own_place)
            place = better.T_other_own.compose(T_own_place)
            if not any(is_same_place(place, other.T_other_own.compose(T_own_place)) for other in found):
                found.append(better)
        found.sort(key=lambda each: -each.overlap.weight)
        if not found:
            return None
        best = self._settled(found[0], T_own_place)
        if best.overlap.evidence < self._evidence_min:
            return None
        if len(found) > 1:
            second = self._settled(found[1], T_own_place)
            is_other = not is_same_place(second.T_other_own.compose(T_own_place), best.T_other_own.compose(T_own_place))
            if is_other and second.overlap.weight > SECOND_MAX * best.overlap.weight:
                return None
        return None if self._is_repeated(best, at) else best

    def overlap(self, T_other_own: Pose2D) -> Overlap:
        """Comparison of the maps at this relative pose."""
        return self._compared(T_other_own)[0]

    def fits_elsewhere(self, at: Pose2D, T_other_own: Pose2D) -> bool:
        """Whether the walls of the own map are there a second time on the other map.

        Args:
            at: free place of the own map.
            T_other_own: known relative pose of the maps.

        """
        T_own_place = Pose2D(at.x_m, at.y_m, 0.0)
        home, walls = T_other_own.compose(T_own_place), self._walls - (at.x_m, at.y_m)
        other, some = self._other, some_points(self._walls, SEARCH_WALLS) - (at.x_m, at.y_m)
        places = search_places(other.log_odds, other.geometry, some, PLACES, REPEATED_NEARLY)
        for guess in distinct([home, *(guess for _, guess in places)], TRIED + 1)[1:]:
            place = matched_place(other, guess, some_points(walls, TRY_WALLS), REACHES_M)
            overlap = self._laid(place, T_own_place).overlap
            is_repeated = overlap.agreeing >= REPEATED_MIN * len(walls) and overlap.share >= AGREES_MIN
            if is_repeated and not is_same_place(place, home):
                return True
        return False

    def _is_repeated(self, found: MapOverlap, at: Pose2D) -> bool:
        """Whether the agreeing walls occur a second time on either map: then they are no evidence."""
        _, marks = self._compared(found.T_other_own)
        common = OccupancyGrid(self._own.geometry)
        common.log_odds[:] = np.where(marks == COMMON, self._own.log_odds, 0)
        return MapMatcher(common, self._own).fits_elsewhere(at, Pose2D(0.0, 0.0, 0.0)) or MapMatcher(
            common, self._other
        ).fits_elsewhere(at, found.T_other_own)

    def _compared(self, T_other_own: Pose2D) -> tuple[Overlap, NDArray[np.uint8]]:
        """Comparison of the maps at this relative pose, and the common cells of the own map."""
        own, other = self._own.geometry, self._other.geometry
        # The middle of the own map's cell (0, 0), in cells of the other map.
        x_m, y_m = own.origin_x_m + 0.5 * own.resolution_m, own.origin_y_m + 0.5 * own.resolution_m
        cos, sin = math.cos(T_other_own.yaw_rad), math.sin(T_other_own.yaw_rad)
        first_x = (T_other_own.x_m + cos * x_m - sin * y_m - other.origin_x_m) / other.resolution_m
        first_y = (T_other_own.y_m + sin * x_m + cos * y_m - other.origin_y_m) / other.resolution_m
        marks = np.zeros(own.shape, np.uint8)
        agreeing, floor = compare(
            kernel_array(self._own.log_odds, INT8),
            self._own_distance,
            kernel_array(self._other.log_odds, INT8),
            self._other_distance,
            (cos, sin, first_x, first_y),
            NEAR_CELLS,
            marks,
        )
        self._leave_out_bodies(marks, T_other_own)
        large, small = in_clusters(marks, kernel_array(self._own.log_odds, INT8), SMALL_MAX_M / own.resolution_m)
        contradicting = large + sum(sorted(small.tolist())[: max(len(small) - self._strangers, 0)])
        return Overlap(agreeing, contradicting, floor), marks

    def _leave_out_bodies(self, marks: NDArray[np.uint8], T_other_own: Pose2D) -> None:
        rows, columns = np.nonzero(marks == CONTRADICTS)
        x_m, y_m = middles_m(self._own.geometry, rows, columns)
        T_own_other = T_other_own.inverse()
        others = [(T_own_other.compose(Pose2D(x, y, 0.0)), radius_m) for x, y, radius_m in self._other_bodies.tolist()]
        bodies = [*self._own_bodies.tolist(), *((at.x_m, at.y_m, radius_m) for at, radius_m in others)]
        for body_x_m, body_y_m, radius_m in bodies:
            is_body = (x_m - body_x_m) ** 2 + (y_m - body_y_m) ** 2 < (radius_m + BODY_MARGIN_M) ** 2
            marks[rows[is_body], columns[is_body]] = UNMARKED

    def _laid(self, place: Pose2D, T_own_place: Pose2D) -> MapOverlap:
        T_other_own = place.compose(T_own_place.inverse())
        return MapOverlap(T_other_own, self.overlap(T_other_own))

    def _settled(self, found: MapOverlap, T_own_place: Pose2D) -> MapOverlap:
        """Refined by all walls of the own map, if that is better."""
        walls = some_points(self._walls, WHOLE_WALLS) - (T_own_place.x_m, T_own_place.y_m)
        guess = found.T_other_own.compose(T_own_place)
        better = self._laid(matched_place(self._other, guess, walls, (WHOLE_REACH_M, WHOLE_REACH_M)), T_own_place)
        return better if better.overlap.weight > found.overlap.weight else found


def cells_outside(own: OccupancyGrid, T_other_own: Pose2D, other: GridGeometry) -> int:
    """Number of floor cells of a map that lie outside another map's grid."""
    rows, columns = np.nonzero(own.log_odds < 0)
    x_m, y_m = middles_m(own.geometry, rows, columns)
    cos, sin = math.cos(T_other_own.yaw_rad), math.sin(T_other_own.yaw_rad)
    column = (T_other_own.x_m + cos * x_m - sin * y_m - other.origin_x_m) / other.resolution_m
    row = (T_other_own.y_m + sin * x_m + cos * y_m - other.origin_y_m) / other.resolution_m
    inside = (column >= 0) & (row >= 0) & (column < other.width) & (row < other.height)
    return int(np.count_nonzero(~inside))


APART_M, APART_RAD = 0.5, 0.2
"""Places that differ by less are one."""


def wall_points(grid: OccupancyGrid) -> Floats:
    """(K, 2) the middles of the occupied cells, metres."""
    return np.column_stack(middles_m(grid.geometry, *np.nonzero(grid.log_odds > 0)))


def middles_m(geometry: GridGeometry, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """X and y of the middles of cells."""
    x_m: Floats = geometry.origin_x_m + (columns.astype(np.float64) + 0.5) * geometry.resolution_m
    y_m: Floats = geometry.origin_y_m + (rows.astype(np.float64) + 0.5) * geometry.resolution_m
    return x_m, y_m


def distances_to_walls(grid: OccupancyGrid) -> NDArray[np.float32]:
    """float32 (H, W), cells to the nearest wall, as far as `NEAR_CELLS` needs it."""
    return distance_window(grid.log_odds, 0, 0, *grid.geometry.shape, math.ceil(NEAR_CELLS) + 1)


def some_points(points: Floats, count: int) -> Floats:
    """At most `count` of the points, spread over all of them."""
    return points[np.linspace(0, len(points) - 1, min(count, len(points))).astype(np.int64)]


def is_same_place(one: Pose2D, other: Pose2D) -> bool:
    """Whether two poses are one answer."""
    turn_rad = math.remainder(one.yaw_rad - other.yaw_rad, math.tau)
    return one.distance_m(other) < APART_M and abs(turn_rad) < APART_RAD


def distinct(places: list[Pose2D], most: int) -> list[Pose2D]:
    """The first `most` of these poses, without those that repeat an earlier one."""
    seen: list[Pose2D] = []
    for place in places:
        if len(seen) < most and not any(is_same_place(place, each) for each in seen):
            seen.append(place)
    return seen


def matched_place(grid: OccupancyGrid, guess: Pose2D, points: Floats, reaches_m: tuple[float, ...]) -> Pose2D:
    """A pose near a guess at which points, (N, 2) metres in its frame, match the walls of a map."""
    for reach_m in reaches_m:
        held = match_walls(grid.log_odds, grid.geometry, guess, points, reach_m).directions
        if not held:
            return guess
        rows, offsets_m = np.array([each.row for each in held]), np.array([each.offset_m for each in held])
        x_m, y_m, yaw_rad = least_solution(rows, offsets_m).tolist()
        guess = Pose2D(guess.x_m + x_m, guess.y_m + y_m, math.remainder(guess.yaw_rad + yaw_rad, math.tau))
    return guess
