"""Out of the way: the nearest place where a robot lets pass whoever goes first, and the way there ahead of them."""

import heapq
import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.navigation.right_of_way import STEP_M, Track
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.grid_geometry import GridGeometry

WINDOW_M = 12.0
"""Refuges are looked for within this distance, chosen: farther away another way is worth more than waiting."""
HEAD_START_S = 0.5
"""A mate comes later than foreseen by at least this: it starts first, and brakes before who is in its way."""
_ROW_STEPS = (-1, 0, 0, 1, -1, -1, 1, 1)
_COLUMN_STEPS = (0, -1, 1, 0, -1, 1, -1, 1)
_DIAGONAL = 2.0**0.5


def escape_cells(
    traversable: NDArray[np.bool_],
    geometry: GridGeometry,
    start: tuple[int, int],
    speed_m_s: float,
    tracks: Sequence[Track],
    apart_m: float,
) -> NDArray[np.int32] | None:
    """The way (N, 2), rows and columns, from a cell to the nearest one that nobody has still to pass; None for none.

    A cell closes when the first mate that goes first comes within its `keep_m + apart_m` of it, and a refuge is a cell
    that never closes. Each cell of the way is reached before it closes. As cells only ever close, Dijkstra's search
    finds the earliest arrival (Dreyfus, *An Appraisal of Some Shortest-Path Algorithms*, Operations Research 17, 1969).
    No mate is approached within that distance, whoever goes first. `traversable` is (H, W).
    """
    row, column = start
    reach = round(WINDOW_M / geometry.resolution_m)
    low_row, low_column = max(0, row - reach), max(0, column - reach)
    window = np.ascontiguousarray(traversable[low_row : row + reach + 1, low_column : column + reach + 1])
    closes_s = np.where(window, np.inf, 0.0)
    origin = (geometry.origin_x_m, geometry.origin_y_m)
    if tracks:
        positions = [track.positions for track in tracks]
        _close_all(
            closes_s,
            (np.concatenate(positions) - origin) / geometry.resolution_m - (low_column + 0.5, low_row + 0.5),
            np.array([len(each) for each in positions]),
            np.array([STEP_M / track.speed_m_s if track.goes_first else 0.0 for track in tracks]),
            np.array([(track.keep_m + apart_m) / geometry.resolution_m for track in tracks]),
            row - low_row,
            column - low_column,
        )
    found = _escape(window, closes_s, row - low_row, column - low_column, geometry.resolution_m / speed_m_s)
    return found + np.array([low_row, low_column], np.int32) if found.shape[0] else None


@njit(cache=True, nogil=True)
def _close_all(
    closes_s: Floats,
    cells: Floats,
    counts: NDArray[np.int64],
    steps_s: Floats,
    reaches_cells: Floats,
    row: int,
    column: int,
) -> None:
    """Close what each track closes to a robot at (row, column); `steps_s` of a track that does not go first is 0."""
    end = 0
    for track in range(counts.shape[0]):
        begin, end = end, end + counts[track]
        if steps_s[track] > 0.0:
            _close(closes_s, cells[begin:end], steps_s[track], HEAD_START_S, reaches_cells[track])
        # Who is nearer already only has to get away.
        away_cells = math.hypot(cells[begin, 0] - column, cells[begin, 1] - row)
        _close(closes_s, cells[begin : begin + 1], 1.0, 0.0, min(reaches_cells[track], away_cells))


@njit(cache=True, nogil=True)
def _close(closes_s: Floats, cells: Floats, step_s: float, begin_s: float, reach_cells: float) -> None:
    """Cells within reach of positions (N, 2; x, y in cells) close when these are passed, one each `step_s`."""
    height, width = closes_s.shape
    for k in range(cells.shape[0]):
        x, y = cells[k, 0], cells[k, 1]
        at_s = begin_s + k * step_s
        for row in range(max(0, math.ceil(y - reach_cells)), min(height, math.floor(y + reach_cells) + 1)):
            half = math.sqrt(max(0.0, reach_cells**2 - (row - y) ** 2))
            # The rim itself stays open: it is as near as that, and not nearer.
            for column in range(max(0, math.floor(x - half) + 1), min(width, math.ceil(x + half))):
                closes_s[row, column] = min(closes_s[row, column], at_s)


@njit(cache=True, nogil=True)
def _escape(
    traversable: NDArray[np.bool_], closes_s: Floats, row: int, column: int, cell_s: float
) -> NDArray[np.int32]:
    """The cells of the way, start included; none if there is no refuge."""
    height, width = traversable.shape
    arrives_s = np.full(height * width, np.inf)
    parent = np.full(height * width, -1, np.int64)
    start = row * width + column
    arrives_s[start] = 0.0
    heap = [(0.0, start)]
    while len(heap) > 0:
        at_s, cell = heapq.heappop(heap)
        if at_s > arrives_s[cell]:
            continue
        row, column = cell // width, cell % width
        if closes_s[row, column] == np.inf:
            count = 1
            back = cell
            while parent[back] >= 0:
                back = parent[back]
                count += 1
            way = np.empty((count, 2), np.int32)
            for k in range(count - 1, -1, -1):
                way[k, 0], way[k, 1] = cell // width, cell % width
                cell = parent[cell]
            return way
        for k in range(8):
            near_row, near_column = row + _ROW_STEPS[k], column + _COLUMN_STEPS[k]
            if not (0 <= near_row < height and 0 <= near_column < width and traversable[near_row, near_column]):
                continue
            if k >= 4 and not (traversable[row, near_column] and traversable[near_row, column]):
                continue
            near_s = at_s + (_DIAGONAL if k >= 4 else 1.0) * cell_s
            near = near_row * width + near_column
            if near_s < closes_s[near_row, near_column] and near_s < arrives_s[near]:
                arrives_s[near] = near_s
                parent[near] = cell
                heapq.heappush(heap, (near_s, near))
    return np.empty((0, 2), np.int32)
