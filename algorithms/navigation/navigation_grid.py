"""Where a round robot may drive on a known map, what each place costs, and paths over it.

A cell is traversable if its clearance from known obstacles is at least the robot's radius plus a margin. It must also
be known to be free, unless the grid is configured otherwise. Cells near obstacles cost more, so that paths keep away
from walls where there is room.
"""

import math
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.mapping.zone_grid import ZoneGrid
from robrain.algorithms.navigation.path_planning import (
    distance_field,
    is_chord_clear,
    nearest_traversable,
    plan_path,
    round_corners,
    shorten_path,
    steps_against,
)
from robrain.algorithms.numeric.kernel_array import BOOL, Floats, kernel_array
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry


def clearance_m(occupied: NDArray[np.bool_], resolution_m: float, limit_m: float) -> NDArray[np.float32]:
    """Distance of every cell's middle to that of the nearest occupied cell, metres, at most `limit_m`, (H, W).

    Occupied cells have 0. The cells around the grid count as occupied, so that plans stay off the arena's edge.
    Exact Euclidean distances by Felzenszwalb and Huttenlocher, *Distance Transforms of Sampled Functions*, Theory
    of Computing 2012.
    """
    return _clearance_m(kernel_array(occupied, BOOL), float(resolution_m), float(limit_m))


@njit(cache=True, nogil=True)
def _clearance_m(occupied: NDArray[np.bool_], resolution_m: float, limit_m: float) -> NDArray[np.float32]:
    height, width = occupied.shape
    clearance = np.empty((height, width), np.float32)
    # Distance along the column, in cells; the rows −1 and height are occupied.
    vertical = np.empty((height, width), np.int64)
    for column in range(width):
        vertical[0, column] = 0 if occupied[0, column] else 1
    for row in range(1, height):
        for column in range(width):
            vertical[row, column] = 0 if occupied[row, column] else vertical[row - 1, column] + 1
    for column in range(width):
        vertical[height - 1, column] = min(vertical[height - 1, column], 1)
    for row in range(height - 2, -1, -1):
        for column in range(width):
            vertical[row, column] = min(vertical[row, column], vertical[row + 1, column] + 1)

    # Lower envelope of the parabolas (x − column)² + vertical², with those of the columns −1 and width at 0.
    limit_cells_2 = (limit_m / resolution_m) ** 2
    apex = np.empty(width + 2, np.int64)
    height_2 = np.empty(width + 2, np.int64)
    begin = np.empty(width + 3)
    for row in range(height):
        count = 1
        apex[0] = -1
        height_2[0] = 0
        begin[0] = -np.inf
        for column in range(width + 1):
            value = 0 if column == width else vertical[row, column] * vertical[row, column]
            while True:
                last = count - 1
                crossing = ((value + column * column) - (height_2[last] + apex[last] * apex[last])) / (
                    2.0 * (column - apex[last])
                )
                if crossing > begin[last]:
                    break
                count -= 1
            apex[count] = column
            height_2[count] = value
            begin[count] = crossing
            count += 1
        begin[count] = np.inf
        k = 0
        for column in range(width):
            while begin[k + 1] < column:
                k += 1
            distance_2 = (column - apex[k]) ** 2 + height_2[k]
            clearance[row, column] = (
                limit_m if distance_2 >= limit_cells_2 else np.sqrt(float(distance_2)) * resolution_m
            )
    return clearance


COMFORT_M = 0.4
"""Clearance beyond the preferred one from which a place costs nothing extra."""
DISCOMFORT = 3.0
"""Extra cost of a place with just the preferred clearance."""
COARSE = 2
"""Pitch of the grid on which lengths of paths are compared, in cells."""
NARROW = 12.0
"""Extra cost (chosen) of a metre in the narrowest place over one with the preferred clearance. A detour is preferred
unless it is longer by more than this."""
DEAR = 5.0
"""Extra cost (chosen) of a cell in a swath: more than `DISCOMFORT`, so that the width of a corridor is used."""


RIGHT_M = 0.35
"""A path that keeps to the right is this far from the cheapest path if there is space. Two robots of radius 0.2 m are
then 0.3 m apart (chosen)."""
ALONG = 3
"""Cells before and behind from which the direction of a path is taken there."""
CENTRED_M = 0.5
"""Points of a path with less clearance are centred between the walls, by at most half a cell. In the narrowest corridor
that is half of the spare room."""


class Swath(NamedTuple):
    """Floor to leave to other robots if possible: all within `radius_m` of positions (N, 2), metres, arena frame."""

    positions: Floats
    radius_m: float


class PathField(NamedTuple):
    """Path costs from one place to everywhere, as the map was when it was computed."""

    cells: NDArray[np.float32]
    """(H, W), in cells of open floor; inf where there is no path."""
    pitch: int
    """Cells of the map to a side of each of these."""
    pitch_m: float

    def to(self, cells: Iterable[tuple[int, int]]) -> list[float]:
        """Costs to cells of the map, as metres on open floor; inf where there is no path."""
        return [float(self.cells[row // self.pitch, column // self.pitch]) * self.pitch_m for row, column in cells]


class NavigationGrid:
    """A map as one kind of robot sees it.

    Args:
        classes: (H, W) int8, classes of an OccupancyGrid.
        geometry: of the grid.
        needed_m: radius of the robot plus margin.
        unknown_cost: cost of unknown floor relative to known floor, at least 1; None if it is not driven on.
        preferred_m: clearance below which a place is narrow and costs extra, the more the narrower it is. None means
            `needed_m`, with which no place is narrow.
        zones: on the same grid, for costs and directions; keep-out zones are occupied in `classes` already.

    """

    def __init__(
        self,
        classes: NDArray[np.int8],
        geometry: GridGeometry,
        needed_m: float,
        unknown_cost: float | None = None,
        preferred_m: float | None = None,
        zones: ZoneGrid | None = None,
    ) -> None:
        self.geometry = geometry
        self.zones = zones
        directed = [] if zones is None else zones.directed
        self._shut_steps = steps_against(directed, classes.shape) if directed else None
        self.needed_m = needed_m
        self.preferred_m = needed_m if preferred_m is None else max(needed_m, preferred_m)
        self.unknown_cost = unknown_cost
        self.narrow: NDArray[np.bool_] = np.zeros(classes.shape, np.bool_)
        """(H, W) cells with less than the preferred clearance."""
        self.traversable: NDArray[np.bool_] = np.empty(classes.shape, np.bool_)
        self.cost: NDArray[np.float32] = np.empty(classes.shape, np.float32)
        self._classes = classes
        everything = np.s_[:, :]
        self._check(everything, everything, everything)

    def update(self, classes: NDArray[np.int8]) -> None:
        """Update from the map: only where it has changed, and as far around as a change has an effect."""
        changed = classes != self._classes
        rows = np.flatnonzero(changed.any(axis=1))
        self._classes = classes
        if rows.size == 0:
            return
        columns = np.flatnonzero(changed[rows[0] : rows[-1] + 1].any(axis=0))
        reach = math.ceil((self.preferred_m + COMFORT_M) / self.geometry.resolution_m)
        low_row, low_column = max(0, rows[0] - reach), max(0, columns[0] - reach)
        inner = np.s_[low_row : rows[-1] + reach + 1, low_column : columns[-1] + reach + 1]
        # Twice as far around, so that obstacles beyond this box's edge are out of reach of the inner box.
        top, left = max(0, rows[0] - 2 * reach), max(0, columns[0] - 2 * reach)
        outer = np.s_[top : rows[-1] + 2 * reach + 1, left : columns[-1] + 2 * reach + 1]
        height, width = classes[inner].shape
        row, column = low_row - top, low_column - left
        self._check(outer, np.s_[row : row + height, column : column + width], inner)
        self.__dict__.pop("_coarse", None)

    def _check(self, outer: tuple[slice, slice], within: tuple[slice, slice], inner: tuple[slice, slice]) -> None:
        """Fill in the cells `inner` from the part `outer` of the map; `within` is the place of `inner` in `outer`."""
        felt_m = self.preferred_m + COMFORT_M
        near_m = clearance_m(self._classes[outer] == OCCUPIED, self.geometry.resolution_m, felt_m)[within]
        classes = self._classes[inner]
        enough = near_m >= self.needed_m
        spare = np.clip((near_m - self.preferred_m) / COMFORT_M, 0.0, 1.0)
        cost = (1.0 + DISCOMFORT * (1.0 - spare) ** 2).astype(np.float32)
        if self.preferred_m > self.needed_m:
            missing = np.clip((self.preferred_m - near_m) / (self.preferred_m - self.needed_m), 0.0, 1.0)
            cost += np.float32(NARROW) * missing
            self.narrow[inner] = missing > 0.0
        if self.unknown_cost is None:
            self.traversable[inner] = (classes == FREE) & enough
        else:
            self.traversable[inner] = (classes != OCCUPIED) & enough
            cost[classes != FREE] *= np.float32(self.unknown_cost)
        if self.zones is not None:
            cost += self.zones.surcharge[inner]
        self.cost[inner] = cost

    def snap(
        self, place: Point2D, radius_m: float, avoid: Sequence[tuple[float, float, float]] = ()
    ) -> tuple[int, int] | None:
        """The nearest traversable cell within a radius of a place, and outside circles (x, y, radius in metres)."""
        cell, radius_cells = self.geometry.cell_of(place.x_m, place.y_m), round(radius_m / self.geometry.resolution_m)
        return nearest_traversable(self.without(avoid) if avoid else self.traversable, cell, max(1, radius_cells))

    def path(
        self,
        start: Point2D,
        goal: Point2D,
        *,
        snap_m: float,
        avoid: Iterable[tuple[float, float, float]] = (),
        dear: Sequence[Swath] = (),
        keeps_right: bool = False,
    ) -> list[Point2D] | None:
        """A cheapest path from start to as near to the goal as the robot can stand, within `snap_m`.

        Args:
            start: where the robot is.
            goal: its goal.
            snap_m: how far start and goal may be from the ends of the path.
            avoid: circles (x, y, radius) in metres that must not be driven through.
            dear: swaths in which each cell costs `DEAR` more.
            keeps_right: whether the path keeps to the right where there is room, so that robots that meet pass.

        Returns: Waypoints without the start's cell, corners rounded where there is room; None if there is no path.

        """
        traversable = self.without(avoid)
        ends = [
            nearest_traversable(
                traversable,
                self.geometry.cell_of(place.x_m, place.y_m),
                max(1, round(snap_m / self.geometry.resolution_m)),
            )
            for place in (start, goal)
        ]
        if ends[0] is None or ends[1] is None:
            return None
        cost = self._with_swaths(dear)
        shut_steps = self._shut_steps
        cells = plan_path(traversable, cost, ends[0], ends[1], shut_steps)
        if cells is None:
            return None
        if shut_steps is not None:  # where steps have directions, straight lines may not have them
            traversable = traversable & (shut_steps == 0)
        corners = shorten_path(cells, traversable & (cost < 1.0 + DISCOMFORT / 4))
        return self.waypoints(corners, traversable, keeps_right=keeps_right)

    def waypoints(
        self, cells: NDArray[np.int32], traversable: NDArray[np.bool_] | None = None, *, keeps_right: bool = False
    ) -> list[Point2D]:
        """Cells (N, 2) as points in metres: without the first, corners rounded where the mask has room for it.

        With `keeps_right` they are moved to the right instead.
        """
        if cells.shape[0] < 2:
            return [self.geometry.center_of(int(row), int(column)) for row, column in cells]
        mask = kernel_array(self.traversable if traversable is None else traversable, BOOL)
        path = cells.astype(np.float64) if keeps_right else round_corners(cells, mask)
        centred_m = RIGHT_M if keeps_right else CENTRED_M
        _centre(path, self._classes == OCCUPIED, mask, centred_m / self.geometry.resolution_m)
        return self._points(_keep_right(path, mask, RIGHT_M / self.geometry.resolution_m) if keeps_right else path)

    def _points(self, path: Floats) -> list[Point2D]:
        """A path (N, 2; row, column) as points in metres, without the first."""
        geometry = self.geometry
        ys_m = geometry.origin_y_m + (path[1:, 0] + 0.5) * geometry.resolution_m
        xs_m = geometry.origin_x_m + (path[1:, 1] + 0.5) * geometry.resolution_m
        return [Point2D(x_m, y_m) for x_m, y_m in zip(xs_m.tolist(), ys_m.tolist(), strict=True)]

    def clear_positions(self, classes: NDArray[np.int8], positions: Floats) -> int:
        """How many of positions (N, 2), metres, arena frame, come before the first that is not traversable.

        That is by the map as it is in `classes`; the grid itself need not have been updated to it, which costs more.
        """
        geometry = self.geometry
        cells = (positions - (geometry.origin_x_m, geometry.origin_y_m)) / geometry.resolution_m
        needed_cells = self.needed_m / geometry.resolution_m
        return int(_count_clear(classes, cells, needed_cells, self.unknown_cost is not None))

    def _with_swaths(self, swaths: Sequence[Swath]) -> NDArray[np.float32]:
        if not swaths:
            return self.cost
        geometry = self.geometry
        inside = np.zeros(geometry.shape, np.bool_)
        positions = [swath.positions for swath in swaths]
        cells = (np.concatenate(positions) - (geometry.origin_x_m, geometry.origin_y_m)) / geometry.resolution_m - 0.5
        reach_cells = np.array([swath.radius_m for swath in swaths]) / geometry.resolution_m
        _sweep(inside, cells, np.array([len(each) for each in positions]), reach_cells)
        cost = self.cost.copy()
        cost[inside] += np.float32(DEAR)
        return cost

    def costs_m(
        self,
        place: Point2D,
        cells: list[tuple[int, int]],
        *,
        snap_m: float,
        shut: Sequence[tuple[float, float, float]] = (),
    ) -> list[float]:
        """Cost of the path from a place to each of these cells, as metres on open floor; inf where there is none.

        Computed on a grid of twice the pitch, in a quarter of the time: good for comparing paths, not for driving. A
        grid with narrow places is used at its full resolution, because the coarse one would connect across walls.
        Narrow cells within the circles `shut` (x, y, radius in metres) count as blocked.
        """
        field = self.cost_field(place, snap_m=snap_m, shut=shut)
        return [math.inf] * len(cells) if field is None else field.to(cells)

    def cost_field(
        self, place: Point2D, *, snap_m: float, shut: Sequence[tuple[float, float, float]] = ()
    ) -> PathField | None:
        """Costs of the paths from a place to everywhere, as of `costs_m`; None if the robot cannot stand near there."""
        cell = self.snap(place, snap_m)
        if cell is None:
            return None
        if self.preferred_m > self.needed_m:
            pitch, traversable, cost = 1, self.without(shut, only_narrow=True), self.cost
        else:
            pitch, (traversable, cost) = COARSE, self._coarse
        source = np.array([(cell[0] // pitch, cell[1] // pitch)], dtype=np.int64)
        return PathField(distance_field(traversable, cost, source), pitch, pitch * self.geometry.resolution_m)

    @cached_property
    def _coarse(self) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        # A coarse cell is traversable if one of its cells is. That joins nothing that a wall parts, for no wall with
        # the robot's radius kept on both sides of it is narrower than two coarse cells.
        height, width = self.geometry.shape
        padded = (-height % COARSE, -width % COARSE)
        rows, columns = (height + padded[0]) // COARSE, (width + padded[1]) // COARSE
        cost = np.where(self.traversable, self.cost, np.float32(np.inf))
        cost = np.pad(cost, ((0, padded[0]), (0, padded[1])), constant_values=np.inf)
        least: NDArray[np.float32] = cost.reshape(rows, COARSE, columns, COARSE).min(axis=(1, 3))
        traversable = np.isfinite(least)
        return traversable, np.where(traversable, least, np.float32(1.0))

    def without(self, circles: Iterable[tuple[float, float, float]], *, only_narrow: bool = False) -> NDArray[np.bool_]:
        """The traversable cells outside these circles (x, y, radius in metres), or with `only_narrow` not narrow."""
        traversable = self.traversable
        for x_m, y_m, radius_m in circles:
            if traversable is self.traversable:
                traversable = traversable.copy()
            rows, columns, inside = self._disc(x_m, y_m, radius_m)
            traversable[rows, columns] &= ~(inside & self.narrow[rows, columns]) if only_narrow else ~inside
        return traversable

    def _disc(self, x_m: float, y_m: float, radius_m: float) -> tuple[slice, slice, NDArray[np.bool_]]:
        geometry = self.geometry
        low_row, low_column = geometry.cell_of(x_m - radius_m, y_m - radius_m)
        high_row, high_column = geometry.cell_of(x_m + radius_m, y_m + radius_m)
        height, width = geometry.shape
        rows = slice(min(max(low_row, 0), height), min(max(high_row + 1, 0), height))
        columns = slice(min(max(low_column, 0), width), min(max(high_column + 1, 0), width))
        center_y = geometry.origin_y_m + (np.arange(rows.start, rows.stop) + 0.5) * geometry.resolution_m
        center_x = geometry.origin_x_m + (np.arange(columns.start, columns.stop) + 0.5) * geometry.resolution_m
        distance_squared = (center_y[:, None] - y_m) ** 2 + (center_x[None, :] - x_m) ** 2
        return rows, columns, distance_squared <= radius_m**2


@njit(cache=True, nogil=True)
def _sweep(inside: NDArray[np.bool_], cells: Floats, counts: NDArray[np.int64], reaches_cells: Floats) -> None:
    """Mark cells within reach of positions (N, 2; x, y in cells); the first `counts[0]` have the first reach."""
    height, width = inside.shape
    end = 0
    for swath in range(counts.shape[0]):
        reach_cells, begin, end = reaches_cells[swath], end, end + counts[swath]
        for k in range(begin, end):
            x, y = cells[k, 0], cells[k, 1]
            for row in range(max(0, math.ceil(y - reach_cells)), min(height, math.floor(y + reach_cells) + 1)):
                half = math.sqrt(max(0.0, reach_cells**2 - (row - y) ** 2))
                for column in range(max(0, math.ceil(x - half)), min(width, math.floor(x + half) + 1)):
                    inside[row, column] = True


@njit(cache=True, nogil=True)
def _keep_right(corners: Floats, traversable: NDArray[np.bool_], aside_cells: float) -> Floats:
    """A path (N, 2; row, column) moved to its right as far as there is room, without sharp corners; its ends stay."""
    steps = np.hypot(corners[1:, 0] - corners[:-1, 0], corners[1:, 1] - corners[:-1, 1])
    counts = np.ceil(steps).astype(np.int64)
    count = 1 + counts.sum()
    path = np.empty((count, 2))
    k = 0
    for leg in range(counts.shape[0]):
        for step in range(counts[leg]):
            path[k] = corners[leg] + (step / counts[leg]) * (corners[leg + 1] - corners[leg])
            k += 1
    path[k] = corners[-1]
    moved = path.copy()
    for k in range(1, count - 1):
        low, high = max(0, k - ALONG), min(count - 1, k + ALONG)
        d_row, d_column = path[high] - path[low]
        length = math.hypot(d_row, d_column)
        room, most = 0.0, min(aside_cells, 0.5 * k, 0.5 * (count - 1 - k))
        while length > 0.0 and room + 0.5 <= most:
            row = path[k, 0] - (room + 0.5) * d_column / length
            column = path[k, 1] + (room + 0.5) * d_row / length
            if not is_chord_clear(traversable, path[k, 0], path[k, 1], row, column):
                if room < 0.5 * aside_cells:  # too narrow to pass: there the middle is better
                    moved[k] = path[k]
                break
            moved[k] = row, column
            room += 0.5
    kept = [0]
    smooth = moved.copy()
    for k in range(ALONG, count - 1, ALONG):
        near = min(ALONG, count - 1 - k)
        for axis in range(2):
            smooth[k, axis] = moved[k - near : k + near + 1, axis].mean()
        kept.append(k)
    kept.append(count - 1)
    for k in range(1, len(kept)):
        one, other = smooth[kept[k - 1]], smooth[kept[k]]
        if not is_chord_clear(traversable, one[0], one[1], other[0], other[1]):
            return path
    ends: Floats = smooth[np.array(kept)]
    return ends


@njit(cache=True, nogil=True)
def _centre(path: Floats, occupied: NDArray[np.bool_], traversable: NDArray[np.bool_], reach_cells: float) -> None:
    """Move each point of a path (N, 2; row, column) by at most half a cell to where it is farthest from obstacles.

    A point stays if the line to or from its new place would leave the traversable cells.
    """
    height, width = occupied.shape
    reach = math.ceil(reach_cells)
    distance_2 = np.empty((3, 3))
    for k in range(path.shape[0]):
        row, column = path[k, 0], path[k, 1]
        distance_2[:] = reach_cells * reach_cells
        for near_row in range(max(0, round(row) - reach), min(height, round(row) + reach + 1)):
            for near_column in range(max(0, round(column) - reach), min(width, round(column) + reach + 1)):
                if occupied[near_row, near_column]:
                    for i in range(3):
                        for j in range(3):
                            d_row, d_column = near_row - row - 0.5 * (i - 1), near_column - column - 0.5 * (j - 1)
                            distance_2[i, j] = min(distance_2[i, j], d_row * d_row + d_column * d_column)
        best_i, best_j = 1, 1
        for i in range(3):
            for j in range(3):
                if distance_2[i, j] > distance_2[best_i, best_j] + 1e-9:
                    best_i, best_j = i, j
        to_row, to_column = row + 0.5 * (best_i - 1), column + 0.5 * (best_j - 1)
        before, after = max(k - 1, 0), min(k + 1, path.shape[0] - 1)
        if is_chord_clear(traversable, path[before, 0], path[before, 1], to_row, to_column) and is_chord_clear(
            traversable, to_row, to_column, path[after, 0], path[after, 1]
        ):
            path[k, 0], path[k, 1] = to_row, to_column


@njit(cache=True, nogil=True)
def _count_clear(classes: NDArray[np.int8], cells: Floats, needed_cells: float, unknown_is_free: bool) -> int:
    height, width = classes.shape
    reach = math.ceil(needed_cells)
    for k in range(cells.shape[0]):
        row, column = math.floor(cells[k, 1]), math.floor(cells[k, 0])
        if not (0 <= row < height and 0 <= column < width):
            return k
        if not (classes[row, column] == FREE or (unknown_is_free and classes[row, column] != OCCUPIED)):
            return k
        for near_row in range(row - reach, row + reach + 1):
            for near_column in range(column - reach, column + reach + 1):
                apart_2 = (near_row - row) ** 2 + (near_column - column) ** 2
                if apart_2 >= needed_cells * needed_cells:
                    continue
                beyond = not (0 <= near_row < height and 0 <= near_column < width)
                if beyond or classes[near_row, near_column] == OCCUPIED:
                    return k
    return len(cells)
