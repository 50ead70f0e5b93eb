"""Where a scan fits on the map: Gauss–Newton on the distance to the nearest wall, and a search over a window.

The refinement is that of Kohlbrecher et al., *A flexible and scalable SLAM system with full 3D motion estimation*, SSRR
2011. It uses a distance field in place of occupancy. The search is that of Olson, *Real-time correlative scan
matching*, ICRA 2009, at one resolution. In some directions the walls give no information, as along a corridor. The
eigenvalues of the information reveal these directions, which stay unchanged. Source: Zhang, Kaess, Singh, *On
degeneracy of optimization-based state estimation problems*, ICRA 2016.
"""

import math

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.mapping.occupancy_grid import HIT_DEPTH_CELLS
from robrain.algorithms.numeric.kernel_array import FLOAT64, Floats, kernel_array
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

REACH_M = 0.4
"""A beam that ends farther from all walls than this has no effect on the refinement."""
DEGENERATE = 0.08
"""A direction with less than this share of the information that each beam could give is not believed; chosen."""
BEAMS_MIN = 20
SEARCH_STEP_RAD = 0.035
FIT_MIN = 0.7
"""Least score of a beam, as a mean, of a search's answer."""
AMBIGUOUS = 0.75
"""A second place that fits this well, compared with the best, makes a search's answer worthless."""
APART_M, APART_RAD = 0.5, 0.25
"""A pose farther from the best one than this is another place."""
SWEEPS = 12
"""Limit; Jacobi's method needs four or five sweeps for a 3 × 3 matrix."""
NEGLIGIBLE = 1e-17


@njit(cache=True, nogil=True)
def eigen(matrix: Floats, values: Floats, vectors: Floats) -> None:
    """Write a symmetric matrix's eigenvalues (3,), ascending, and eigenvectors (3, 3), as columns; overwrites `matrix`.

    Jacobi's method, cyclic by rows (Golub and Van Loan, *Matrix Computations*, section 8.5), because LAPACK's results
    differ by processor; see `small_linear_algebra`. The sign of an eigenvector is arbitrary.
    """
    for i in range(3):
        for j in range(3):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _sweep in range(SWEEPS):
        if matrix[0, 1] == 0.0 and matrix[0, 2] == 0.0 and matrix[1, 2] == 0.0:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                aside = matrix[p, q]
                if abs(aside) <= NEGLIGIBLE * min(abs(matrix[p, p]), abs(matrix[q, q])):
                    matrix[p, q] = matrix[q, p] = 0.0
                    continue
                half = (matrix[q, q] - matrix[p, p]) / (2.0 * aside)
                tan = 1.0 / (abs(half) + math.sqrt(half * half + 1.0))
                if half < 0.0:
                    tan = -tan
                cos = 1.0 / math.sqrt(tan * tan + 1.0)
                sin = tan * cos
                matrix[p, p] -= tan * aside
                matrix[q, q] += tan * aside
                matrix[p, q] = matrix[q, p] = 0.0
                k = 3 - p - q
                by_p, by_q = matrix[k, p], matrix[k, q]
                matrix[k, p] = matrix[p, k] = cos * by_p - sin * by_q
                matrix[k, q] = matrix[q, k] = sin * by_p + cos * by_q
                for i in range(3):
                    by_p, by_q = vectors[i, p], vectors[i, q]
                    vectors[i, p] = cos * by_p - sin * by_q
                    vectors[i, q] = sin * by_p + cos * by_q
    for i in range(3):
        values[i] = matrix[i, i]
    for last in range(2, 0, -1):
        for k in range(last):
            if values[k] > values[k + 1]:
                values[k], values[k + 1] = values[k + 1], values[k]
                for i in range(3):
                    vectors[i, k], vectors[i, k + 1] = vectors[i, k + 1], vectors[i, k]


@njit(cache=True, nogil=True)
def lever_of(points: Floats, per_m: float) -> float:
    """Cells by which a turn of one radian moves the points, as a root mean square."""
    square = 0.0
    for k in range(points.shape[0]):
        square += points[k, 0] ** 2 + points[k, 1] ** 2
    return per_m * math.sqrt(square / points.shape[0])


@njit(cache=True, nogil=True)
def add_residual(
    information: Floats, pull: Floats, by_x: float, by_y: float, by_turn: float, residual: float, weight: float
) -> None:
    """Add a residual with these derivatives to the normal equations: upper triangle (3, 3) and right side (3,)."""
    information[0, 0] += weight * by_x * by_x
    information[0, 1] += weight * by_x * by_y
    information[0, 2] += weight * by_x * by_turn
    information[1, 1] += weight * by_y * by_y
    information[1, 2] += weight * by_y * by_turn
    information[2, 2] += weight * by_turn * by_turn
    pull[0] -= weight * residual * by_x
    pull[1] -= weight * residual * by_y
    pull[2] -= weight * residual * by_turn


@njit(cache=True, nogil=True)
def solve_step(
    information: Floats, pull: Floats, least: float, values: Floats, vectors: Floats, step: Floats
) -> tuple[int, float]:
    """Solve the normal equations for `step` (3,): how many directions are held, and the step's length.

    A direction is held if its information is at least `least`. A direction with less information here may have enough
    at the right place, so the step follows it too, but slowly. Writes eigenvalues and eigenvectors as `eigen` does;
    overwrites `information`.
    """
    information[1, 0], information[2, 0], information[2, 1] = information[0, 1], information[0, 2], information[1, 2]
    eigen(information, values, vectors)
    held = 0
    step[:] = 0.0
    for k in range(3):
        held += values[k] >= least
        along = 0.0
        for i in range(3):
            along += vectors[i, k] * pull[i]
        for i in range(3):
            step[i] += vectors[i, k] * along / max(values[k], least)
    return held, math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)


@njit(cache=True, nogil=True)
def held_directions(
    held: int, values: Floats, vectors: Floats, moved: tuple[float, float, float], lever: float, per_m: float
) -> Floats:
    """Held directions (3, 5) as row in m and rad, offset in m, information; `moved` is the scan's displacement."""
    found = np.zeros((3, 5))
    for at in range(held):
        k = 3 - held + at  # eigenvalues ascend
        found[at, 0], found[at, 1], found[at, 2] = vectors[0, k], vectors[1, k], vectors[2, k] * lever / per_m
        offset = vectors[0, k] * moved[0] + vectors[1, k] * moved[1] + vectors[2, k] * moved[2]
        found[at, 3], found[at, 4] = offset / per_m, values[k]
    return found


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
    """Box of cells that holds the points at any rotation about (x, y): first row and column, rows, columns."""
    square = 0.0
    for k in range(points.shape[0]):
        square = max(square, points[k, 0] ** 2 + points[k, 1] ** 2)
    half = math.ceil(math.sqrt(square) * per_m) + margin
    return math.floor(y) - half, math.floor(x) - half, 2 * half + 1, 2 * half + 1


@njit(cache=True, nogil=True)
def refine(
    log_odds: NDArray[np.int8],
    per_m: float,
    start_x: float,
    start_y: float,
    yaw_rad: float,
    points: Floats,
    reach_m: float,
) -> tuple[Floats, int, float, int]:
    """Held directions as `held_directions` has them; how many; the fit; beams compared."""
    height, width = log_odds.shape
    if points.shape[0] < BEAMS_MIN:
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
            weight = 1.0 if distance < 1.0 else 1.0 / distance  # Huber: a far point may belong to something else
            used += 1
            add_residual(information, pull, slope_x, slope_y, by_turn, distance, weight)
        if used < BEAMS_MIN:
            held = 0
            break
        held, size = solve_step(information, pull, DEGENERATE * used, values, vectors, step)
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
    log_odds: NDArray[np.int8], per_m: float, x: float, y: float, yaw_rad: float, points: Floats
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
    start_x: float,
    start_y: float,
    yaw_rad: float,
    points: Floats,
    steps: int,
    turns: int,
    apart: int,
) -> tuple[int, int, int, float, float]:
    """Best turn, column and row offset about the guess, its score, and the best score away from it."""
    reach = 2
    apart_turns = math.ceil(APART_RAD / SEARCH_STEP_RAD)
    first_row, first_column, rows, columns = _window(points, per_m, start_x, start_y, steps + 2)
    field = distance_window(log_odds, first_row, first_column, rows, columns, reach)
    side = 2 * steps + 1
    scores = np.zeros((2 * turns + 1, side, side), np.float32)
    best, best_turn, best_row, best_column = np.float32(-1.0), 0, 0, 0
    for turn in range(2 * turns + 1):
        angle = yaw_rad + (turn - turns) * SEARCH_STEP_RAD
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
def _without_dropouts(ranges_m: Floats, range_max_m: float, misses_min: int) -> Floats:
    """A copy with NaN for runs, around the whole scan, of fewer than `misses_min` ranges at the maximum."""
    count = ranges_m.shape[0]
    received_m = ranges_m.copy()
    first = 0  # a beam with a return: runs are counted from there
    while first < count and not ranges_m[first] < range_max_m:
        first += 1
    if first == count:
        return received_m
    run = 0
    for n in range(1, count + 1):
        beam = (first + n) % count
        if not ranges_m[beam] < range_max_m:
            run += 1
            continue
        if run < misses_min:
            for back in range(1, run + 1):
                received_m[(beam - back) % count] = np.nan
        run = 0
    return received_m


class Direction(msgspec.Struct, frozen=True):
    """One direction of (x, y, yaw) in which walls hold the robot: row · (true pose − guess) = offset_m."""

    row: tuple[float, float, float]
    offset_m: float
    information: float
    """Sum over the beams of how much each moves along its wall's normal with this direction: 0 to their number."""


class ScanFit(msgspec.Struct, frozen=True):
    """Fit of a scan on a map."""

    directions: list[Direction]
    """Those that are held; at most three, at right angles once yaw is counted in metres at the mean range."""
    fit: float
    """Share of the compared beams that end within 0.2 m of a wall of the map, at the place found; 0 if there are
    none."""
    beams: int
    """Beams that end where the map is known."""


def match_walls(
    log_odds: NDArray[np.int8], geometry: GridGeometry, guess: Pose2D, walls: Floats, reach_m: float = REACH_M
) -> ScanFit:
    """Refine a guess that is wrong by less than `reach_m`; walls farther from all walls of the map are ignored.

    `log_odds` (H, W) is an `OccupancyGrid`'s; `guess` is T_arena_sensor; `walls` (K, 2) are the middles of another
    map's occupied cells, sensor's frame.
    """
    return scan_fit(*refine(log_odds, *in_cells(guess, geometry), walls, reach_m))


def scan_fit(found: Floats, held: int, fit: float, beams: int) -> ScanFit:
    """Result of a kernel, see `refine`."""
    directions = [Direction((a, b, c), offset_m, held_by) for a, b, c, offset_m, held_by in found[:held].tolist()]
    return ScanFit(directions, fit, beams)


def in_cells(pose: Pose2D, geometry: GridGeometry) -> tuple[float, float, float, float]:
    """Cells per metre; the pose's place in cells from the grid's origin; its yaw."""
    per_m = 1.0 / geometry.resolution_m
    x, y = (pose.x_m - geometry.origin_x_m) * per_m, (pose.y_m - geometry.origin_y_m) * per_m
    return per_m, x, y, float(pose.yaw_rad)


def search_scan(
    log_odds: NDArray[np.int8],
    geometry: GridGeometry,
    guess: Pose2D,
    points: Floats,
    *,
    within_m: float,
    within_rad: float,
) -> Pose2D | None:
    """Search for the scan's place around a guess; None if nothing fits well, or more than one place does.

    `points` are a scan's, see `beam_ends`; the others are as for `match_walls`. The answer is right to a
    cell and `SEARCH_STEP_RAD`: refine it.
    """
    if len(points) < BEAMS_MIN:
        return None
    steps, turns = math.ceil(within_m / geometry.resolution_m), math.ceil(within_rad / SEARCH_STEP_RAD)
    turn, column, row, best, second = search(
        log_odds,
        *in_cells(guess, geometry),
        _in_walls(points, geometry),
        steps,
        turns,
        math.ceil(APART_M / geometry.resolution_m),
    )
    if best < FIT_MIN * len(points) or second > AMBIGUOUS * best:
        return None
    return Pose2D(
        guess.x_m + column * geometry.resolution_m,
        guess.y_m + row * geometry.resolution_m,
        math.remainder(guess.yaw_rad + turn * SEARCH_STEP_RAD, math.tau),
    )


def points_in_view(log_odds: NDArray[np.int8], geometry: GridGeometry, sensor: Pose2D, points: Floats) -> Floats:
    """The points just behind free floor of the map: those at walls that the map shows from the same side.

    Other beams ended at something that the map does not have, or at the far side of a wall. Arguments are as for
    `search_scan`.
    """
    seen: Floats = points[in_view(log_odds, *in_cells(sensor, geometry), points)]
    return seen


def beam_ends(angles_rad: Floats, ranges_m: Floats, range_max_m: float) -> Floats:
    """(K, 2): where the beams (N,) of a scan ended, in the sensor's frame, metres.

    Ranges of `range_max_m` or more, or not above 0, ended nowhere. Raises ValueError for arrays that do not fit.
    """
    if angles_rad.shape != ranges_m.shape or angles_rad.ndim != 1:
        raise ValueError(f"expected (N,) angles and ranges, got {angles_rad.shape} and {ranges_m.shape}")
    hit = (ranges_m > 0) & (ranges_m < range_max_m)
    reached_m, directions_rad = ranges_m[hit], angles_rad[hit]
    points = np.empty((len(reached_m), 2))
    np.multiply(reached_m, np.cos(directions_rad), out=points[:, 0])
    np.multiply(reached_m, np.sin(directions_rad), out=points[:, 1])
    return points


def without_dropouts(ranges_m: Floats, range_max_m: float, misses_min: int) -> Floats:
    """The ranges (N,) of a scan; where fewer than `misses_min` neighbouring beams have no return, they are NaN.

    Black or wet surfaces return single beams or none at random: that does not mean a free path. Where it is, many
    neighbouring beams have no return. The first and the last beam count as neighbours.
    """
    received_m: Floats = _without_dropouts(kernel_array(ranges_m, FLOAT64), range_max_m, misses_min)
    return received_m


def _in_walls(points: Floats, geometry: GridGeometry) -> Floats:
    """The beams' ends as deep in the walls as the mapper marks them: on average a cell's middle is where they end."""
    ranges_m = np.hypot(points[:, 0], points[:, 1])
    deeper: Floats = points * (1.0 + HIT_DEPTH_CELLS * geometry.resolution_m / ranges_m)[:, None]
    return deeper
