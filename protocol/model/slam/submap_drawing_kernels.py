"""Drawing of submaps into the grid of a team: the compiled part of `SubmapAtlas`."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.protocol.model.slam.submap import TILE_CELLS, latest, take_cells

Box = tuple[int, int, int, int]
"""First row, first column, past-the-end row, past-the-end column."""


@njit(cache=True, nogil=True)
def take_and_draw(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    evidence: NDArray[np.int8],
    tile_stamps_ms: NDArray[np.int32],
    row: int,
    column: int,
    first: tuple[int, int],
    cells: NDArray[np.int8],
    stamp_ms: int,
    lookup: tuple[float, float, float, float],
    motion: tuple[float, float, float, float],
    grid: tuple[float, float, float],
) -> tuple[int, bool, int, int, Box]:
    """Take cells at (row, column) into a submap that begins at `first`, and draw them if that is right.

    Returns:
        More occupied cells; whether they were drawn; changed classes and newly known cells; the box of the team's grid.

    """
    height, width = cells.shape
    first_row, first_column = row - first[0], column - first[1]
    before_ms = latest(tile_stamps_ms, first_row, first_column, height, width)
    said_ms = np.full((1, 1), stamp_ms, np.int32)
    more, tiles = take_cells(evidence, tile_stamps_ms, first_row, first_column, cells, said_ms)
    # Whole tiles: the time has changed for each of their cells.
    top, left = row // TILE_CELLS * TILE_CELLS, column // TILE_CELLS * TILE_CELLS
    bottom, right = -(-(row + height) // TILE_CELLS) * TILE_CELLS, -(-(column + width) // TILE_CELLS) * TILE_CELLS
    cos, sin, x_m, y_m = motion
    if cos != 1.0 or sin != 0.0 or x_m != 0.0 or y_m != 0.0:
        top, left, bottom, right = _box_after(motion, (top, left, bottom, right), grid)
    top, left = max(top, 0), max(left, 0)
    bottom, right = min(bottom, log_odds.shape[0]), min(right, log_odds.shape[1])
    box = (top, left, bottom, right)
    if before_ms >= 0 and stamp_ms <= before_ms:
        return more, False, 0, 0, box
    if top >= bottom or left >= right:
        return more, True, 0, 0, box
    told = (first_row // TILE_CELLS, first_column // TILE_CELLS)
    changed, discovered = draw(log_odds, stamps_ms, box, evidence, tile_stamps_ms, lookup, told, tiles)
    return more, True, changed, discovered, box


@njit(cache=True, nogil=True)
def _box_after(motion: tuple[float, float, float, float], box: Box, grid: tuple[float, float, float]) -> Box:
    """As `moved_box`."""
    cos, sin, x_m, y_m = motion
    resolution_m, origin_x_m, origin_y_m = grid
    low_x = low_y = np.inf
    high_x = high_y = -np.inf
    for row in (box[0], box[2]):
        for column in (box[1], box[3]):
            at_x_m, at_y_m = origin_x_m + column * resolution_m, origin_y_m + row * resolution_m
            x = (x_m + cos * at_x_m - sin * at_y_m - origin_x_m) / resolution_m
            y = (y_m + sin * at_x_m + cos * at_y_m - origin_y_m) / resolution_m
            low_x, low_y, high_x, high_y = min(low_x, x), min(low_y, y), max(high_x, x), max(high_y, y)
    return math.floor(low_y), math.floor(low_x), math.ceil(high_y), math.ceil(high_x)


@njit(cache=True, nogil=True)
def draw(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    box: tuple[int, int, int, int],
    evidence: NDArray[np.int8],
    tile_stamps_ms: NDArray[np.int32],
    lookup: tuple[float, float, float, float],
    first_told: tuple[int, int],
    told: NDArray[np.bool_],
) -> tuple[int, int]:
    """Numbers of changed classes and of newly known cells. At least the tiles `told` are drawn; all if it is empty."""
    cos, sin, first_row, first_column = lookup
    height, width = evidence.shape
    down, right = math.floor(first_row), math.floor(first_column)
    is_middle = max(abs(first_row - down - 0.5), abs(first_column - right - 0.5)) < 0.25
    if cos == 1.0 and sin == 0.0 and is_middle:
        return _draw_tiles(log_odds, stamps_ms, box, evidence, tile_stamps_ms, down, right, first_told, told)
    changed, discovered = 0, 0
    for i in range(box[0], box[2]):
        for j in range(box[1], box[3]):
            row = math.floor(first_row + cos * i + sin * j)
            column = math.floor(first_column - sin * i + cos * j)
            if row < 0 or column < 0 or row >= height or column >= width:
                continue
            stamp_ms = tile_stamps_ms[row // TILE_CELLS, column // TILE_CELLS]
            flips, finds = _lay(log_odds, stamps_ms, i, j, evidence[row, column], stamp_ms)
            changed += flips
            discovered += finds
    return changed, discovered


@njit(cache=True, nogil=True)
def _draw_tiles(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    box: tuple[int, int, int, int],
    evidence: NDArray[np.int8],
    tile_stamps_ms: NDArray[np.int32],
    down: int,
    right: int,
    first_told: tuple[int, int],
    told: NDArray[np.bool_],
) -> tuple[int, int]:
    """As `_draw`, for a submap that is shifted by whole cells: cell (i, j) is the submap's (down + i, right + j)."""
    changed, discovered = 0, 0
    first_row, end_row = max(box[0] + down, 0), min(box[2] + down, evidence.shape[0])
    first_column, end_column = max(box[1] + right, 0), min(box[3] + right, evidence.shape[1])
    for tile_row in range(first_row // TILE_CELLS, (end_row - 1) // TILE_CELLS + 1):
        for tile_column in range(first_column // TILE_CELLS, (end_column - 1) // TILE_CELLS + 1):
            if told.size > 0:
                up, along = tile_row - first_told[0], tile_column - first_told[1]
                if up < 0 or along < 0 or up >= told.shape[0] or along >= told.shape[1] or not told[up, along]:
                    continue
            stamp_ms = tile_stamps_ms[tile_row, tile_column]
            top, left = tile_row * TILE_CELLS, tile_column * TILE_CELLS
            for row in range(max(top, first_row), min(top + TILE_CELLS, end_row)):
                for column in range(max(left, first_column), min(left + TILE_CELLS, end_column)):
                    flips, finds = _lay(
                        log_odds, stamps_ms, row - down, column - right, evidence[row, column], stamp_ms
                    )
                    changed += flips
                    discovered += finds
    return changed, discovered


@njit(cache=True, nogil=True)
def _lay(
    log_odds: NDArray[np.int8], stamps_ms: NDArray[np.int32], i: int, j: int, statement: int, stamp_ms: int
) -> tuple[int, int]:
    """Draw one cell; changed classes and newly known cells, each 0 or 1."""
    if statement == 0:
        return 0, 0
    value = log_odds[i, j]
    is_newer = stamp_ms > stamps_ms[i, j] or (stamp_ms == stamps_ms[i, j] and statement > 0 and value < 0)
    if value != 0 and not is_newer:
        return 0, 0
    log_odds[i, j] = statement
    stamps_ms[i, j] = stamp_ms
    if value == 0:
        return 1, 1
    return int((statement > 0) != (value > 0)), 0
