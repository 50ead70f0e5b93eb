"""The arithmetic of occupancy grids: evidence of scans, merging of patches."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN

LOG_ODDS_LIMIT = 100
"""Bound of the evidence. One unit is 1/20 nat, so the bound is a probability of 0.993."""
HIT_LOG_ODDS = 40
"""Evidence of a beam that ended in a cell: 2 nat, a probability of 0.88."""
MISS_LOG_ODDS = 10
"""Evidence of a scan that saw through a cell: half a nat, so it takes four such scans to undo one hit."""
FLIPPED_LOG_ODDS = 10
"""Evidence of the new class when a cell's evidence is used up and the cell flips."""
MERGED_LOG_ODDS = 60
"""Certainty given to what a team mate said."""
SURFACE_HITS_MAX = 30
"""Number of beams in the mean place of a cell; with more beams, older ones lose weight exponentially."""
HIT_DEPTH_CELLS = 0.2
"""How far behind the measured end a beam's obstacle is taken to be, so that a surface on the border of two cells
(where a wall of a map lies, and where range noise would fall on either side) marks the cell behind the border."""


@njit(cache=True, nogil=True)
def classes(log_odds: NDArray[np.int8]) -> NDArray[np.int8]:
    """Class of each cell, by the sign of its evidence."""
    result = np.empty(log_odds.shape, np.int8)
    for row in range(log_odds.shape[0]):
        for column in range(log_odds.shape[1]):
            value = log_odds[row, column]
            result[row, column] = UNKNOWN if value == 0 else (OCCUPIED if value > 0 else FREE)
    return result


@njit(cache=True, nogil=True)
def patch_of(
    mask: NDArray[np.bool_], log_odds: NDArray[np.int8], stamps_ms: NDArray[np.int32]
) -> tuple[int, int, NDArray[np.int8], int]:
    """Classes of the masked cells: row and column of the smallest box of them, its cells, the latest stamp.

    A box without cells if no cell is masked.
    """
    height, width = mask.shape
    first_row, end_row, first_column, end_column = height, 0, width, 0
    for row in range(height):
        is_any = False
        for column in range(width):
            is_any |= mask[row, column]
        if not is_any:
            continue
        first_row, end_row = min(first_row, row), row + 1
        column = 0
        while column < first_column and not mask[row, column]:
            column += 1
        first_column = min(first_column, column)
        column = width
        while column > end_column and not mask[row, column - 1]:
            column -= 1
        end_column = max(end_column, column)
    if end_row == 0:
        return 0, 0, np.empty((0, 0), np.int8), 0
    cells = np.empty((end_row - first_row, end_column - first_column), np.int8)
    stamp_ms = -1
    for row in range(first_row, end_row):
        for column in range(first_column, end_column):
            if not mask[row, column]:
                cells[row - first_row, column - first_column] = UNKNOWN
                continue
            value = log_odds[row, column]
            cells[row - first_row, column - first_column] = UNKNOWN if value == 0 else (OCCUPIED if value > 0 else FREE)
            stamp_ms = max(stamp_ms, stamps_ms[row, column])
    return first_row, first_column, cells, stamp_ms


@njit(cache=True, nogil=True)
def contradict(
    log_odds: NDArray[np.int8],
    dirty: NDArray[np.bool_],
    seen_by: NDArray[np.int32],
    since: int,
    others: NDArray[np.int8],
    first_row: int,
    first_column: int,
) -> None:
    """Mark floor that was seen by scan `since` or a later one and that is a wall in `others`."""
    height, width = log_odds.shape
    for i in range(others.shape[0]):
        for j in range(others.shape[1]):
            row, column = first_row + i, first_column + j
            if others[i, j] <= 0 or row < 1 or column < 1 or row >= height - 1 or column >= width - 1:
                continue
            if log_odds[row, column] >= 0 or seen_by[row, column] < since:
                continue
            is_floor = True
            for k in range(row - 1, row + 2):
                for n in range(column - 1, column + 2):
                    is_floor = is_floor and log_odds[k, n] <= 0
            if is_floor:
                dirty[row, column] = True


@njit(cache=True, nogil=True)
def merge(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    dirty: NDArray[np.bool_],
    first_row: int,
    first_column: int,
    cells: NDArray[np.int8],
    stamp_ms: int,
) -> tuple[int, int]:
    """Changed classes and newly known cells of a last-writer-wins merge."""
    changed = 0
    discovered = 0
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            statement = cells[i, j]
            if statement < 0:
                continue
            row, column = first_row + i, first_column + j
            occupied = statement > 0
            value = log_odds[row, column]
            known_ms = stamps_ms[row, column]
            if value == 0:
                discovered += 1
                changed += 1
            elif stamp_ms > known_ms or (stamp_ms == known_ms and occupied and value < 0):
                changed += occupied != (value > 0)
            else:
                continue
            log_odds[row, column] = MERGED_LOG_ODDS if occupied else -MERGED_LOG_ODDS
            stamps_ms[row, column] = stamp_ms
            dirty[row, column] = False
    return changed, discovered


@njit(cache=True, nogil=True)
def observe(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    dirty: NDArray[np.bool_],
    cell: int,
    evidence: int,
    stamp_ms: int,
) -> tuple[int, int]:
    """Add evidence to one cell of the flattened grid; changed classes and newly known cells, each 0 or 1."""
    before = int(log_odds[cell])
    after = before + evidence
    if after == 0:
        after = FLIPPED_LOG_ODDS if evidence > 0 else -FLIPPED_LOG_ODDS
    log_odds[cell] = max(-LOG_ODDS_LIMIT, min(LOG_ODDS_LIMIT, after))
    stamps_ms[cell] = max(stamp_ms, stamps_ms[cell])
    if before != 0 and (before > 0) == (after > 0):
        return 0, 0
    dirty[cell] = True
    return 1, 1 if before == 0 else 0


@njit(cache=True, nogil=True)
def integrate_scan(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    dirty: NDArray[np.bool_],
    seen_by: NDArray[np.int32],
    surface_at: NDArray[np.float32],
    surface_hits: NDArray[np.uint8],
    surface_view: NDArray[np.float32],
    surface_drift: NDArray[np.float32],
    drift: tuple[float, float],
    height: int,
    width: int,
    scan: int,
    first_scan: int,
    resolution_m: float,
    sensor_x: float,
    sensor_y: float,
    yaw_rad: float,
    angles_rad: Floats,
    ranges_m: Floats,
    range_max_m: float,
    stamp_ms: int,
    ignore: Floats,
) -> tuple[int, int]:
    """Changed classes and newly known cells of the flattened grid; sensor and circles in cells from its origin."""
    changed = 0
    discovered = 0
    beams = angles_rad.shape[0]
    end_x = np.full(beams, np.nan)
    end_y = np.full(beams, np.nan)
    is_hit = np.zeros(beams, np.bool_)
    keeps_surfaces = surface_hits.shape[0] > 1

    # Ends first: what this scan hit, none of its beams may free.
    for beam in range(beams):
        range_m = ranges_m[beam]
        if not range_m > 0:
            continue
        direction_x = math.cos(yaw_rad + angles_rad[beam])
        direction_y = math.sin(yaw_rad + angles_rad[beam])
        length = min(range_m, range_max_m) / resolution_m
        end_x[beam] = sensor_x + length * direction_x
        end_y[beam] = sensor_y + length * direction_y
        is_hit[beam] = range_m < range_max_m
        for k in range(ignore.shape[0]):
            dx, dy = end_x[beam] - ignore[k, 0], end_y[beam] - ignore[k, 1]
            if dx * dx + dy * dy <= ignore[k, 2] * ignore[k, 2]:
                is_hit[beam] = False
        if not is_hit[beam]:
            continue
        at_x, at_y = end_x[beam], end_y[beam]
        end_x[beam] += HIT_DEPTH_CELLS * direction_x
        end_y[beam] += HIT_DEPTH_CELLS * direction_y
        row, column = math.floor(end_y[beam]), math.floor(end_x[beam])
        cell = row * width + column
        if not (0 <= row < height and 0 <= column < width):
            continue
        if keeps_surfaces:
            hits = 0 if log_odds[cell] <= 0 and seen_by[cell] != scan + 1 else surface_hits[cell]
            if hits == 0:
                surface_drift[cell, 0], surface_drift[cell, 1] = drift
            hits = min(hits + 1, SURFACE_HITS_MAX)
            surface_hits[cell] = hits
            surface_at[cell, 0] += (at_x - surface_at[cell, 0]) / hits
            surface_at[cell, 1] += (at_y - surface_at[cell, 1]) / hits
            surface_view[cell, 0] += (direction_x - surface_view[cell, 0]) / hits
            surface_view[cell, 1] += (direction_y - surface_view[cell, 1]) / hits
        if seen_by[cell] != scan + 1:
            dirty[cell] |= seen_by[cell] < first_scan
            seen_by[cell] = scan + 1
            flips, finds = observe(log_odds, stamps_ms, dirty, cell, HIT_LOG_ODDS, stamp_ms)
            changed += flips
            discovered += finds

    # Then the way there: Amanatides and Woo, A Fast Voxel Traversal Algorithm for Ray Tracing, Eurographics 1987.
    start_row, start_column = math.floor(sensor_y), math.floor(sensor_x)
    crossed = np.empty(height + width, np.int64)
    for beam in range(beams):
        if math.isnan(end_x[beam]):
            continue
        row, column = start_row, start_column
        dx, dy = end_x[beam] - sensor_x, end_y[beam] - sensor_y
        # Crossings are counted, not compared with the beam's length, so that rounding cannot lead past its end.
        left_x = abs(math.floor(end_x[beam]) - start_column)
        left_y = abs(math.floor(end_y[beam]) - start_row)
        step_column = 1 if dx > 0 else -1
        step_row = 1 if dy > 0 else -1
        # Fractions of the beam from one border to the next, and from the sensor to the first.
        delta_x = 1.0 / abs(dx) if left_x > 0 else np.inf
        delta_y = 1.0 / abs(dy) if left_y > 0 else np.inf
        next_x = (column + 1 - sensor_x if dx > 0 else sensor_x - column) * delta_x if left_x > 0 else np.inf
        next_y = (row + 1 - sensor_y if dy > 0 else sensor_y - row) * delta_y if left_y > 0 else np.inf
        count = 0
        for _ in range(left_x + left_y):
            if 0 <= row < height and 0 <= column < width:
                crossed[count] = row * width + column
                count += 1
            if next_x < next_y:
                column += step_column
                left_x -= 1
                next_x = next_x + delta_x if left_x > 0 else np.inf
            else:
                row += step_row
                left_y -= 1
                next_y = next_y + delta_y if left_y > 0 else np.inf
        # The occupied cells just before a hit were grazed: a wall that fills half a cell is no less a wall.
        while is_hit[beam] and count > 0 and log_odds[crossed[count - 1]] > 0:
            count -= 1
        for k in range(count):
            cell = crossed[k]
            if seen_by[cell] < scan:
                dirty[cell] |= seen_by[cell] < first_scan
                seen_by[cell] = scan
                flips, finds = observe(log_odds, stamps_ms, dirty, cell, -MISS_LOG_ODDS, stamp_ms)
                changed += flips
                discovered += finds
    return changed, discovered
