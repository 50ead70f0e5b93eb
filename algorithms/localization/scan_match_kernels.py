"""The arithmetic of scan matching on an occupancy grid. Places are in cells of the grid unless said otherwise."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.localization.gauss_newton_kernels import add_residual, held_directions, lever_of, solve_step
from robrain.algorithms.numeric.kernel_array import Floats

ITERATIONS = 12
DONE_CELLS = 0.002
NEAR_M = 0.2
IN_FRONT_CELLS = (2.0, 3.0)
"""Distances before a beam's end, cells, at which the map has free floor if it saw the same side of the wall."""


@njit(cache=True, nogil=True)
def distance_window(
    log_odds: NDArray[np.int8], first_row: int, first_column: int, rows: int, columns: int, reach: int
) -> NDArray[np.float32]:
    """(rows, columns) distance in cells of each cell's middle to that of the nearest occupied one; at most `reach`."""
    field = np.full((rows, columns), np.float32(reach))
    height, width = log_odds.shape
    side = 2 * reach + 1
    disc = np.empty((side, side), np.float32)
    for i in range(side):
        for j in range(side):
            disc[i, j] = math.sqrt((i - reach) ** 2 + (j - reach) ** 2)
    for row in range(max(first_row - reach, 0), min(first_row + rows + reach, height)):
        for column in range(max(first_column - reach, 0), min(first_column + columns + reach, width)):
            if log_odds[row, column] <= 0:
                continue
            top, left = row - first_row - reach, column - first_column - reach
            for i in range(max(0, -top), min(side, rows - top)):
                for j in range(max(0, -left), min(side, columns - left)):
                    field[top + i, left + j] = min(field[top + i, left + j], disc[i, j])
    return field


@njit(cache=True, nogil=True)
def _window(points: Floats, per_m: float, x: float, y: float, margin: int) -> tuple[int, int, int, int]:
    """Box of cells that holds the points, turned whichever way, about (x, y): first row and column, rows, columns."""
    square = 0.0
    for k in range(points.shape[0]):
        square = max(square, points[k, 0] ** 2 + points[k, 1] ** 2)
    half = math.ceil(math.sqrt(square) * per_m) + margin
    return math.floor(y) - half, math.floor(x) - half, 2 * half + 1, 2 * half + 1


@njit(cache=True, nogil=True)
def refine(
    log_odds: NDArray[np.int8],
    per_m: float,
    origin_x_m: float,
    origin_y_m: float,
    x_m: float,
    y_m: float,
    yaw_rad: float,
    points: Floats,
    reach_m: float,
    degenerate: float,
    beams_min: int,
) -> tuple[Floats, int, float, int]:
    """Held directions as `held_directions` has them; how many; the fit; beams compared."""
    height, width = log_odds.shape
    start_x, start_y = (x_m - origin_x_m) * per_m, (y_m - origin_y_m) * per_m
    if points.shape[0] < beams_min:
        return np.zeros((3, 5)), 0, 0.0, 0
    reach = math.ceil(reach_m * per_m)
    first_row, first_column, rows, columns = _window(points, per_m, start_x, start_y, 2 * reach + 2)
    field = distance_window(log_odds, first_row, first_column, rows, columns, reach)
    lever = lever_of(points, per_m)
    x, y, yaw = start_x, start_y, yaw_rad
    held = 0
    vectors = np.zeros((3, 3))
    values = np.zeros(3)
    information, pull, step = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for _iteration in range(ITERATIONS):
        information[:] = 0.0
        pull[:] = 0.0
        used = 0
        cos, sin = math.cos(yaw), math.sin(yaw)
        for k in range(points.shape[0]):
            out_x = per_m * (cos * points[k, 0] - sin * points[k, 1])
            out_y = per_m * (sin * points[k, 0] + cos * points[k, 1])
            # Bilinear between the middles of four cells.
            at_column, at_row = x + out_x - 0.5 - first_column, y + out_y - 0.5 - first_row
            column, row = math.floor(at_column), math.floor(at_row)
            if row < 0 or column < 0 or row + 1 >= rows or column + 1 >= columns:
                continue
            right, up = at_column - column, at_row - row
            low_left, low_right = field[row, column], field[row, column + 1]
            high_left, high_right = field[row + 1, column], field[row + 1, column + 1]
            distance = (1 - up) * ((1 - right) * low_left + right * low_right) + up * (
                (1 - right) * high_left + right * high_right
            )
            if distance >= reach - 1:
                continue
            slope_x = (1 - up) * (low_right - low_left) + up * (high_right - high_left)
            slope_y = (1 - right) * (high_left - low_left) + right * (high_right - low_right)
            by_turn = (slope_y * out_x - slope_x * out_y) / lever
            weight = 1.0 if distance < 1.0 else 1.0 / distance  # Huber: what is far off may be something else
            used += 1
            add_residual(information, pull, slope_x, slope_y, by_turn, distance, weight)
        if used < beams_min:
            held = 0
            break
        held, size = solve_step(information, pull, degenerate * used, values, vectors, step)
        if size > 1.0:
            step /= size
        x += step[0]
        y += step[1]
        yaw += step[2] / lever
        if size < DONE_CELLS:
            break

    moved = x - start_x, y - start_y, (yaw - yaw_rad) * lever
    found = held_directions(held, values, vectors, moved, lever, per_m)
    compared, near = 0, 0
    cos, sin = math.cos(yaw), math.sin(yaw)
    for k in range(points.shape[0]):
        row = math.floor(y + per_m * (sin * points[k, 0] + cos * points[k, 1]))
        column = math.floor(x + per_m * (cos * points[k, 0] - sin * points[k, 1]))
        if row < 0 or column < 0 or row >= height or column >= width:
            continue
        distance = field[row - first_row, column - first_column]
        if log_odds[row, column] != 0 or distance < 2.0:
            compared += 1
            near += distance <= NEAR_M * per_m
    return found, held, near / max(compared, 1), compared


@njit(cache=True, nogil=True)
def in_view(
    log_odds: NDArray[np.int8], x: float, y: float, yaw_rad: float, per_m: float, points: Floats
) -> NDArray[np.bool_]:
    """Which points, in metres, lie just behind free cells, as seen from (x, y)."""
    height, width = log_odds.shape
    is_seen = np.zeros(points.shape[0], np.bool_)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    for k in range(points.shape[0]):
        out_x = per_m * (cos * points[k, 0] - sin * points[k, 1])
        out_y = per_m * (sin * points[k, 0] + cos * points[k, 1])
        length = math.sqrt(out_x * out_x + out_y * out_y)
        for before in IN_FRONT_CELLS:
            share = max(length - before, 0.0) / length
            row, column = math.floor(y + share * out_y), math.floor(x + share * out_x)
            if 0 <= row < height and 0 <= column < width and log_odds[row, column] < 0:
                is_seen[k] = True
    return is_seen


@njit(cache=True, nogil=True)
def search(
    log_odds: NDArray[np.int8],
    per_m: float,
    origin_x_m: float,
    origin_y_m: float,
    x_m: float,
    y_m: float,
    yaw_rad: float,
    points: Floats,
    steps: int,
    turns: int,
    turn_rad: float,
    apart: int,
    apart_turns: int,
) -> tuple[int, int, int, float, float]:
    """Best turn, column and row offset about the guess, its score, and the best score away from it."""
    start_x, start_y = (x_m - origin_x_m) * per_m, (y_m - origin_y_m) * per_m
    reach = 2
    first_row, first_column, rows, columns = _window(points, per_m, start_x, start_y, steps + 2)
    field = distance_window(log_odds, first_row, first_column, rows, columns, reach)
    side = 2 * steps + 1
    scores = np.zeros((2 * turns + 1, side, side), np.float32)
    best, best_turn, best_row, best_column = np.float32(-1.0), 0, 0, 0
    for turn in range(2 * turns + 1):
        angle = yaw_rad + (turn - turns) * turn_rad
        cos, sin = math.cos(angle), math.sin(angle)
        for k in range(points.shape[0]):
            row = math.floor(start_y + per_m * (sin * points[k, 0] + cos * points[k, 1])) - first_row
            column = math.floor(start_x + per_m * (cos * points[k, 0] - sin * points[k, 1])) - first_column
            for i in range(side):
                for j in range(side):
                    scores[turn, i, j] += 1.0 - field[row - steps + i, column - steps + j] / reach
        for i in range(side):
            for j in range(side):
                if scores[turn, i, j] > best:
                    best, best_turn, best_row, best_column = scores[turn, i, j], turn, i, j
    second = np.float32(0.0)
    for turn in range(2 * turns + 1):
        for i in range(side):
            for j in range(side):
                if abs(turn - best_turn) > apart_turns or abs(i - best_row) > apart or abs(j - best_column) > apart:
                    second = max(second, scores[turn, i, j])
    return best_turn - turns, best_column - steps, best_row - steps, float(best), float(second)


@njit(cache=True, nogil=True)
def without_dropouts(ranges_m: Floats, range_max_m: float, misses_min: int) -> Floats:
    """A copy with NaN for runs, around the whole scan, of fewer than `misses_min` ranges at the maximum."""
    count = ranges_m.shape[0]
    heard_m = ranges_m.copy()
    first = 0  # a beam with a return: runs are counted from there
    while first < count and not ranges_m[first] < range_max_m:
        first += 1
    if first == count:
        return heard_m
    run = 0
    for n in range(1, count + 1):
        beam = (first + n) % count
        if not ranges_m[beam] < range_max_m:
            run += 1
            continue
        if run < misses_min:
            for back in range(1, run + 1):
                heard_m[(beam - back) % count] = np.nan
        run = 0
    return heard_m
