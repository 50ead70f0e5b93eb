"""How far it is from place to place, along the floor that the team knows.

Dijkstra's fields over the known map, one for each place that is gone to; they are kept while the map stays the same.
Lengths are those of paths over the eight neighbours of cells of 0.2 m: on open floor up to 8 % (5 % on the average)
longer than a straight line, about what keeping clear of walls adds to a robot's own path.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robrain.coordinator.planning.floor import Floor
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.navigation import NavigationGrid
from robrain.protocol.model.occupancy_grid import FREE
from robrain.protocol.model.path_planning import distance_field

COARSE = 2
"""Pitch, in cells of the map. No wall with room for a robot on both sides is passed through so."""
SNAP_M = 0.8
"""A place may be so far from where a robot can stand."""
DETOUR = 1.5
"""How much longer than a straight line a way is taken to be where there is no map (chosen, as the robots do)."""
KEPT_BYTES = 96_000_000
"""Of fields; beyond, the oldest are made anew when they are needed."""


class Ways:
    """Lengths of ways on one floor, for robots of one size.

    Args:
        floor: the map; None if there is none, and ways are straight lines with `DETOUR`.
        needed_m: clearance that a robot needs.
        unknown_cost: what a metre of unknown floor counts as.

    """

    def __init__(self, floor: Floor | None, needed_m: float, unknown_cost: float) -> None:
        self.version = 0 if floor is None else floor.version
        self.needed_m = needed_m
        self.unknown_cost = unknown_cost
        self._fields: dict[tuple[int, int], NDArray[np.float32]] = {}
        self._bytes = 0
        self._navigation: NavigationGrid | None = None
        if floor is not None:
            self._navigation = NavigationGrid(floor.classes, floor.geometry, needed_m, unknown_cost=1.0)
            self._pitch_m = COARSE * floor.geometry.resolution_m
            self._mask, self._cost = _coarse(self._navigation.traversable, floor.classes, unknown_cost)

    def lengths_m(self, goals: Sequence[Point2D], starts: Sequence[Point2D]) -> NDArray[np.float64]:
        """Lengths (n, n), metres, symmetric, among goals and then starts; infinite where there is no way.

        From start to start nobody goes: those are straight lines.
        """
        places = [*goals, *starts]
        xy = np.array([(place.x_m, place.y_m) for place in places]).reshape(-1, 2)
        apart_m = xy[:, None] - xy[None]
        straight_m = np.hypot(apart_m[:, :, 0], apart_m[:, :, 1])
        length_m: NDArray[np.float64] = straight_m.copy()
        if self._navigation is None:
            return length_m * DETOUR
        cells = [self._cell(place) for place in places]
        there = np.array([cell is not None for cell in cells], np.bool_)
        rows = np.array([cell[0] if cell is not None else 0 for cell in cells], np.int64)
        columns = np.array([cell[1] if cell is not None else 0 for cell in cells], np.int64)
        for index, cell in enumerate(cells[: len(goals)]):
            found_m = np.full(len(places), np.inf)
            if cell is not None:
                found_m[there] = self._field(cell)[rows[there], columns[there]] * self._pitch_m
            found_m = np.maximum(found_m, straight_m[index])
            found_m[index] = 0.0
            length_m[index] = found_m
            length_m[:, index] = found_m
        return length_m

    def _cell(self, place: Point2D) -> tuple[int, int] | None:
        assert self._navigation is not None
        cell = self._navigation.snap(place, SNAP_M)
        return None if cell is None else (cell[0] // COARSE, cell[1] // COARSE)

    def _field(self, cell: tuple[int, int]) -> NDArray[np.float32]:
        field = self._fields.pop(cell, None)
        if field is None:
            field = distance_field(self._mask, self._cost, np.array([cell], np.int64))
            self._bytes += field.nbytes
        self._fields[cell] = field
        while self._bytes > KEPT_BYTES and len(self._fields) > 1:
            self._bytes -= self._fields.pop(next(iter(self._fields))).nbytes
        return field


def _coarse(
    traversable: NDArray[np.bool_], classes: NDArray[np.int8], unknown_cost: float
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Every second row and column: a cell is traversable if one of its cells is, and costs what the cheapest does."""
    cost = np.where(traversable, np.where(classes == FREE, 1.0, unknown_cost), np.inf)
    rows, columns = (math.ceil(size / COARSE) for size in cost.shape)
    padding = (rows * COARSE - cost.shape[0], columns * COARSE - cost.shape[1])
    cost = np.pad(cost, ((0, padding[0]), (0, padding[1])), constant_values=np.inf)
    least = cost.reshape(rows, COARSE, columns, COARSE).min(axis=(1, 3))
    mask = np.isfinite(least)
    return mask, np.where(mask, least, 1.0).astype(np.float32)
