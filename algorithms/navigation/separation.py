"""Which zones separate places from all robots."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robrain.algorithms.mapping.zone_grid import cells_in
from robrain.algorithms.navigation.navigation_grid import clearance_m
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import OCCUPIED, GridGeometry
from robrain.protocol.model.zone import Zone, ZoneKind


class Separation:
    """Zones between robots and places: keep-out zones count, and shut ones. Unknown floor counts as free.

    Args:
        classes: (H, W) of the map without zones.
        geometry: of the grid.
        zones: all zones.
        robots: places of the robots, arena frame.
        radius_m: of the smallest robot.

    """

    def __init__(
        self,
        classes: NDArray[np.int8],
        geometry: GridGeometry,
        zones: Sequence[Zone],
        robots: Sequence[Point2D],
        radius_m: float,
    ) -> None:
        doors = (cells_in(zone, geometry) for zone in zones if zone.kind is ZoneKind.DOOR)
        self._is_open = np.logical_or.reduce([classes != OCCUPIED, *doors])
        self._geometry, self._zones, self._radius_m = geometry, zones, radius_m
        self._masks = {zone.name: cells_in(zone, geometry) for zone in zones if zone.keeps_out}
        at = [geometry.cell_of(robot.x_m, robot.y_m) for robot in robots]
        self._cells = [cell for cell in at if geometry.contains(*cell)]
        self._reach: dict[frozenset[str], tuple[NDArray[Any], set[int]]] = {}
        """For each set of closed zones the connected parts of the floor, and those in which robots are."""

    def zones_before(self, place: Point2D, near_m: float) -> list[str]:
        """Names of the zones without which a robot could come within `near_m` of a place; none if one can now.

        A robot that stands in such a zone leaves it first, so nothing is known of it.
        """
        if not self._cells or any(mask[cell] for mask in self._masks.values() for cell in self._cells):
            return []
        row, column = self._geometry.cell_of(place.x_m, place.y_m)
        rows, columns = np.ogrid[: self._geometry.height, : self._geometry.width]
        around = (rows - row) ** 2 + (columns - column) ** 2 <= (near_m / self._geometry.resolution_m) ** 2
        names = frozenset(self._masks)
        if not names or self._is_reached(around, names) or not self._is_reached(around, frozenset()):
            return []
        return [name for name in self._masks if self._is_reached(around, names - {name})] or [*self._masks]

    def shut_before(self, place: Point2D, near_m: float) -> Zone | None:
        """The shut zone that holds a place, or separates it from all robots; None if there is none."""
        shut = [zone for zone in self._zones if zone.is_shut]
        names = self.zones_before(place, near_m) if shut else []
        return next((zone for zone in shut if zone.holds(place) or zone.name in names), None)

    def _is_reached(self, around: NDArray[np.bool_], closed: frozenset[str]) -> bool:
        if closed not in self._reach:
            occupied = np.logical_or.reduce([~self._is_open, *(self._masks[name] for name in closed)])
            resolution_m = self._geometry.resolution_m
            near_wall_m = clearance_m(occupied, resolution_m, self._radius_m + resolution_m)
            labels, _ = ndimage.label(near_wall_m >= self._radius_m, np.ones((3, 3)))
            self._reach[closed] = labels, {int(labels[cell]) for cell in self._cells} - {0}
        labels, here = self._reach[closed]
        return not here or not here.isdisjoint(np.unique(labels[around]).tolist())
