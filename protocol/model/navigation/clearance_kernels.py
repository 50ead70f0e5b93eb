"""How much room there is, on a map and among points that a robot has seen: compiled.

`clearance` says how much a robot needs; what imports only that does not wait for the compiler.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.protocol.model.numeric.kernel_array import BOOL, Floats, kernel_array

PASSAGE_BEHIND_M, PASSAGE_AHEAD_M = 0.15, 0.4
"""Points from this far behind the centre to this far ahead count as walls beside the robot, but none beyond an obstacle
that is straight ahead, such as a team mate."""
FRONT_M = 0.05
"""Points count as walls up to this far before an obstacle straight ahead: a margin for noise of the lidar."""
SURE_M = 0.03
"""A single point that overlaps the disc's track by more than this is an obstacle; with less overlap it takes
`WITNESSES` points (chosen: three standard deviations of a lidar's range)."""
WITNESSES = 3
BARRIER_M = 0.2


def clearance_m(occupied: NDArray[np.bool_], resolution_m: float, limit_m: float) -> NDArray[np.float32]:
    """Distance of every cell's middle to that of the nearest occupied cell, metres, at most `limit_m`, (H, W).

    Occupied cells have 0. The cells around the grid count as occupied, so that plans stay off the arena's edge.
    Exact Euclidean distances by Felzenszwalb and Huttenlocher, *Distance Transforms of Sampled Functions*, Theory
    of Computing 2012. Raises ValueError for a resolution or a limit that is not positive and for another shape.
    """
    if not (resolution_m > 0 and limit_m > 0):
        raise ValueError(f"expected resolution_m > 0 and limit_m > 0, got {resolution_m} and {limit_m}")
    if occupied.ndim != 2:
        raise ValueError(f"expected cells of shape (H, W), got {occupied.shape}")
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


@njit(cache=True, nogil=True)
def contact_distance_m(points_m: Floats, x_m: float, y_m: float, heading_rad: float, reach_m: float) -> float:
    """How far a disc can go straight ahead before it touches one of the points; inf if it never does.

    `points_m` (2, N) and the disc's centre x, y are in one frame, in which it goes towards `heading_rad`; `reach_m` is
    its radius. What lies beside or behind is passed. A point within the disc and ahead of its centre gives a negative
    distance.
    """
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    nearest_m = math.inf
    for index in range(points_m.shape[1]):
        dx_m, dy_m = points_m[0, index] - x_m, points_m[1, index] - y_m
        ahead_m = cos * dx_m + sin * dy_m
        if ahead_m <= 0.0:
            continue
        aside_m = cos * dy_m - sin * dx_m
        if abs(aside_m) < reach_m:
            nearest_m = min(nearest_m, ahead_m - math.sqrt(reach_m * reach_m - aside_m * aside_m))
    return nearest_m


class Passage(NamedTuple):
    """Room in a narrow place ahead, metres; inf where nothing is seen."""

    free_m: float
    """How far the disc can go straight ahead before it touches something."""
    left_m: float
    """From the line along which its centre moves to the nearest wall on the left."""
    right_m: float


def passage(points_m: Floats, x_m: float, y_m: float, heading_rad: float, radius_m: float) -> Passage:
    """The room for a disc that squeezes straight ahead; arguments as for `contact_distance_m`.

    Distances are to the third nearest point instead of the nearest: with walls this near, the noise of a single range
    would close the passage again and again.
    """
    return Passage(*_passage(points_m, x_m, y_m, heading_rad, radius_m))


@njit(cache=True, nogil=True)
def _passage(
    points_m: Floats, x_m: float, y_m: float, heading_rad: float, radius_m: float
) -> tuple[float, float, float]:
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    core_m = radius_m - SURE_M
    free_m = math.inf
    nearest_m = np.full((3, WITNESSES), np.inf)  # rows: contacts ahead, walls on the left, walls on the right
    for index in range(points_m.shape[1]):
        dx_m, dy_m = points_m[0, index] - x_m, points_m[1, index] - y_m
        ahead_m = cos * dx_m + sin * dy_m
        aside_m = cos * dy_m - sin * dx_m
        if ahead_m > 0.0 and abs(aside_m) < radius_m:
            _keep_nearest(nearest_m[0], ahead_m - math.sqrt(radius_m * radius_m - aside_m * aside_m))
            if abs(aside_m) < core_m:
                free_m = min(free_m, ahead_m - math.sqrt(core_m * core_m - aside_m * aside_m))
    last = WITNESSES - 1
    free_m = min(free_m, nearest_m[0, last])
    until_m = min(PASSAGE_AHEAD_M, radius_m + max(0.0, free_m) - FRONT_M)
    for index in range(points_m.shape[1]):
        dx_m, dy_m = points_m[0, index] - x_m, points_m[1, index] - y_m
        ahead_m = cos * dx_m + sin * dy_m
        aside_m = cos * dy_m - sin * dx_m
        if -PASSAGE_BEHIND_M < ahead_m < until_m and abs(aside_m) > 0.5 * radius_m:
            _keep_nearest(nearest_m[1 if aside_m > 0.0 else 2], abs(aside_m))
    return free_m, nearest_m[1, last], nearest_m[2, last]


@njit(cache=True, nogil=True)
def _keep_nearest(nearest_m: Floats, distance_m: float) -> None:
    """Insert a distance into the sorted list of the least ones."""
    for k in range(nearest_m.shape[0]):
        if distance_m < nearest_m[k]:
            nearest_m[k], distance_m = distance_m, nearest_m[k]


@njit(cache=True, nogil=True)
def hold_off(
    points_m: Floats, x_m: float, y_m: float, x_m_s: float, y_m_s: float, radius_m: float, keep_m: float, per_s: float
) -> tuple[float, float]:
    """The velocity (x, y) changed so that a disc comes no nearer to any point than `keep_m` beyond its radius.

    The disc approaches a point at most at `per_s` times the distance left, and moves away from a point that is too
    near: a control barrier function (Ames et al., *Control Barrier Functions: Theory and Applications*, ECC 2019). The
    excess is subtracted for one point after the other, twice over all points. Other arguments as for
    `contact_distance_m`; points farther than `BARRIER_M` from the hull do not count.
    """
    for _ in range(2):
        for index in range(points_m.shape[1]):
            dx_m, dy_m = points_m[0, index] - x_m, points_m[1, index] - y_m
            away_m = math.hypot(dx_m, dy_m)
            if away_m > radius_m + BARRIER_M or away_m < 1e-6:
                continue
            towards_m_s = (x_m_s * dx_m + y_m_s * dy_m) / away_m
            too_fast_m_s = towards_m_s - per_s * (away_m - radius_m - keep_m)
            if too_fast_m_s > 0.0:
                x_m_s -= too_fast_m_s * dx_m / away_m
                y_m_s -= too_fast_m_s * dy_m / away_m
    return x_m_s, y_m_s


@njit(cache=True, nogil=True)
def sector_distances_m(points_m: Floats, x_m: float, y_m: float, yaw_rad: float, sectors: int) -> Floats:
    """Distance (`sectors`,) from a place to the nearest point in each of these sectors; inf where there is none.

    `points_m` (2, N), x, y and the yaw are in one frame. Sector 0 is centred on the yaw, the others follow
    counter-clockwise.
    """
    nearest_m = np.full(sectors, np.inf)
    for index in range(points_m.shape[1]):
        dx_m, dy_m = points_m[0, index] - x_m, points_m[1, index] - y_m
        direction_rad = math.atan2(dy_m, dx_m) - yaw_rad
        sector = round(direction_rad * sectors / (2.0 * math.pi)) % sectors
        nearest_m[sector] = min(nearest_m[sector], math.hypot(dx_m, dy_m))
    return nearest_m
