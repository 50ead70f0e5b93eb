"""The known floor divided into rooms and stretches of corridor, at its narrow places.

A watershed of the clearance: cells are added from the widest place down; where two basins meet, the passage between
them is a door if it is much narrower than the narrower of them is wide. After Wurm, Stachniss, Burgard, *Coordinated
multi-robot exploration using a segmentation of the environment*, IROS 2008, who cut a Voronoi graph at such places.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.navigation.clearance_kernels import clearance_m
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED

DOOR_SHARE = 0.6
"""A passage is a door if its clearance is at most this share of that of the narrower of both rooms (chosen)."""
FELT_M = 3.0
"""Clearances beyond this are equal: halls of different widths are one room if what joins them is as wide (chosen)."""
NO_ROOM = -1


def floor_rooms(classes: NDArray[np.int8], resolution_m: float) -> NDArray[np.int32]:
    """The number of the room of each cell, (H, W), from 0; `NO_ROOM` for cells that are not free.

    Args:
        classes: (H, W) as of `OccupancyGrid.classes`.
        resolution_m: side of a cell, metres.

    Raises:
        ValueError: the resolution is not above 0, or `classes` has another shape.

    """
    if classes.ndim != 2 or not (math.isfinite(resolution_m) and resolution_m > 0):
        raise ValueError(f"expected classes (H, W) and a resolution above 0, got {classes.shape}, {resolution_m}")
    near_m = clearance_m(classes == OCCUPIED, resolution_m, FELT_M)
    free = np.flatnonzero(classes == FREE)
    # From the widest down; cells of equal clearance row by row, so that equal maps have equal rooms.
    order = free[np.argsort(-near_m.ravel()[free], kind="stable")]
    rooms: NDArray[np.int32] = _watershed(order, near_m.astype(np.float64), DOOR_SHARE)
    return rooms


@njit(cache=True, nogil=True)
def _root(parent: NDArray[np.int32], basin: int) -> int:
    while parent[basin] != basin:
        parent[basin] = parent[parent[basin]]
        basin = parent[basin]
    return basin


@njit(cache=True, nogil=True)
def _watershed(order: NDArray[np.int64], near_m: NDArray[np.float64], door_share: float) -> NDArray[np.int32]:
    height, width = near_m.shape
    basin_of = np.full((height, width), -1, np.int32)
    parent = np.empty(order.size + 1, np.int32)
    peak_m = np.empty(order.size + 1)
    basins = 0
    for k in range(order.size):
        row, column = order[k] // width, order[k] % width
        own = -1
        for near_row in range(max(row - 1, 0), min(row + 2, height)):
            for near_column in range(max(column - 1, 0), min(column + 2, width)):
                if basin_of[near_row, near_column] < 0:
                    continue
                other = _root(parent, basin_of[near_row, near_column])
                if own < 0 or other == own:
                    own = other
                    continue
                low, high = (own, other) if peak_m[own] < peak_m[other] else (other, own)
                if near_m[row, column] > door_share * peak_m[low]:
                    parent[low] = high
                own = high
        if own < 0:
            own = basins
            parent[basins], peak_m[basins] = basins, near_m[row, column]
            basins += 1
        basin_of[row, column] = own
    number_of = np.full(basins, -1, np.int32)
    rooms = 0
    for k in range(order.size):
        row, column = order[k] // width, order[k] % width
        root = _root(parent, basin_of[row, column])
        if number_of[root] < 0:
            number_of[root] = rooms
            rooms += 1
        basin_of[row, column] = number_of[root]
    return basin_of
