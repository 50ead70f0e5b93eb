"""Zones on the cells of a map."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, minimum_filter

from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry
from robrain.protocol.model.zone import Zone, ZoneKind

LIMIT_AHEAD_M = 1.0
"""A speed limit is obeyed from this far before its zone (chosen): at 0.6 m/s a robot brakes within 0.6 m."""
BESIDE_M = 0.2
"""Distance (chosen) from no-stopping zones at rest, and from one-way zones against their direction. Robots cut corners,
and stop somewhat beside their goals."""


class ZoneGrid:
    """Zones on a grid; (H, W) is its shape.

    Args:
        zones: all that are to be obeyed.
        geometry: of the grid.

    """

    def __init__(self, zones: Sequence[Zone], geometry: GridGeometry) -> None:
        self.zones = zones
        self._geometry = geometry
        self._is_door = np.zeros(geometry.shape, np.bool_)
        self._limits = [zone for zone in zones if zone.kind is ZoneKind.SPEED_LIMIT]
        self.is_shut = np.zeros(geometry.shape, np.bool_)
        """Mask of the cells in keep-out zones."""
        self.surcharge = np.zeros(geometry.shape, np.float32)
        """Extra cost of a metre."""
        self.directed: list[tuple[NDArray[np.bool_], float]] = []
        """Masks of one-way zones and the cells within `BESIDE_M`, with their directions, radians, arena frame."""
        self.no_stopping = np.zeros(geometry.shape, np.bool_)
        """Mask of the cells in no-stopping zones."""
        self.no_rest = self.no_stopping
        """The same with all cells within `BESIDE_M`."""
        self.limit_m_s = np.full(geometry.shape, np.inf)
        """Speed limits; inf where there is none."""
        beside = max(1, round(BESIDE_M / geometry.resolution_m))
        for zone in zones:
            if zone.kind is ZoneKind.PLACE and not zone.is_shut:
                continue
            inside = cells_in(zone, geometry)
            if zone.keeps_out:
                self.is_shut |= inside
            elif zone.kind is ZoneKind.DOOR:
                self._is_door |= inside
            elif zone.kind is ZoneKind.NO_STOPPING:
                self.no_stopping |= inside
            elif zone.direction_rad is not None:
                self.directed.append((binary_dilation(inside, iterations=beside), zone.direction_rad))
            self.surcharge[inside] += np.float32(zone.cost_m or 0.0)
            self.limit_m_s[inside] = np.minimum(self.limit_m_s[inside], zone.speed_m_s or np.inf)

        self._beside_shut = binary_dilation(self.is_shut)
        if self.no_stopping.any():
            self.no_rest = binary_dilation(self.no_stopping, iterations=beside)

    def close(self, classes: NDArray[np.int8], free: int = int(FREE)) -> NDArray[np.int8]:
        """Classes of a map, (H, W), with keep-out zones as occupied cells and doors, open or not, as free ones."""
        opened = np.where(self._is_door & (classes > 0), np.int8(free), classes)
        return np.where(self.is_shut, np.int8(OCCUPIED), opened)

    def shuts(self, place: Point2D, *, beside: bool = False) -> bool:
        """Whether a place is in a keep-out zone, or in a cell beside one: its border may cross that cell."""
        mask = self._beside_shut if beside else self.is_shut
        return bool(self._at(mask, np.array([(place.x_m, place.y_m)])).any())

    def forbids_rest(self, place: Point2D) -> bool:
        """Whether a robot must not stay at a place."""
        return self.shuts(place) or bool(self._at(self.no_stopping, np.array([(place.x_m, place.y_m)])).any())

    def fastest_m_s(self, positions: Floats) -> float:
        """The lowest speed limit at positions (N, 2), metres, arena frame; inf if there is none."""
        return float(self._at(self.limit_m_s, positions).min(initial=np.inf)) if self._limits else np.inf

    def delay_s(self, positions: Floats, step_m: float, pace_m_s: float) -> float:
        """How much longer a robot with this pace takes for positions (N, 2), `step_m` apart, because of limits."""
        if not self._limits:
            return 0.0
        ahead = round(LIMIT_AHEAD_M / step_m)
        limits_m_s = np.pad(self._at(self.limit_m_s, positions), (0, ahead), mode="edge")
        limit_m_s = np.lib.stride_tricks.sliding_window_view(limits_m_s, ahead + 1).min(axis=1)
        return float((step_m / np.minimum(limit_m_s, pace_m_s) - step_m / pace_m_s).sum())

    def felt_limit_m_s(self) -> Floats:
        """Speed limits (H, W) as they slow a robot down from half of `LIMIT_AHEAD_M` before a zone to as far behind.

        A robot drives that length at the limit. This form of it is the same in both directions.
        """
        return minimum_filter(self.limit_m_s, 1 + 2 * round(0.5 * LIMIT_AHEAD_M / self._geometry.resolution_m))

    def waits_at(self, positions: Floats) -> int:
        """How many of positions (N, 2) a robot drives that is to wait at the last: none in a no-stopping zone.

        All if there is no other place to wait before.
        """
        outside = np.flatnonzero(~self._at(self.no_rest, positions))
        return 1 + int(outside[-1]) if len(outside) else len(positions)

    def _at(self, cells: NDArray[Any], positions: Floats) -> NDArray[Any]:
        """Values of an (H, W) array at positions (N, 2); beyond the grid as at its border."""
        origin = self._geometry.origin_x_m, self._geometry.origin_y_m
        columns, rows = np.floor((positions - origin) / self._geometry.resolution_m).astype(np.int64).T
        height, width = self._geometry.shape
        values: NDArray[Any] = cells[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
        return values


def cells_in(zone: Zone, geometry: GridGeometry) -> NDArray[np.bool_]:
    """Mask (H, W) of the cells whose centres are in a zone."""
    height, width = geometry.shape
    y_m = geometry.origin_y_m + (np.arange(height)[:, np.newaxis] + 0.5) * geometry.resolution_m
    x_m = geometry.origin_x_m + (np.arange(width)[np.newaxis] + 0.5) * geometry.resolution_m
    inside = np.zeros(geometry.shape, np.bool_)
    for (x0, y0), (x1, y1) in zone.sides:
        rows = np.flatnonzero((y0 <= y_m) & (y_m < y1))
        inside[rows] ^= (x_m - x0) * (y1 - y0) < (x1 - x0) * (y_m[rows] - y0)
    return inside
