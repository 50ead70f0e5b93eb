"""Drawing of submaps into the grid of a team: the compiled part of `SubmapAtlas`."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.slam.submap import TILE_CELLS

Box = tuple[int, int, int, int]
"""First row, first column, past-the-end row, past-the-end column."""


@njit(cache=True, nogil=True)
def draw_tiles(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    grid: tuple[float, float, float],
    begins: NDArray[np.int64],
    firsts: NDArray[np.int64],
    places: NDArray[np.float64],
    at: NDArray[np.int32],
    tiles_ms: NDArray[np.int32],
    cells: NDArray[np.int8],
) -> tuple[int, int]:
    """Draw tiles of one submap after the other.

    Args:
        log_odds: of the team's grid.
        stamps_ms: likewise.
        grid: its resolution and origin, metres.
        begins: (submaps + 1,) where each submap's tiles begin in the next arrays but two.
        firsts: (submaps, 2) row and column of each submap's first cell.
        places: (submaps, 8) where it lies: `motion` and `lookup` of `SubmapPlace`.
        at: (tiles, 2) as in `Tiles`.
        tiles_ms: (tiles,) likewise.
        cells: (tiles, 8, 8) likewise.

    Returns:
        Numbers of changed classes and of newly known cells.

    """
    changed, discovered = 0, 0
    for submap in range(begins.shape[0] - 1):
        first_row, first_column = firsts[submap]
        cos, sin, x_m, y_m, lookup_cos, lookup_sin, lookup_row, lookup_column = places[submap]
        is_turned = lookup_cos != 1.0 or lookup_sin != 0.0
        down, right = math.floor(lookup_row), math.floor(lookup_column)
        is_shifted = not is_turned and max(abs(lookup_row - down - 0.5), abs(lookup_column - right - 0.5)) < 0.25
        for tile in range(begins[submap], begins[submap + 1]):
            top, left = at[tile, 0] * TILE_CELLS, at[tile, 1] * TILE_CELLS
            bottom, end = top + TILE_CELLS, left + TILE_CELLS
            if is_shifted:
                box = top - down, left - right, bottom - down, end - right
            else:
                box = (first_row + top, first_column + left, first_row + bottom, first_column + end)
                box = _box_after((cos, sin, x_m, y_m), box, grid)
            for i in range(max(box[0], 0), min(box[2], log_odds.shape[0])):
                for j in range(max(box[1], 0), min(box[3], log_odds.shape[1])):
                    if is_shifted:
                        row, column = i + down, j + right
                    else:
                        row = math.floor(lookup_row + lookup_cos * i + lookup_sin * j)
                        column = math.floor(lookup_column - lookup_sin * i + lookup_cos * j)
                        if row < top or column < left or row >= bottom or column >= end:
                            continue
                    flips, finds = _lay(
                        log_odds, stamps_ms, i, j, cells[tile, row - top, column - left], tiles_ms[tile]
                    )
                    changed += flips
                    discovered += finds
    return changed, discovered


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
) -> tuple[int, int]:
    """Draw a submap's cells within a box of the grid; numbers of changed classes and of newly known cells."""
    cos, sin, first_row, first_column = lookup
    height, width = evidence.shape
    down, right = math.floor(first_row), math.floor(first_column)
    is_middle = max(abs(first_row - down - 0.5), abs(first_column - right - 0.5)) < 0.25
    if cos == 1.0 and sin == 0.0 and is_middle:
        return _draw_shifted(log_odds, stamps_ms, box, evidence, tile_stamps_ms, down, right)
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
def _draw_shifted(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    box: tuple[int, int, int, int],
    evidence: NDArray[np.int8],
    tile_stamps_ms: NDArray[np.int32],
    down: int,
    right: int,
) -> tuple[int, int]:
    """As `draw`, for a submap that is shifted by whole cells: cell (i, j) is the submap's (down + i, right + j)."""
    changed, discovered = 0, 0
    for row in range(max(box[0] + down, 0), min(box[2] + down, evidence.shape[0])):
        for column in range(max(box[1] + right, 0), min(box[3] + right, evidence.shape[1])):
            stamp_ms = tile_stamps_ms[row // TILE_CELLS, column // TILE_CELLS]
            flips, finds = _lay(log_odds, stamps_ms, row - down, column - right, evidence[row, column], stamp_ms)
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
