"""What the team's map shows beside the paths: rooms, and how much unknown floor each frontier stands for."""

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.exploration.situation import FrontierCandidate
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.navigation.floor_rooms import NO_ROOM, floor_rooms
from robrain.algorithms.navigation.unknown_shares import unknown_shares
from robrain.protocol.model.geometry import Point2D

SHARE_REACH_M = 6.0
"""Unknown floor farther than this from all frontiers belongs to none."""
LEAST_ROOM_M2 = 1.0
"""What is smaller is a niche, and no room."""


class MapLook:
    """Looks at the map as it is when something is asked for the first time; what nobody asks for is not computed.

    Args:
        grid: the map.
        candidates: its frontiers.

    """

    def __init__(self, grid: OccupancyGrid, candidates: Sequence[FrontierCandidate]) -> None:
        self._grid = grid
        self._geometry = grid.geometry
        self._candidates = candidates

    @cached_property
    def shares_m2(self) -> NDArray[np.float64]:
        """Unknown floor that is nearer to each frontier than to the others, (frontiers,), square metres."""
        cells = [self._geometry.cell_of(one.place.x_m, one.place.y_m) for one in self._candidates]
        reach = round(SHARE_REACH_M / self._geometry.resolution_m)
        cell_m2 = self._geometry.resolution_m**2
        found = (unknown_shares(self._grid.classes(), cells, reach) * cell_m2).astype(np.float64)
        found.setflags(write=False)
        return found

    @cached_property
    def frontier_rooms(self) -> NDArray[np.int64]:
        """The number of each frontier's room, (frontiers,); below 0 if it is in none."""
        return np.array([self.room_of(one.place) for one in self._candidates], np.int64)

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
