"""Match a scan against a grid with surfaces, to a fraction of a cell.

Each occupied cell of an `OccupancyGrid` with surfaces keeps the mean of the beam ends in it. The match minimises the
distance of each beam end from the line through the means near it. This is point-to-line ICP (Censi, *An ICP variant
using a point-to-line metric*, ICRA 2008). The grid of means is that of the normal distributions transform of Biber and
Straßer, IROS 2003. A match against the cells themselves is accurate to a third of a cell at best. From one spot its
error is always the same. The two sides of a thin wall are two surfaces.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.localization.scan_match import (
    DEGENERATE,
    ScanFit,
    add_residual,
    held_directions,
    in_cells,
    lever_of,
    scan_fit,
    solve_step,
)
from robrain.algorithms.mapping.occupancy_grid import HIT_DEPTH_CELLS, OccupancyGrid, Surfaces
from robrain.algorithms.numeric.kernel_array import FLOAT64, Floats, kernel_array
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

COMPARED_MIN = 0.5
"""Share of a scan's beams that must end on known map before the scan is compared with it."""
WALL_NEAR_CELLS = 2.0
"""A beam ends at a wall of the map that is this near."""
BODY_M = 0.5
"""Walls nearer than this may be the robot itself, as the others saw it."""
SHORT_M = 0.3
"""A beam may end this far behind a wall of the map before it has gone through it."""


def agreement(log_odds: NDArray[np.int8], geometry: GridGeometry, sensor: Pose2D, points: Floats) -> tuple[float, int]:
    """Share of a scan's beams that agree with the map, seen from `sensor` (arena frame), and how many were compared.

    `points` (K, 2) are the beams' ends in the sensor's frame, see `beam_ends`. A beam agrees that ends at a wall of the
    map and goes through none. Beams that end on unknown floor are not compared.
    """
    agreeing, compared = _agreement(
        log_odds,
        1.0 / geometry.resolution_m,
        (sensor.x_m - geometry.origin_x_m) / geometry.resolution_m,
        (sensor.y_m - geometry.origin_y_m) / geometry.resolution_m,
        sensor.yaw_rad,
        points,
    )
    return agreeing / max(compared, 1), compared


@njit(cache=True, nogil=True)
def _agreement(
    log_odds: NDArray[np.int8], per_m: float, x: float, y: float, yaw_rad: float, points: Floats
) -> tuple[int, int]:
    """Beams that agree, and beams compared; `x` and `y` in cells."""
    height, width = log_odds.shape
    around = math.ceil(WALL_NEAR_CELLS)
    agreeing, compared = 0, 0
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    for k in range(points.shape[0]):
        out_x = per_m * (cos * points[k, 0] - sin * points[k, 1])
        out_y = per_m * (sin * points[k, 0] + cos * points[k, 1])
        length = math.hypot(out_x, out_y)
        is_blocked = False
        at = BODY_M * per_m
        while at < length - SHORT_M * per_m and not is_blocked:
            row, column = math.floor(y + out_y * at / length), math.floor(x + out_x * at / length)
            is_blocked = 0 <= row < height and 0 <= column < width and log_odds[row, column] > 0
            at += 1.0
        row, column = math.floor(y + out_y), math.floor(x + out_x)
        is_near = False
        for i in range(max(row - around, 0), min(row + around + 1, height)):
            for j in range(max(column - around, 0), min(column + around + 1, width)):
                if log_odds[i, j] > 0 and math.hypot(i - row, j - column) <= WALL_NEAR_CELLS:
                    is_near = True
        is_known = 0 <= row < height and 0 <= column < width and log_odds[row, column] != 0
        if is_near or is_blocked or is_known:
            compared += 1
            agreeing += is_near and not is_blocked
    return agreeing, compared


ITERATIONS = 15
WIDE_CELLS, NEAR_CELLS = 3.0, 1.5
"""Largest distance, cells, between a beam's end and its surface: in the first `WIDE_STEPS` steps, and later."""
WIDE_STEPS = 4
DONE_CELLS = 0.001
"""The iteration ends after a step shorter than this, cells."""
HUBER_CELLS = 0.3
"""Beams that end farther from their line weigh less (Huber's loss), cells."""
USED_MIN = 8
"""Least number of beams that end near a surface."""
INFORMATION_MIN = 1.5
"""Least information of a direction, in beams that meet their wall at right angles; less does not determine it."""
SPREAD_MAX = 4
"""Largest distance, cells, of the means that are joined to a line."""
LINE_MIN = 3
"""Least number of means that make a line."""
OPPOSITE = -0.8
"""Beams with a smaller cosine between their directions met opposite sides of a wall."""
ROUGH = 0.15
"""Largest ratio of the variance of means across their line to that along it."""
FIT_CELLS = 2.0
"""Largest distance, cells, between a surface and the end of a beam that agrees with the map."""
AROUND = 3
"""Rows and columns around a beam's end in which surfaces are gathered. The first step searches all of them, so that
later steps with shorter searches find their surfaces there too."""
FAR = 1 << 30
"""Not the row or column of any cell."""


def match_surface(grid: OccupancyGrid, guess: Pose2D, points: Floats) -> tuple[ScanFit, tuple[float, float]]:
    """Refine a guess that is wrong by less than 0.3 m and 0.15 rad.

    Args:
        grid: a grid with surfaces.
        guess: T_grid_sensor.
        points: (K, 2) ends of the beams in the sensor's frame, metres.

    Returns:
        The fit, and the mean drift of the surfaces that the beams were matched to: m², rad².

    """
    found, held, fit, beams, drift_m2, drift_rad2 = _match(
        grid.log_odds, grid.surfaces, *in_cells(guess, grid.geometry), kernel_array(points, FLOAT64)
    )
    return scan_fit(found, held, fit, beams), (drift_m2, drift_rad2)


@njit(cache=True, nogil=True)
def _gather(
    log_odds: NDArray[np.int8],
    surfaces: Surfaces,
    row: int,
    column: int,
    cells: NDArray[np.int32],
    near: NDArray[np.float32],
) -> int:
    """Copy the surfaces at most `AROUND` from (row, column): row, column; place, view. Returns how many there are."""
    height, width = log_odds.shape
    count = 0
    for i in range(max(row - AROUND, 0), min(row + AROUND + 1, height)):
        for j in range(max(column - AROUND, 0), min(column + AROUND + 1, width)):
            if log_odds[i, j] > 0 and surfaces.hits[i, j] > 0:
                cells[count, 0], cells[count, 1] = i, j
                near[count, 0], near[count, 1] = surfaces.at[i, j, 0], surfaces.at[i, j, 1]
                near[count, 2], near[count, 3] = surfaces.seen_along[i, j, 0], surfaces.seen_along[i, j, 1]
                count += 1
    return count


@njit(cache=True, nogil=True)
def _nearest(
    cells: NDArray[np.int32],
    near: NDArray[np.float32],
    count: int,
    x: float,
    y: float,
    beam_x: float,
    beam_y: float,
    row: int,
    column: int,
    around: int,
    reach: float,
) -> int:
    """Which of the gathered surfaces is nearest to (x, y), cells; −1 if none is in reach."""
    best = reach * reach
    found = -1
    for n in range(count):
        square = (near[n, 0] - x) ** 2 + (near[n, 1] - y) ** 2
        if square >= best or abs(cells[n, 0] - row) > around or abs(cells[n, 1] - column) > around:
            continue
        # The other side of a thin wall is another surface.
        if near[n, 2] * beam_x + near[n, 3] * beam_y > OPPOSITE:
            best, found = square, n
    return found


@njit(cache=True, nogil=True)
def _line(log_odds: NDArray[np.int8], surfaces: Surfaces, best_row: int, best_column: int, line: Floats) -> bool:
    """Write a point (2,) and the normal (2,) of the wall in a cell, in cells; False if it is no line."""
    height, width = log_odds.shape
    base_x, base_y = float(surfaces.at[best_row, best_column, 0]), float(surfaces.at[best_row, best_column, 1])
    view_x, view_y = surfaces.seen_along[best_row, best_column, 0], surfaces.seen_along[best_row, best_column, 1]
    # Far from the sensor the ends of neighbouring beams are several cells apart.
    for spread in range(1, SPREAD_MAX + 1):
        weight = mean_x = mean_y = xx = xy = yy = 0.0
        count = 0
        for i in range(max(best_row - spread, 0), min(best_row + spread + 1, height)):
            for j in range(max(best_column - spread, 0), min(best_column + spread + 1, width)):
                if log_odds[i, j] <= 0 or surfaces.hits[i, j] == 0:
                    continue
                if surfaces.seen_along[i, j, 0] * view_x + surfaces.seen_along[i, j, 1] * view_y <= OPPOSITE:
                    continue
                hits = min(float(surfaces.hits[i, j]), 8.0)
                dx, dy = surfaces.at[i, j, 0] - base_x, surfaces.at[i, j, 1] - base_y
                weight += hits
                mean_x += hits * dx
                mean_y += hits * dy
                xx += hits * dx * dx
                xy += hits * dx * dy
                yy += hits * dy * dy
                count += 1
        if count >= LINE_MIN:
            break
    if count < LINE_MIN:
        return False
    mean_x /= weight
    mean_y /= weight
    xx, xy, yy = xx / weight - mean_x * mean_x, xy / weight - mean_x * mean_y, yy / weight - mean_y * mean_y
    middle, half = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    if middle - half > ROUGH * (middle + half):
        return False
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    line[0], line[1] = base_x + mean_x, base_y + mean_y
    line[2], line[3] = -math.sin(angle), math.cos(angle)
    return True


@njit(cache=True, nogil=True)
def _match(
    log_odds: NDArray[np.int8],
    surfaces: Surfaces,
    per_m: float,
    start_x: float,
    start_y: float,
    yaw_rad: float,
    points: Floats,
) -> tuple[Floats, int, float, int, float, float]:
    """Results as of `scan_match.refine`, and the mean drift of the surfaces."""
    count = points.shape[0]
    if count < USED_MIN:
        return np.zeros((3, 5)), 0, 0.0, 0, 0.0, 0.0
    height, width = log_odds.shape
    lever = lever_of(points, per_m)
    x, y, yaw = start_x, start_y, yaw_rad
    held = 0
    vectors, values = np.zeros((3, 3)), np.zeros(3)
    information, pull, step = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    lines, is_line, cells = np.zeros((count, 4)), np.zeros(count, np.bool_), np.full(count, -1)
    # Surfaces about each beam's end: row and column about which they were gathered, their number, and their values.
    about = np.full((count, 3), FAR)
    near_cells = np.empty((count, (2 * AROUND + 1) ** 2, 2), np.int32)
    near_surfaces = np.empty((count, (2 * AROUND + 1) ** 2, 4), np.float32)
    size = 0.0
    for iteration in range(ITERATIONS):
        is_wide = iteration < WIDE_STEPS and (iteration == 0 or size > 0.3)
        reach, around = (WIDE_CELLS, 3) if is_wide else (NEAR_CELLS, 2)
        information[:] = 0.0
        pull[:] = 0.0
        used = 0
        cos, sin = math.cos(yaw), math.sin(yaw)
        for k in range(count):
            out_x = per_m * (cos * points[k, 0] - sin * points[k, 1])
            out_y = per_m * (sin * points[k, 0] + cos * points[k, 1])
            at_x, at_y = x + out_x, y + out_y
            length = math.sqrt(out_x * out_x + out_y * out_y)
            beam_x, beam_y = out_x / length, out_y / length
            row, column = math.floor(at_y + HIT_DEPTH_CELLS * beam_y), math.floor(at_x + HIT_DEPTH_CELLS * beam_x)
            if row < 0 or column < 0 or row >= height or column >= width:
                continue
            if abs(row - about[k, 0]) > AROUND - around or abs(column - about[k, 1]) > AROUND - around:
                about[k, 0], about[k, 1] = row, column
                about[k, 2] = _gather(log_odds, surfaces, row, column, near_cells[k], near_surfaces[k])
            n = _nearest(
                near_cells[k], near_surfaces[k], about[k, 2], at_x, at_y, beam_x, beam_y, row, column, around, reach
            )
            if n < 0:
                continue
            cell = near_cells[k, n, 0] * width + near_cells[k, n, 1]
            if cell != cells[k]:  # in most steps a beam ends at the wall at which it ended before
                cells[k] = cell
                if k > 0 and cells[k - 1] == cell:  # and often at that at which its neighbour ends
                    is_line[k], lines[k] = is_line[k - 1], lines[k - 1]
                else:
                    is_line[k] = _line(log_odds, surfaces, cell // width, cell % width, lines[k])
            if not is_line[k]:
                continue
            line = lines[k]
            view_x, view_y = near_surfaces[k, n, 2], near_surfaces[k, n, 3]
            if not (line[2] * view_x + line[3] * view_y) * (line[2] * beam_x + line[3] * beam_y) > 0.0:
                continue
            off = line[2] * (at_x - line[0]) + line[3] * (at_y - line[1])
            by_turn = (line[3] * out_x - line[2] * out_y) / lever
            weight = 1.0 if abs(off) < HUBER_CELLS else HUBER_CELLS / abs(off)
            used += 1
            add_residual(information, pull, line[2], line[3], by_turn, off, weight)
        if used < USED_MIN:
            held = 0
            break
        least = max(DEGENERATE * used, INFORMATION_MIN)
        held, size = solve_step(information, pull, least, values, vectors, step)
        if size > 2.0:
            step *= 2.0 / size
        x += step[0]
        y += step[1]
        yaw += step[2] / lever
        if size < DONE_CELLS:
            break

    moved = x - start_x, y - start_y, (yaw - yaw_rad) * lever
    found = held_directions(held, values, vectors, moved, lever, per_m)
    compared, near = 0, 0
    drift_m2 = drift_rad2 = 0.0
    cos, sin = math.cos(yaw), math.sin(yaw)
    for k in range(count):
        at_x = x + per_m * (cos * points[k, 0] - sin * points[k, 1])
        at_y = y + per_m * (sin * points[k, 0] + cos * points[k, 1])
        row, column = math.floor(at_y), math.floor(at_x)
        if row < 0 or column < 0 or row >= height or column >= width:
            continue
        is_near = False
        nearest, nearest_row, nearest_column = FIT_CELLS * FIT_CELLS, 0, 0
        if abs(row - about[k, 0]) > AROUND - 2 or abs(column - about[k, 1]) > AROUND - 2:
            about[k, 0], about[k, 1] = row, column
            about[k, 2] = _gather(log_odds, surfaces, row, column, near_cells[k], near_surfaces[k])
        for n in range(about[k, 2]):
            i, j = near_cells[k, n, 0], near_cells[k, n, 1]
            square = (near_surfaces[k, n, 0] - at_x) ** 2 + (near_surfaces[k, n, 1] - at_y) ** 2
            if square <= nearest and abs(i - row) <= 2 and abs(j - column) <= 2:
                is_near = True
                nearest, nearest_row, nearest_column = square, i, j
        if is_near:
            drift_m2 += surfaces.drift[nearest_row, nearest_column, 0]
            drift_rad2 += surfaces.drift[nearest_row, nearest_column, 1]
        if log_odds[row, column] != 0 or is_near:
            compared += 1
            near += is_near
    return found, held, near / max(compared, 1), compared, drift_m2 / max(near, 1), drift_rad2 / max(near, 1)
