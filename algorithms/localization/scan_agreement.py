"""How far a scan is as a map says: beams that end at its walls, and beams that do not."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

COMPARED_MIN = 0.5
"""Share of a scan's beams that must end where the map is known before the scan says anything about it."""
NEAR_CELLS = 2.0
"""A beam ends at a wall of the map that is this near."""
BODY_M = 0.5
"""Walls nearer than this may be the robot itself, as the others saw it."""
SHORT_M = 0.3
"""A beam may end this far behind a wall of the map before it has gone through it."""


def agreement(log_odds: NDArray[np.int8], geometry: GridGeometry, sensor: Pose2D, points: Floats) -> tuple[float, int]:
    """Share of a scan's beams that are as the map says, seen from `sensor` (arena frame), and how many were compared.

    `points` (K, 2) are the beams' ends in the sensor's frame, see `beam_ends`. A beam agrees that ends at a wall of the
    map and goes through none. Beams that end where nothing is known are not compared.
    """
    agreeing, compared = _agreement(
        log_odds,
        1.0 / geometry.resolution_m,
        (sensor.x_m - geometry.origin_x_m) / geometry.resolution_m,
        (sensor.y_m - geometry.origin_y_m) / geometry.resolution_m,
        sensor.yaw_rad,
        points,
        BODY_M,
        SHORT_M,
        NEAR_CELLS,
    )
    return agreeing / max(compared, 1), compared


@njit(cache=True, nogil=True)
def _agreement(
    log_odds: NDArray[np.int8],
    per_m: float,
    x: float,
    y: float,
    yaw_rad: float,
    points: Floats,
    body_m: float,
    short_m: float,
    near_cells: float,
) -> tuple[int, int]:
    """Beams that agree, and beams compared; `x` and `y` in cells."""
    height, width = log_odds.shape
    around = math.ceil(near_cells)
    agreeing, compared = 0, 0
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    for k in range(points.shape[0]):
        out_x = per_m * (cos * points[k, 0] - sin * points[k, 1])
        out_y = per_m * (sin * points[k, 0] + cos * points[k, 1])
        way = math.hypot(out_x, out_y)
        is_blocked = False
        at = body_m * per_m
        while at < way - short_m * per_m and not is_blocked:
            row, column = math.floor(y + out_y * at / way), math.floor(x + out_x * at / way)
            is_blocked = 0 <= row < height and 0 <= column < width and log_odds[row, column] > 0
            at += 1.0
        row, column = math.floor(y + out_y), math.floor(x + out_x)
        is_near = False
        for i in range(max(row - around, 0), min(row + around + 1, height)):
            for j in range(max(column - around, 0), min(column + around + 1, width)):
                if log_odds[i, j] > 0 and math.hypot(i - row, j - column) <= near_cells:
                    is_near = True
        is_known = 0 <= row < height and 0 <= column < width and log_odds[row, column] != 0
        if is_near or is_blocked or is_known:
            compared += 1
            agreeing += is_near and not is_blocked
    return agreeing, compared
