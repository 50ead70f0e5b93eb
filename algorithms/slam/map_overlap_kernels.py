"""Cell by cell: what two maps say of each other."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

UNMARKED, CONTRADICTS, COMMON = 0, 1, 2
"""Marks of cells that two maps know."""
CLUSTER_MIN = 4
"""Least number of connected cells for a contradiction: single cells are noise of the lidar."""
BESIDE = 3
"""What is within so many cells of a wall may be a part of it: nearer cells contradict nothing."""


@njit(cache=True, nogil=True)
def compare(
    own: NDArray[np.int8],
    own_distance: NDArray[np.float32],
    other: NDArray[np.int8],
    other_distance: NDArray[np.float32],
    placed: tuple[float, float, float, float],
    near: float,
    marks: NDArray[np.uint8],
) -> tuple[int, int]:
    """Wall cells of `own` that agree, and cells that are floor on both maps.

    Marks each cell of `own` that is known on both maps: what one has as a wall and the other as floor contradicts.
    """
    cos, sin, first_x, first_y = placed
    agreeing, floor = 0, 0
    for i in range(own.shape[0]):
        for j in range(own.shape[1]):
            if own[i, j] == 0:
                continue
            row = math.floor(first_y + sin * j + cos * i)
            column = math.floor(first_x + cos * j - sin * i)
            if row < 0 or column < 0 or row >= other.shape[0] or column >= other.shape[1] or other[row, column] == 0:
                continue
            if own[i, j] > 0:
                if other_distance[row, column] <= near:
                    agreeing += 1
                    marks[i, j] = COMMON
                elif other[row, column] < 0:
                    marks[i, j] = CONTRADICTS
            elif other[row, column] < 0:
                floor += 1
                marks[i, j] = COMMON
            elif own_distance[i, j] > near:
                marks[i, j] = CONTRADICTS
    return agreeing, floor


@njit(cache=True, nogil=True)
def in_clusters(marked: NDArray[np.uint8], own: NDArray[np.int8], small_max: float) -> tuple[int, NDArray[np.int64]]:
    """Contradicting cells connected with at least `CLUSTER_MIN` − 1 others, of the eight around each; unmarks them.

    Returns how many are in clusters longer or wider than `small_max` cells or beside a wall of the own map, and the
    number in each other one.
    """
    height, width = marked.shape
    stack = np.empty((np.sum(marked == CONTRADICTS), 2), np.int32)
    small = np.empty(stack.shape[0], np.int64)
    large, smalls = 0, 0
    for i in range(height):
        for j in range(width):
            if marked[i, j] != CONTRADICTS:
                continue
            marked[i, j] = UNMARKED
            stack[0, 0], stack[0, 1] = i, j
            waiting, cells = 1, 0
            low, left, right_most, walls = i, j, j, 0
            while waiting:
                waiting -= 1
                row, column = stack[waiting, 0], stack[waiting, 1]
                cells += 1
                walls += own[row, column] > 0
                low, left, right_most = max(low, row), min(left, column), max(right_most, column)
                for up in range(max(row - 1, 0), min(row + 2, height)):
                    for right in range(max(column - 1, 0), min(column + 2, width)):
                        if marked[up, right] == CONTRADICTS:
                            marked[up, right] = UNMARKED
                            stack[waiting, 0], stack[waiting, 1] = up, right
                            waiting += 1
            if cells < CLUSTER_MIN:
                continue
            is_small = low - i < small_max and right_most - left < small_max
            if is_small and _walls_about(own, i, low, left, right_most) == walls:
                small[smalls] = cells
                smalls += 1
            else:
                large += cells
    return large, small[:smalls]


@njit(cache=True, nogil=True)
def _walls_about(own: NDArray[np.int8], first: int, last: int, left: int, right: int) -> int:
    """Wall cells in a box, and beside it."""
    total = 0
    for i in range(max(first - BESIDE, 0), min(last + BESIDE + 1, own.shape[0])):
        for j in range(max(left - BESIDE, 0), min(right + BESIDE + 1, own.shape[1])):
            total += own[i, j] > 0
    return total
