"""Closed doors and moving boxes as wall cells: what sensors cast their rays through."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.sim.maps.floor_plan import FloorPlan

Cells = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Rows and columns."""


class Box(NamedTuple):
    """A rectangle on the floor, arena frame."""

    x_m: float
    """Of its middle."""
    y_m: float
    along: tuple[float, float]
    """Direction of its length, a unit vector."""
    length_m: float
    width_m: float

    def distance_m(self, x_m: float, y_m: float) -> float:
        """From a place to the nearest point of the box; 0 inside."""
        off_x_m, off_y_m = x_m - self.x_m, y_m - self.y_m
        cos, sin = self.along
        beyond_x_m = max(0.0, abs(off_x_m * cos + off_y_m * sin) - self.length_m / 2)
        beyond_y_m = max(0.0, abs(off_y_m * cos - off_x_m * sin) - self.width_m / 2)
        return math.sqrt(beyond_x_m * beyond_x_m + beyond_y_m * beyond_y_m)


def box_cells(box: Box, plan: FloorPlan) -> Cells:
    """Cells whose centre lies in a box, which counts as at least a cell's diagonal wide."""
    cos, sin = box.along
    half_length_m = box.length_m / 2
    half_width_m = max(box.width_m, math.sqrt(2) * plan.resolution_m) / 2
    reach_x_m = abs(cos) * half_length_m + abs(sin) * half_width_m
    reach_y_m = abs(sin) * half_length_m + abs(cos) * half_width_m
    first_row, first_column = plan.cell_of(box.x_m - reach_x_m, box.y_m - reach_y_m)
    last_row, last_column = plan.cell_of(box.x_m + reach_x_m, box.y_m + reach_y_m)
    height, width = plan.occupied.shape
    rows = np.arange(max(0, first_row), min(height, last_row + 1))
    columns = np.arange(max(0, first_column), min(width, last_column + 1))
    off_x_m = plan.origin_x_m + (columns + 0.5) * plan.resolution_m - box.x_m
    off_y_m = (plan.origin_y_m + (rows + 0.5) * plan.resolution_m - box.y_m)[:, np.newaxis]
    inside = (np.abs(off_x_m * cos + off_y_m * sin) <= half_length_m) & (
        np.abs(off_y_m * cos - off_x_m * sin) <= half_width_m
    )
    found_rows, found_columns = np.nonzero(inside)
    return rows[found_rows], columns[found_columns]


class WallStamps:
    """Marks cells of the sensors' walls, and takes the marks away again.

    Args:
        walls: arrays (H, W) of the sensors, changed in place.
        values: the mark in each.

    """

    def __init__(self, walls: Sequence[NDArray[np.bool_] | NDArray[np.uint8]], values: Sequence[int]) -> None:
        self._walls = [(array, array.copy(), value) for array, value in zip(walls, values, strict=True)]
        self._marked: list[Cells] = []

    def mark(self, cells: Sequence[Cells]) -> None:
        """Mark these cells, and no others."""
        for array, plain, value in self._walls:
            for marked in self._marked:
                array[marked] = plain[marked]
            for marked in cells:
                array[marked] = value
        self._marked = list(cells)
