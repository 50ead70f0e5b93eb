"""Features of the team's map beside the paths: rooms, and the amount of unknown floor behind each frontier."""

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.navigation.navigation_grid import clearance_m
from robrain.algorithms.numeric.kernel_array import INT8, kernel_array
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN


def unknown_shares(classes: NDArray[np.int8], cells: Sequence[tuple[int, int]], reach: int) -> NDArray[np.int64]:
    """Number of unknown cells that are nearer to each frontier than to the others, (frontiers,).

    Distance is that of a path through unknown cells, from cell to cell above, below, left and right. A cell as near to
    several frontiers counts for the first.

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


DOOR_SHARE = 0.6
"""A passage is a door if its clearance is at most this share of that of the narrower of both rooms (chosen)."""
FELT_M = 3.0
"""Clearances beyond this are equal: halls of different widths are one room if their passage is as wide (chosen)."""
NO_ROOM = -1


def floor_rooms(classes: NDArray[np.int8], resolution_m: float) -> NDArray[np.int32]:
    """The number of the room of each cell, (H, W), from 0; `NO_ROOM` for cells that are not free.

    Args:
        classes: (H, W) as of `OccupancyGrid.classes`.
        resolution_m: side of a cell, metres.

    """
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


SHARE_REACH_M = 6.0
"""Unknown floor farther than this from all frontiers belongs to none."""
LEAST_ROOM_M2 = 1.0
"""A smaller area is a niche and not a room."""


class MapSurvey:
    """Reads the map at the first request; values that are not requested are not computed.

    Args:
        grid: the map.
        frontiers: places of its frontiers, arena frame.

    """

    def __init__(self, grid: OccupancyGrid, frontiers: Sequence[Point2D]) -> None:
        self._grid = grid
        self._geometry = grid.geometry
        self._frontiers = frontiers

    @cached_property
    def shares_m2(self) -> NDArray[np.float64]:
        """Unknown floor that is nearer to each frontier than to the others, (frontiers,), square metres."""
        cells = [self._geometry.cell_of(place.x_m, place.y_m) for place in self._frontiers]
        reach = round(SHARE_REACH_M / self._geometry.resolution_m)
        cell_m2 = self._geometry.resolution_m**2
        found = (unknown_shares(self._grid.classes(), cells, reach) * cell_m2).astype(np.float64)
        found.setflags(write=False)
        return found

    @cached_property
    def frontier_rooms(self) -> NDArray[np.int64]:
        """The number of each frontier's room, (frontiers,); below 0 if it is in none."""
        return np.array([self.room_of(place) for place in self._frontiers], np.int64)

    def room_of(self, place: Point2D) -> int:
        """The number of the room around a place; below 0 if it is in none."""
        rooms = self._rooms
        row, column = self._geometry.cell_of(place.x_m, place.y_m)
        height, width = rooms.shape
        if not (0 <= row < height and 0 <= column < width):
            return NO_ROOM
        return int(rooms[row, column])

    @cached_property
    def room_m2(self) -> float:
        """Mean area of the room around a place of the known floor, square metres; infinite if there is no room.

        The mean over places, not over rooms, so that niches and closets beside a hall count for little.
        """
        sizes = np.bincount(self._rooms[self._rooms != NO_ROOM])
        sizes_m2 = sizes * self._geometry.resolution_m**2
        rooms = sizes_m2 >= LEAST_ROOM_M2
        return float((sizes_m2**2).sum() / sizes_m2.sum()) if rooms.any() else math.inf

    @cached_property
    def known_m2(self) -> float:
        """Area of the known floor that lies in rooms, square metres."""
        return float(np.count_nonzero(self._rooms != NO_ROOM)) * self._geometry.resolution_m**2

    @cached_property
    def _rooms(self) -> NDArray[np.int32]:
        return floor_rooms(self._grid.classes(), self._geometry.resolution_m)
