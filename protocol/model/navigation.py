"""Where a round robot may drive on a known map, how dear each place is, and the paths that follow from it.

Unknown floor is not driven on. A cell is traversable if it is known to be free and its clearance from known
obstacles is at least the robot's radius plus a margin; near obstacles it costs more, so that paths keep away from
walls where there is room.
"""

import math
from collections.abc import Iterable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.inflation import clearance_m
from robrain.protocol.model.occupancy_grid import FREE, OCCUPIED, GridGeometry
from robrain.protocol.model.path_planning import distance_field, nearest_traversable, plan_path, shorten_path

COMFORT_M = 0.4
"""Clearance beyond the needed one from which on a place costs no more."""
DISCOMFORT = 3.0
"""Cost of the tightest place, over 1."""
COARSE = 2
"""Pitch of the grid on which ways are compared, in cells."""


class NavigationGrid:
    """A map as one kind of robot sees it.

    Args:
        classes: (H, W) int8, classes of an OccupancyGrid.
        geometry: of the grid.
        needed_m: radius of the robot plus margin.

    """

    def __init__(self, classes: NDArray[np.int8], geometry: GridGeometry, needed_m: float) -> None:
        self.geometry = geometry
        self.needed_m = needed_m
        clearance = clearance_m(classes == OCCUPIED, geometry.resolution_m, needed_m + COMFORT_M)
        self.traversable: NDArray[np.bool_] = (classes == FREE) & (clearance >= needed_m)
        spare = np.clip((clearance - needed_m) / COMFORT_M, 0.0, 1.0)
        self.cost: NDArray[np.float32] = (1.0 + DISCOMFORT * (1.0 - spare) ** 2).astype(np.float32)

    def snap(self, place: Point2D, radius_m: float) -> tuple[int, int] | None:
        """The nearest traversable cell within a radius of a place."""
        cell = self.geometry.cell_of(place.x_m, place.y_m)
        return nearest_traversable(self.traversable, cell, max(1, round(radius_m / self.geometry.resolution_m)))

    def path(
        self,
        start: Point2D,
        goal: Point2D,
        *,
        snap_m: float,
        avoid: Iterable[tuple[float, float, float]] = (),
    ) -> list[Point2D] | None:
        """A cheapest path from start to as near to the goal as the robot can stand, within `snap_m`.

        Args:
            start: where the robot is.
            goal: where it wants to be.
            snap_m: how far start and goal may be from the ends of the path.
            avoid: circles (x, y, radius) in metres that must not be driven through.

        Returns:
            Waypoints, the start's cell left out; None if there is no path.

        """
        traversable = self.without(avoid)
        ends = [
            nearest_traversable(
                traversable,
                self.geometry.cell_of(place.x_m, place.y_m),
                max(1, round(snap_m / self.geometry.resolution_m)),
            )
            for place in (start, goal)
        ]
        if ends[0] is None or ends[1] is None:
            return None
        cells = plan_path(traversable, self.cost, ends[0], ends[1])
        if cells is None:
            return None
        comfortable = traversable & (self.cost < 1.0 + DISCOMFORT / 4)
        waypoints = [self.geometry.center_of(int(row), int(column)) for row, column in shorten_path(cells, comfortable)]
        return waypoints[1:] or waypoints

    def ways_m(self, place: Point2D, cells: list[tuple[int, int]], *, snap_m: float) -> list[float]:
        """Cost of the way from a place to each of these cells, as metres on open floor; inf where there is none.

        Measured on a grid of twice the pitch, in a quarter of the time: good for comparing ways, not for driving.
        """
        cell = self.snap(place, snap_m)
        if cell is None:
            return [math.inf] * len(cells)
        traversable, cost = self._coarse
        source = np.array([(cell[0] // COARSE, cell[1] // COARSE)], dtype=np.int64)
        field = distance_field(traversable, cost, source)
        pitch_m = COARSE * self.geometry.resolution_m
        return [float(field[row // COARSE, column // COARSE]) * pitch_m for row, column in cells]

    @cached_property
    def _coarse(self) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        # A coarse cell is traversable if one of its cells is. That joins nothing that a wall parts, for no wall with
        # the robot's radius kept on both sides of it is narrower than two coarse cells.
        height, width = self.geometry.shape
        padded = (-height % COARSE, -width % COARSE)
        rows, columns = (height + padded[0]) // COARSE, (width + padded[1]) // COARSE
        cost = np.where(self.traversable, self.cost, np.float32(np.inf))
        cost = np.pad(cost, ((0, padded[0]), (0, padded[1])), constant_values=np.inf)
        least: NDArray[np.float32] = cost.reshape(rows, COARSE, columns, COARSE).min(axis=(1, 3))
        traversable = np.isfinite(least)
        return traversable, np.where(traversable, least, np.float32(1.0))

    def without(self, circles: Iterable[tuple[float, float, float]]) -> NDArray[np.bool_]:
        """The traversable cells that lie outside of these circles (x, y, radius in metres)."""
        traversable = self.traversable
        for x_m, y_m, radius_m in circles:
            if traversable is self.traversable:
                traversable = traversable.copy()
            rows, columns, inside = self._disc(x_m, y_m, radius_m)
            traversable[rows, columns] &= ~inside
        return traversable

    def _disc(self, x_m: float, y_m: float, radius_m: float) -> tuple[slice, slice, NDArray[np.bool_]]:
        geometry = self.geometry
        low_row, low_column = geometry.cell_of(x_m - radius_m, y_m - radius_m)
        high_row, high_column = geometry.cell_of(x_m + radius_m, y_m + radius_m)
        height, width = geometry.shape
        rows = slice(min(max(low_row, 0), height), min(max(high_row + 1, 0), height))
        columns = slice(min(max(low_column, 0), width), min(max(high_column + 1, 0), width))
        center_y = geometry.origin_y_m + (np.arange(rows.start, rows.stop) + 0.5) * geometry.resolution_m
        center_x = geometry.origin_x_m + (np.arange(columns.start, columns.stop) + 0.5) * geometry.resolution_m
        distance_squared = (center_y[:, None] - y_m) ** 2 + (center_x[None, :] - x_m) ** 2
        return rows, columns, distance_squared <= radius_m**2
