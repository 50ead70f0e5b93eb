"""Zones on the cells of a map."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry
from robrain.protocol.model.zone import Zone, ZoneKind


class ZoneGrid:
    """Zones on a grid; (H, W) is its shape.

    Args:
        zones: all that are to be obeyed.
        geometry: of the grid.

    """

    def __init__(self, zones: Sequence[Zone], geometry: GridGeometry) -> None:
        self._geometry = geometry
        self._is_door = np.zeros(geometry.shape, np.bool_)
        self._limits = [zone for zone in zones if zone.kind is ZoneKind.SPEED_LIMIT]
        self.is_shut = np.zeros(geometry.shape, np.bool_)
        """Mask of the cells in keep-out zones."""
        self.surcharge = np.zeros(geometry.shape, np.float32)
        """Extra cost of a metre."""
        self._fastest_m_s = np.full(geometry.shape, np.inf)
        for zone in zones:
            if zone.kind is ZoneKind.PLACE:
                continue
            inside = cells_in(zone, geometry)
            if zone.kind is ZoneKind.KEEP_OUT or zone.is_shut:
                self.is_shut |= inside
            elif zone.kind is ZoneKind.DOOR:
                self._is_door |= inside
            self.surcharge[inside] += np.float32(zone.cost_m or 0.0)
            self._fastest_m_s[inside] = np.minimum(self._fastest_m_s[inside], zone.speed_m_s or np.inf)

    def close(self, classes: NDArray[np.int8], free: int = int(FREE)) -> NDArray[np.int8]:
        """Classes of a map, (H, W), with keep-out zones as occupied cells and doors, open or not, as free ones."""
        opened = np.where(self._is_door & (classes > 0), np.int8(free), classes)
        return np.where(self.is_shut, np.int8(OCCUPIED), opened)

    def shuts(self, place: Point2D) -> bool:
        """Whether a place is in a keep-out zone."""
        row, column = self._geometry.cell_of(place.x_m, place.y_m)
        return self._geometry.contains(row, column) and bool(self.is_shut[row, column])

    def fastest_m_s(self, positions: Floats) -> float:
        """The lowest speed limit at positions (N, 2), metres, arena frame; inf if there is none."""
        if not self._limits:
            return np.inf
        origin = self._geometry.origin_x_m, self._geometry.origin_y_m
        columns, rows = np.floor((positions - origin) / self._geometry.resolution_m).astype(np.int64).T
        height, width = self._geometry.shape
        is_on = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        return float(self._fastest_m_s[rows[is_on], columns[is_on]].min(initial=np.inf))


def cells_in(zone: Zone, geometry: GridGeometry) -> NDArray[np.bool_]:
    """Mask (H, W) of the cells whose centres are in a zone."""
    height, width = geometry.shape
    y_m = geometry.origin_y_m + (np.arange(height)[:, np.newaxis] + 0.5) * geometry.resolution_m
    x_m = geometry.origin_x_m + (np.arange(width)[np.newaxis] + 0.5) * geometry.resolution_m
    inside = np.zeros(geometry.shape, np.bool_)
    for (x0, y0), (x1, y1) in zip(zone.corners_m, (*zone.corners_m[1:], zone.corners_m[0]), strict=True):
        if y0 != y1:
            inside ^= ((y0 > y_m) != (y1 > y_m)) & (x_m < x0 + (x1 - x0) * (y_m - y0) / (y1 - y0))
    return inside
