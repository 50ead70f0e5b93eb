"""How much of the unknown is nearest to each frontier: what a robot that goes there may have to explore."""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import INT8, kernel_array
from robrain.protocol.model.grid_geometry import UNKNOWN


def unknown_shares(classes: NDArray[np.int8], cells: Sequence[tuple[int, int]], reach: int) -> NDArray[np.int64]:
    """Number of unknown cells that are nearer to each frontier than to the others, (frontiers,).

    Nearer by a path through unknown cells, from cell to cell above, below, left and right; a cell as near to several
    counts for the first.

    Args:
        classes: (H, W) as of `OccupancyGrid.classes`.
        cells: rows and columns of the frontiers.
        reach: cells farther away than this many steps count for none.

    """
    at = np.array(cells, np.int64).reshape(-1, 2)
    shares: NDArray[np.int64] = _shares(kernel_array(classes, INT8), at, reach, int(UNKNOWN))
    return shares


@njit(cache=True, nogil=True)
def _shares(classes: NDArray[np.int8], at: NDArray[np.int64], reach: int, unknown: int) -> NDArray[np.int64]:
    height, width = classes.shape
    owner = np.full((height, width), -1, np.int32)
    waiting = np.empty((height * width + at.shape[0], 2), np.int32)
    shares = np.zeros(at.shape[0], np.int64)
    first, end = 0, 0
    for k in range(at.shape[0]):
        row, column = at[k, 0], at[k, 1]
        if 0 <= row < height and 0 <= column < width and owner[row, column] < 0:
            owner[row, column] = k
            waiting[end] = row, column
            end += 1
    for _ in range(reach):
        turn = end
        while first < turn:
            row, column = waiting[first]
            first += 1
            for side in range(4):
                near_row = row + (side == 0) - (side == 1)
                near_column = column + (side == 2) - (side == 3)
                if not (0 <= near_row < height and 0 <= near_column < width):
                    continue
                if owner[near_row, near_column] < 0 and classes[near_row, near_column] == unknown:
                    owner[near_row, near_column] = owner[row, column]
                    shares[owner[row, column]] += 1
                    waiting[end] = near_row, near_column
                    end += 1
    return shares
