"""Paths through a grid: one path, or the path cost from every cell.

Cells are (row, column). A step goes to one of the eight neighbours. It costs its length in cells (1 or √2) times the
mean cost of its two cells, the same in both directions. A diagonal step never cuts the corner of an untraversable cell.
Equal costs are settled by the order of expansion, which only depends on the arguments.
"""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import BOOL, FLOAT32, FLOAT64, INT32, INT64, UINT8, Floats, kernel_array
from robrain.protocol.model.grid_geometry import OCCUPIED


def standpoint(
    classes: NDArray[np.int8], traversable: NDArray[np.bool_], cell: tuple[int, int], reach_cells: int
) -> tuple[int, int] | None:
    """The traversable cell nearest to `cell` (itself, if it is one) with no known obstacle on the line to it.

    Within a Euclidean distance of `reach_cells`; None if there is none. Of equally near cells the one with the lowest
    row, then column. `classes` and `traversable` are (H, W); `cell` is row and column, and may lie outside.
    """
    row, column = _standpoint(classes, traversable, cell[0], cell[1], reach_cells)
    return (row, column) if row >= 0 else None


@njit(cache=True, nogil=True)
def _standpoint(
    classes: NDArray[np.int8], traversable: NDArray[np.bool_], row: int, column: int, reach: int
) -> tuple[int, int]:
    height, width = classes.shape
    best_2, best_row, best_column = reach * reach + 1, -1, -1
    for at_row in range(max(0, row - reach), min(height, row + reach + 1)):
        for at_column in range(max(0, column - reach), min(width, column + reach + 1)):
            away_2 = (at_row - row) ** 2 + (at_column - column) ** 2
            if away_2 < best_2 and traversable[at_row, at_column] and _sees(classes, at_row, at_column, row, column):
                best_2, best_row, best_column = away_2, at_row, at_column
    return best_row, best_column


@njit(cache=True, nogil=True)
def _sees(classes: NDArray[np.int8], row: int, column: int, to_row: int, to_column: int) -> bool:
    """Whether the straight line between two cells' centres crosses no occupied cell, by two checks a cell."""
    checks = 2 * max(abs(to_row - row), abs(to_column - column))
    for check in range(1, checks):
        share = check / checks
        between_row = math.floor(row + share * (to_row - row) + 0.5)
        between_column = math.floor(column + share * (to_column - column) + 0.5)
        if classes[between_row, between_column] == OCCUPIED:
            return False
    return True


BUCKETS_MAX = 4096


@njit(cache=True, nogil=True)
def spread(traversable: NDArray[np.bool_], cost: NDArray[np.float32], sources: NDArray[np.int64]) -> Floats:
    """Cost of the path from each cell to the nearest source, (H, W), in cells; inf where there is none.

    Sources (K, 2) that are untraversable or outside are passed over. See `path_planning.distance_field`.
    """
    height, width = traversable.shape
    wide = width + 2  # a border of untraversable cells: neighbours need no check against the edges
    half = np.full((height + 2) * wide, np.inf, np.float32)
    least, most = np.inf, 0.0
    for row in range(height):
        for column in range(width):
            if traversable[row, column]:
                cell_cost = float(cost[row, column])
                half[(row + 1) * wide + column + 1] = np.float32(0.5) * cost[row, column]
                least, most = min(least, cell_cost), max(most, cell_cost)
    distance = np.full(half.size, np.inf)
    bucket_width = max(least, most * _DIAGONAL / BUCKETS_MAX)
    if 0.0 < bucket_width < np.inf:
        first = np.full(int(most * _DIAGONAL / bucket_width) + 3, -1, np.int32)
        after, before = np.full(half.size, -1, np.int32), np.full(half.size, -1, np.int32)
        waiting = 0
        for k in range(sources.shape[0]):
            row, column = sources[k, 0], sources[k, 1]
            cell = (row + 1) * wide + column + 1
            if 0 <= row < height and 0 <= column < width and traversable[row, column] and distance[cell] > 0.0:
                distance[cell] = 0.0
                _put(first, after, before, cell, 0)
                waiting += 1
        _settle(half, distance, first, after, before, waiting, wide, bucket_width)
    return distance.reshape(height + 2, wide)[1:-1, 1:-1].copy()


@njit(cache=True, nogil=True)
def _put(first: NDArray[np.int32], after: NDArray[np.int32], before: NDArray[np.int32], cell: int, bucket: int) -> None:
    after[cell] = first[bucket]
    before[cell] = -1
    if first[bucket] >= 0:
        before[first[bucket]] = cell
    first[bucket] = cell


@njit(cache=True, nogil=True)
def _handle(
    first: NDArray[np.int32], after: NDArray[np.int32], before: NDArray[np.int32], cell: int, bucket: int
) -> None:
    if before[cell] >= 0:
        after[before[cell]] = after[cell]
    else:
        first[bucket] = after[cell]
    if after[cell] >= 0:
        before[after[cell]] = before[cell]


@njit(cache=True, nogil=True)
def _settle(
    half: NDArray[np.float32],
    distance: Floats,
    first: NDArray[np.int32],
    after: NDArray[np.int32],
    before: NDArray[np.int32],
    waiting: int,
    wide: int,
    bucket_width: float,
) -> None:
    """Relax cell after cell until none waits; `first` is the ring of buckets, each a list linked both ways."""
    steps = (-wide, -1, 1, wide, -wide - 1, 1 - wide, wide - 1, wide + 1)
    waits = np.zeros(half.size, np.bool_)
    ring = first.size
    waits[distance == 0.0] = True
    bucket = 0
    while waiting > 0:
        cell = first[bucket]
        if cell < 0:
            bucket = bucket + 1 if bucket + 1 < ring else 0
            continue
        _handle(first, after, before, cell, bucket)
        waits[cell] = False
        waiting -= 1
        for k in range(8):
            near = cell + steps[k]
            if k >= 4:
                side = steps[0] if k < 6 else steps[3]
                if half[cell + side] == np.inf or half[near - side] == np.inf:
                    continue
            step_cost = half[cell] + half[near]
            through = distance[cell] + (_DIAGONAL * step_cost if k >= 4 else step_cost)
            if through >= distance[near]:
                continue
            if waits[near]:
                _handle(first, after, before, near, int(distance[near] / bucket_width) % ring)
            else:
                waits[near] = True
                waiting += 1
            distance[near] = through
            _put(first, after, before, near, int(through / bucket_width) % ring)


_ROW_STEPS = (-1, 0, 0, 1, -1, -1, 1, 1)
_COLUMN_STEPS = (0, -1, 1, 0, -1, 1, -1, 1)
_DIAGONAL = 2.0**0.5
Weights = NDArray[np.float32]
NO_STEPS = np.zeros((0, 0), np.uint8)
ALONG_MIN = 1e-6
"""A step across a direction does not lead against it."""
CUT_CELLS = 4.0
"""The most that is cut off each side of a corner, chosen: two radii of a robot at 0.1 m a cell."""


def plan_path(
    traversable: NDArray[np.bool_],
    cost: NDArray[np.float32],
    start: tuple[int, int],
    goal: tuple[int, int],
    shut_steps: NDArray[np.uint8] | None = None,
) -> NDArray[np.int32] | None:
    """The cheapest path as cells (N, 2), start and goal included, or None where there is none.

    `traversable` (H, W); `cost` (H, W) of the cells, at least 1, or the path may not be the cheapest; `shut_steps` as
    of `steps_against`. A start or goal that is untraversable or outside has no path; see `nearest_traversable`. A* of
    Hart, Nilsson and Raphael, *A Formal Basis for the Heuristic Determination of Minimum Cost Paths*, 1968, with the
    octile distance as heuristic.
    """
    mask, cost = _as_grids(traversable, cost)
    if not (_is_traversable(mask, start) and _is_traversable(mask, goal)):
        return None
    shut = NO_STEPS if shut_steps is None else kernel_array(shut_steps, UINT8)
    parent = _search(mask, cost, shut, int(start[0]), int(start[1]), int(goal[0]), int(goal[1]))
    width = mask.shape[1]
    goal_index = int(goal[0]) * width + int(goal[1])
    if parent[goal_index] < 0:
        return None
    return _trace_back(parent, goal_index, width)


def steps_against(directed: Sequence[tuple[NDArray[np.bool_], float]], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Steps that lead against the direction of an area: bits of the eight neighbours, for each cell, (H, W).

    Args:
        directed: mask (H, W) and direction, radians, of each area.
        shape: of the grid.

    """
    shut_steps = np.zeros(shape, np.uint8)
    for mask, direction_rad in directed:
        along = np.array(_COLUMN_STEPS) * math.cos(direction_rad) + np.array(_ROW_STEPS) * math.sin(direction_rad)
        shut_steps[mask] |= np.uint8((1 << np.flatnonzero(along < -ALONG_MIN)).sum())
    return shut_steps


def measured_field(field: Weights, traversable: NDArray[np.bool_], cost: Weights, weight: Weights) -> Weights:
    """Length of the cheapest path from every cell, with other weights of the cells than those that made it cheapest.

    Args:
        field: of `distance_field`, (H, W).
        traversable: as there.
        cost: as there.
        weight: of the cells, (H, W).

    """
    order = np.argsort(field, axis=None, kind="stable")
    return _measure(kernel_array(field, FLOAT32), *_as_grids(traversable, cost), kernel_array(weight, FLOAT32), order)


@njit(cache=True, nogil=True)
def _measure(
    field: Weights, traversable: NDArray[np.bool_], cost: Weights, weight: Weights, order: NDArray[np.int64]
) -> Weights:
    height, width = field.shape
    length = np.full((height, width), np.inf, np.float32)
    for cell in order:
        row, column = cell // width, cell % width
        if field[row, column] == np.inf:
            break
        least = np.inf
        length[row, column] = 0.0
        for k in range(8):
            near_row, near_column = row + _ROW_STEPS[k], column + _COLUMN_STEPS[k]
            if not (0 <= near_row < height and 0 <= near_column < width and traversable[near_row, near_column]):
                continue
            if k >= 4 and not (traversable[row, near_column] and traversable[near_row, column]):
                continue
            half = (_DIAGONAL if k >= 4 else 1.0) * 0.5
            through = field[near_row, near_column] + half * (cost[row, column] + cost[near_row, near_column])
            if field[near_row, near_column] < field[row, column] and through < least:
                least = through
                step = half * (weight[row, column] + weight[near_row, near_column])
                length[row, column] = length[near_row, near_column] + step
    return length


def distance_field(
    traversable: NDArray[np.bool_], cost: NDArray[np.float32], sources: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Cost of the cheapest path from every cell to the nearest source, in cells, float32 (H, W); inf if there is none.

    `sources` (K, 2) are cells with cost 0; those that are untraversable or outside are passed over. The costs are
    those of `plan_path`. Dijkstra, *A Note on Two Problems in Connexion with Graphs*, 1959.
    """
    mask, cost = _as_grids(traversable, cost)
    return spread(mask, cost, kernel_array(sources, INT64)).astype(np.float32)


def shorten_path(cells: NDArray[np.int32], traversable: NDArray[np.bool_]) -> NDArray[np.int32]:
    """The cells (M, 2) of a path at which it has to turn, its first and last included.

    Straight lines between them touch traversable cells only (and pass no corner of others). The mask may be stricter
    than the one of the planned path, for example the cells with comfortable clearance. The path is then shortened where
    the mask allows and kept elsewhere.
    """
    mask = kernel_array(traversable, BOOL)
    path = kernel_array(cells, INT32)
    if path.shape[0] < 3:
        return path.copy()
    return _shorten(path, mask)


def round_corners(cells: NDArray[np.int32], traversable: NDArray[np.bool_]) -> Floats:
    """The corners of a path (N, 2) rounded where the mask allows: rows and columns (M, 2), whole at a cell's middle.

    Each corner is cut twice, at a quarter of its shorter side and at `CUT_CELLS` at most. The method is that of Chaikin
    (*An Algorithm for High-Speed Curve Generation*, Computer Graphics and Image Processing 3, 1974). A cut that would
    touch an untraversable cell is not made. First and last cell stay.
    """
    mask = kernel_array(traversable, BOOL)
    path = kernel_array(cells, FLOAT64)
    for _ in range(2):
        if path.shape[0] > 2:
            path = _round(path, mask)
    return path


def nearest_traversable(
    traversable: NDArray[np.bool_], cell: tuple[int, int], radius_cells: int
) -> tuple[int, int] | None:
    """The traversable cell nearest to `cell` (itself, if it is one) within a Euclidean radius, or None.

    Of equally near cells the one with the lowest row, then column. `cell` may lie outside the grid.
    """
    mask = kernel_array(traversable, BOOL)
    row, column = _nearest(mask, int(cell[0]), int(cell[1]), int(radius_cells))
    return (row, column) if row >= 0 else None


def _as_grids(
    traversable: NDArray[np.bool_], cost: NDArray[np.float32]
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    return kernel_array(traversable, BOOL), kernel_array(cost, FLOAT32)


def _is_traversable(mask: NDArray[np.bool_], cell: tuple[int, int]) -> bool:
    row, column = cell
    return 0 <= row < mask.shape[0] and 0 <= column < mask.shape[1] and bool(mask[row, column])


@njit(cache=True, nogil=True)
def _sift_up(heap: NDArray[np.int32], slot_of: NDArray[np.int32], priority: Floats, slot: int) -> None:
    cell = heap[slot]
    while slot > 0:
        above = (slot - 1) >> 1
        if priority[heap[above]] <= priority[cell]:
            break
        heap[slot] = heap[above]
        slot_of[heap[slot]] = slot
        slot = above
    heap[slot] = cell
    slot_of[cell] = slot


@njit(cache=True, nogil=True)
def _sift_down(heap: NDArray[np.int32], slot_of: NDArray[np.int32], priority: Floats, count: int) -> None:
    slot = 0
    cell = heap[0]
    while 2 * slot + 1 < count:
        below = 2 * slot + 1
        if below + 1 < count and priority[heap[below + 1]] < priority[heap[below]]:
            below += 1
        if priority[cell] <= priority[heap[below]]:
            break
        heap[slot] = heap[below]
        slot_of[heap[slot]] = slot
        slot = below
    heap[slot] = cell
    slot_of[cell] = slot


@njit(cache=True, nogil=True)
def _search(
    traversable: NDArray[np.bool_],
    cost: NDArray[np.float32],
    shut_steps: NDArray[np.uint8],
    start_row: int,
    start_column: int,
    goal_row: int,
    goal_column: int,
) -> NDArray[np.int32]:
    """Parents of the flattened cells: −1 where a cell was not reached; the start is its own.

    The heap holds cells and knows each one's slot, so that a cell found on a cheaper path moves up in place.
    """
    height, width = traversable.shape
    distance = np.full(height * width, np.inf)
    priority = np.empty(height * width)
    parent = np.full(height * width, -1, np.int32)
    heap = np.empty(height * width, np.int32)
    slot_of = np.empty(height * width, np.int32)
    closed = np.zeros(height * width, np.bool_)
    start, goal = start_row * width + start_column, goal_row * width + goal_column
    distance[start] = priority[start] = 0.0
    parent[start] = heap[0] = start
    slot_of[start] = 0
    count = 1
    while count > 0:
        cell = heap[0]
        if cell == goal:
            break
        closed[cell] = True
        count -= 1
        if count > 0:
            heap[0] = heap[count]
            _sift_down(heap, slot_of, priority, count)
        row, column = cell // width, cell % width
        for k in range(8):
            near_row, near_column = row + _ROW_STEPS[k], column + _COLUMN_STEPS[k]
            if not (0 <= near_row < height and 0 <= near_column < width and traversable[near_row, near_column]):
                continue
            if k >= 4 and not (traversable[row, near_column] and traversable[near_row, column]):
                continue
            near = near_row * width + near_column
            if closed[near]:
                continue
            if shut_steps.size and ((shut_steps[row, column] | shut_steps[near_row, near_column]) >> k) & 1:
                continue
            length = _DIAGONAL if k >= 4 else 1.0
            through = distance[cell] + length * 0.5 * (float(cost[row, column]) + float(cost[near_row, near_column]))
            if through >= distance[near]:
                continue
            if parent[near] < 0:
                slot_of[near] = count
                heap[count] = near
                count += 1
            distance[near] = through
            parent[near] = cell
            rows, columns = abs(near_row - goal_row), abs(near_column - goal_column)
            priority[near] = through + (max(rows, columns) + (_DIAGONAL - 1.0) * min(rows, columns))
            _sift_up(heap, slot_of, priority, slot_of[near])
    return parent


@njit(cache=True, nogil=True)
def _trace_back(parent: NDArray[np.int32], goal: int, width: int) -> NDArray[np.int32]:
    count = 1
    cell = goal
    while parent[cell] != cell:
        cell = parent[cell]
        count += 1
    path = np.empty((count, 2), np.int32)
    cell = goal
    for k in range(count - 1, -1, -1):
        path[k, 0] = cell // width
        path[k, 1] = cell % width
        cell = parent[cell]
    return path


@njit(cache=True, nogil=True)
def _is_line_clear(traversable: NDArray[np.bool_], row: int, column: int, to_row: int, to_column: int) -> bool:
    """Whether all cells that the line between two cells' middles touches are traversable; in integers, exact."""
    rows, columns = abs(to_row - row), abs(to_column - column)
    step_row = 1 if to_row > row else -1
    step_column = 1 if to_column > column else -1
    if not traversable[row, column]:
        return False
    crossed_rows, crossed_columns = 0, 0
    while crossed_rows < rows or crossed_columns < columns:
        # The next borders lie at (2·crossed + 1) / (2·total) of the line; compared without dividing.
        until_column = (2 * crossed_columns + 1) * rows
        until_row = (2 * crossed_rows + 1) * columns
        if until_column == until_row:
            if not (traversable[row, column + step_column] and traversable[row + step_row, column]):
                return False
            row += step_row
            column += step_column
            crossed_rows += 1
            crossed_columns += 1
        elif until_column < until_row:
            column += step_column
            crossed_columns += 1
        else:
            row += step_row
            crossed_rows += 1
        if not traversable[row, column]:
            return False
    return True


@njit(cache=True, nogil=True)
def _shorten(path: NDArray[np.int32], traversable: NDArray[np.bool_]) -> NDArray[np.int32]:
    kept = np.empty_like(path)
    kept[0] = path[0]
    count = 1
    anchor = 0
    for k in range(2, path.shape[0]):
        if not _is_line_clear(traversable, path[anchor, 0], path[anchor, 1], path[k, 0], path[k, 1]):
            anchor = k - 1
            kept[count] = path[anchor]
            count += 1
    kept[count] = path[path.shape[0] - 1]
    return kept[: count + 1].copy()


@njit(cache=True, nogil=True)
def _round(path: Floats, traversable: NDArray[np.bool_]) -> Floats:
    rounded = np.empty((2 * path.shape[0], 2))
    rounded[0] = path[0]
    count = 1
    for k in range(1, path.shape[0] - 1):
        before_row, before_column = path[k - 1, 0] - path[k, 0], path[k - 1, 1] - path[k, 1]
        after_row, after_column = path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1]
        before = np.hypot(before_row, before_column)
        after = np.hypot(after_row, after_column)
        cut = min(CUT_CELLS, 0.25 * min(before, after))
        row, column = path[k, 0] + cut / before * before_row, path[k, 1] + cut / before * before_column
        to_row, to_column = path[k, 0] + cut / after * after_row, path[k, 1] + cut / after * after_column
        if cut > 0.5 and is_chord_clear(traversable, row, column, to_row, to_column):
            rounded[count, 0], rounded[count, 1] = row, column
            rounded[count + 1, 0], rounded[count + 1, 1] = to_row, to_column
            count += 2
        else:
            rounded[count] = path[k]
            count += 1
    rounded[count] = path[path.shape[0] - 1]
    return rounded[: count + 1].copy()


@njit(cache=True, nogil=True)
def is_chord_clear(traversable: NDArray[np.bool_], row: float, column: float, to_row: float, to_column: float) -> bool:
    """Whether a line between two places, in cells, touches traversable cells only; sampled every 0.1 cell."""
    height, width = traversable.shape
    steps = int(10.0 * np.hypot(to_row - row, to_column - column)) + 1
    for k in range(steps + 1):
        share = k / steps
        at_row = int(np.floor(row + share * (to_row - row) + 0.5))
        at_column = int(np.floor(column + share * (to_column - column) + 0.5))
        if not (0 <= at_row < height and 0 <= at_column < width and traversable[at_row, at_column]):
            return False
    return True


@njit(cache=True, nogil=True)
def _nearest(traversable: NDArray[np.bool_], row: int, column: int, radius_cells: int) -> tuple[int, int]:
    """(row, column), or (−1, −1) for none."""
    height, width = traversable.shape
    nearest = (-1, -1)
    best = radius_cells * radius_cells + 1
    for near_row in range(max(0, row - radius_cells), min(height, row + radius_cells + 1)):
        for near_column in range(max(0, column - radius_cells), min(width, column + radius_cells + 1)):
            apart = (near_row - row) ** 2 + (near_column - column) ** 2
            if apart < best and traversable[near_row, near_column]:
                best = apart
                nearest = (near_row, near_column)
    return nearest
