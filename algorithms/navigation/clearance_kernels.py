"""How much room there is on a map: compiled.

`clearance` says how much a robot needs, `obstacles` how much there is among points that a robot has seen; what imports
only those does not wait for the compiler.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import BOOL, kernel_array


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
