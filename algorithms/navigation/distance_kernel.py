"""Costs of the cheapest paths from some cells to all others: compiled.

Cells wait in buckets of about equal cost instead of a heap (Dial, *Algorithm 360: Shortest-Path Forest with Topological
Ordering*, 1969). A bucket is no wider than the cheapest step, so a cell is settled when its bucket's turn comes; where
costs differ so much that buckets have to be wider, cells are looked at again. The costs are those that a heap would
give, to the bit: each is the least sum over the neighbours.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import Floats

_DIAGONAL = 2.0**0.5
BUCKETS_MAX = 4096


@njit(cache=True, nogil=True)
def spread(traversable: NDArray[np.bool_], cost: NDArray[np.float32], sources: NDArray[np.int64]) -> Floats:
    """Cost of the path from each cell to the nearest source, (H, W), in cells; inf where there is none.

    Sources (K, 2) that are untraversable or outside are passed over. See `path_planning.distance_field`.
    """
    height, width = traversable.shape
    wide = width + 2  # a border of untraversable cells: neighbours need no check against the edges
    half = np.full((height + 2) * wide, np.inf, np.float32)
    least, most = np.inf, 0.0
    for row in range(height):
        for column in range(width):
            if traversable[row, column]:
                cell_cost = float(cost[row, column])
                half[(row + 1) * wide + column + 1] = np.float32(0.5) * cost[row, column]
                least, most = min(least, cell_cost), max(most, cell_cost)
    distance = np.full(half.size, np.inf)
    bucket_width = max(least, most * _DIAGONAL / BUCKETS_MAX)
    if 0.0 < bucket_width < np.inf:
        first = np.full(int(most * _DIAGONAL / bucket_width) + 3, -1, np.int32)
        after, before = np.full(half.size, -1, np.int32), np.full(half.size, -1, np.int32)
        waiting = 0
        for k in range(sources.shape[0]):
            row, column = sources[k, 0], sources[k, 1]
            cell = (row + 1) * wide + column + 1
            if 0 <= row < height and 0 <= column < width and traversable[row, column] and distance[cell] > 0.0:
                distance[cell] = 0.0
                _put(first, after, before, cell, 0)
                waiting += 1
        _settle(half, distance, first, after, before, waiting, wide, bucket_width)
    return distance.reshape(height + 2, wide)[1:-1, 1:-1].copy()


@njit(cache=True, nogil=True)
def _put(first: NDArray[np.int32], after: NDArray[np.int32], before: NDArray[np.int32], cell: int, bucket: int) -> None:
    after[cell] = first[bucket]
    before[cell] = -1
    if first[bucket] >= 0:
        before[first[bucket]] = cell
    first[bucket] = cell


@njit(cache=True, nogil=True)
def _take(
    first: NDArray[np.int32], after: NDArray[np.int32], before: NDArray[np.int32], cell: int, bucket: int
) -> None:
    if before[cell] >= 0:
        after[before[cell]] = after[cell]
    else:
        first[bucket] = after[cell]
    if after[cell] >= 0:
        before[after[cell]] = before[cell]


@njit(cache=True, nogil=True)
def _settle(
    half: NDArray[np.float32],
    distance: Floats,
    first: NDArray[np.int32],
    after: NDArray[np.int32],
    before: NDArray[np.int32],
    waiting: int,
    wide: int,
    bucket_width: float,
) -> None:
    """Relax cell after cell until none waits; `first` is the ring of buckets, each a list linked both ways."""
    steps = (-wide, -1, 1, wide, -wide - 1, 1 - wide, wide - 1, wide + 1)
    waits = np.zeros(half.size, np.bool_)
    ring = first.size
    waits[distance == 0.0] = True
    bucket = 0
    while waiting > 0:
        cell = first[bucket]
        if cell < 0:
            bucket = bucket + 1 if bucket + 1 < ring else 0
            continue
        _take(first, after, before, cell, bucket)
        waits[cell] = False
        waiting -= 1
        for k in range(8):
            near = cell + steps[k]
            if k >= 4:
                side = steps[0] if k < 6 else steps[3]
                if half[cell + side] == np.inf or half[near - side] == np.inf:
                    continue
            step_cost = half[cell] + half[near]
            through = distance[cell] + (_DIAGONAL * step_cost if k >= 4 else step_cost)
            if through >= distance[near]:
                continue
            if waits[near]:
                _take(first, after, before, near, int(distance[near] / bucket_width) % ring)
            else:
                waits[near] = True
                waiting += 1
            distance[near] = through
            _put(first, after, before, near, int(through / bucket_width) % ring)
