"""Position of a grid of cells in the arena, and classes of its cells: without kernels, for viewers."""

import math

import numpy as np

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Positive, PositiveInt

UNKNOWN, FREE, OCCUPIED = np.int8(-1), np.int8(0), np.int8(100)
"""Classes of a cell, numbered as in a ROS OccupancyGrid."""


class GridGeometry(Checked, frozen=True):
    """Where a grid lies in the arena.

    Row 0 is at the lowest y, as in a ROS OccupancyGrid. The origin is the outer corner of row 0, column 0, metres,
    arena frame; width and height count cells.

    Raises ValueError where it is built for sizes that are not positive or an origin that is not finite.
    """

    resolution_m: Positive
    origin_x_m: float
    origin_y_m: float
    width: PositiveInt
    height: PositiveInt

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width): the shape of an array of cells."""
        return self.height, self.width

    def cell_of(self, x_m: float, y_m: float) -> tuple[int, int]:
        """(row, column) of the cell that holds a place in the arena frame; it may lie outside the grid."""
        return (
            math.floor((y_m - self.origin_y_m) / self.resolution_m),
            math.floor((x_m - self.origin_x_m) / self.resolution_m),
        )

    def contains(self, row: int, column: int) -> bool:
        """Whether the cell is one of the grid's."""
        return 0 <= row < self.height and 0 <= column < self.width

    def center_of(self, row: int, column: int) -> Point2D:
        """Middle of a cell, metres, arena frame; the cell may lie outside the grid."""
        return Point2D(
            self.origin_x_m + (column + 0.5) * self.resolution_m, self.origin_y_m + (row + 0.5) * self.resolution_m
        )
