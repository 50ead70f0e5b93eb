"""Accuracy of a map: its occupied cells compared with the true walls.

A cell is off if its centre is more than `OFF_M` from the nearest point of any true wall cell. Everything beyond the
edge of the true plan counts as wall, as a simulated lidar sees it. A wall is doubled where cells are off within
`DOUBLED_WITHIN_M` of a true wall that the map also has at the right place.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import BOOL, INT8, kernel_array
from robrain.protocol.model.accuracy import MapAccuracy
from robrain.protocol.model.grid_geometry import GridGeometry

OFF_M = 0.25
"""Largest distance of a right cell's centre from a true wall, metres: two and a half cells of 0.1 m."""
DOUBLED_WITHIN_M = 1.0
"""Largest distance, metres, between a wall and its double: cells farther off are another error."""
SLACK_CELLS = 1e-6
"""Added to bounds, in cells: distances are multiples of the resolution, and equality must not depend on rounding."""
ELSEWHERE, RIGHT, ON_WALL, OFF = 0, 1, 2, 3


def measure_map_accuracy(
    classes: NDArray[np.int8], geometry: GridGeometry, walls: NDArray[np.bool_], walls_geometry: GridGeometry
) -> MapAccuracy:
    """Compare a map with the true walls.

    Args:
        classes: int8 (H, W), the classes of the map's cells as in `OccupancyGrid.classes()`.
        geometry: grid of these cells, arena frame.
        walls: bool (H', W'), which cells are truly wall.
        walls_geometry: grid of the walls, arena frame; its resolution may differ.

    """
    wall_cell_m = walls_geometry.resolution_m
    occupied, off, doubled = _measure(
        kernel_array(classes, INT8),
        kernel_array(walls, BOOL),
        (geometry.origin_x_m - walls_geometry.origin_x_m) / wall_cell_m,
        (geometry.origin_y_m - walls_geometry.origin_y_m) / wall_cell_m,
        geometry.resolution_m / wall_cell_m,
        OFF_M / wall_cell_m + SLACK_CELLS,
        # A wall is mapped at the right place if its cell or one beside it is occupied.
        geometry.resolution_m / wall_cell_m + SLACK_CELLS,
        DOUBLED_WITHIN_M / geometry.resolution_m + SLACK_CELLS,
    )
    return MapAccuracy(
        occupied_cells=occupied,
        cells_off=off,
        share_off=off / occupied if occupied else 0.0,
        doubled_walls_m=doubled * geometry.resolution_m,
    )


@njit(cache=True, nogil=True)
def _measure(
    classes: NDArray[np.int8],
    walls: NDArray[np.bool_],
    origin_x: float,
    origin_y: float,
    step: float,
    off: float,
    on_wall: float,
    doubled_within: float,
) -> tuple[int, int, int]:
    """Counts of occupied cells, of those off, and of those off beside a mapped wall.

    The map's origin, its step from cell to cell and the first two distances are in cells of `walls`. The distance
    `doubled_within` is in cells of the map.
    """
    height, width = classes.shape
    kinds = np.zeros((height, width), np.uint8)
    occupied_count, off_count, doubled_count = 0, 0, 0
    for row in range(height):
        for column in range(width):
            if classes[row, column] <= 0:
                continue
            occupied_count += 1
            x, y = origin_x + (column + 0.5) * step, origin_y + (row + 0.5) * step
            if _is_wall_near(walls, x, y, on_wall):
                kinds[row, column] = ON_WALL
            elif _is_wall_near(walls, x, y, off):
                kinds[row, column] = RIGHT
            else:
                kinds[row, column] = OFF
                off_count += 1
    if off_count == 0:
        return occupied_count, 0, 0
    reach = math.floor(doubled_within)
    for row in range(height):
        for column in range(width):
            if kinds[row, column] == OFF and _is_wall_mapped_near(kinds, row, column, reach, doubled_within):
                doubled_count += 1
    return occupied_count, off_count, doubled_count


@njit(cache=True, nogil=True)
def _is_wall_near(walls: NDArray[np.bool_], x: float, y: float, distance: float) -> bool:
    """Whether the square of a wall cell, or the edge of the plan, is within a distance of a point; all in cells."""
    height, width = walls.shape
    if x - distance < 0 or y - distance < 0 or x + distance > width or y + distance > height:
        return True
    for row in range(math.floor(y - distance), math.floor(y + distance) + 1):
        dy = max(row - y, y - (row + 1), 0.0)
        for column in range(math.floor(x - distance), math.floor(x + distance) + 1):
            if 0 <= row < height and 0 <= column < width and walls[row, column]:
                dx = max(column - x, x - (column + 1), 0.0)
                if dx * dx + dy * dy <= distance * distance:
                    return True
    return False


@njit(cache=True, nogil=True)
def _is_wall_mapped_near(kinds: NDArray[np.uint8], row: int, column: int, reach: int, within: float) -> bool:
    height, width = kinds.shape
    for i in range(max(0, row - reach), min(height, row + reach + 1)):
        for j in range(max(0, column - reach), min(width, column + reach + 1)):
            if kinds[i, j] == ON_WALL and (i - row) ** 2 + (j - column) ** 2 <= within * within:
                return True
    return False
