"""From where a place can be seen: the standpoint of a robot that is to look at it."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.protocol.model.grid_geometry import OCCUPIED


def standpoint(
    classes: NDArray[np.int8], traversable: NDArray[np.bool_], cell: tuple[int, int], reach_cells: int
) -> tuple[int, int] | None:
    """The traversable cell nearest to `cell` (itself, if it is one) with no known obstacle on the line to it.

    Within a Euclidean distance of `reach_cells`; None if there is none. Of equally near cells the one with the lowest
    row, then column. `classes` and `traversable` are (H, W); `cell` is row and column, and may lie outside.
    """
    row, column = _standpoint(classes, traversable, cell[0], cell[1], reach_cells)
    return (row, column) if row >= 0 else None


@njit(cache=True, nogil=True)
def _standpoint(
    classes: NDArray[np.int8], traversable: NDArray[np.bool_], row: int, column: int, reach: int
) -> tuple[int, int]:
    height, width = classes.shape
    best_2, best_row, best_column = reach * reach + 1, -1, -1
    for stand_row in range(max(0, row - reach), min(height, row + reach + 1)):
        for stand_column in range(max(0, column - reach), min(width, column + reach + 1)):
            away_2 = (stand_row - row) ** 2 + (stand_column - column) ** 2
            if (
                away_2 < best_2
                and traversable[stand_row, stand_column]
                and _sees(classes, stand_row, stand_column, row, column)
            ):
                best_2, best_row, best_column = away_2, stand_row, stand_column
    return best_row, best_column


@njit(cache=True, nogil=True)
def _sees(classes: NDArray[np.int8], row: int, column: int, to_row: int, to_column: int) -> bool:
    """Whether the straight line between two cells' centres crosses no occupied cell, by two looks a cell."""
    looks = 2 * max(abs(to_row - row), abs(to_column - column))
    for look in range(1, looks):
        share = look / looks
        between_row = math.floor(row + share * (to_row - row) + 0.5)
        between_column = math.floor(column + share * (to_column - column) + 0.5)
        if classes[between_row, between_column] == OCCUPIED:
            return False
    return True
