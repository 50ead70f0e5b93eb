"""Path lengths between places on the team's map.

Dijkstra distance fields over the known map, one per destination, cached until the map changes.
Paths run over the eight neighbours of cells of 0.2 m. On open floor they are up to 8 % (5 % on average) longer than a
straight line. Clearance from walls adds about as much to a robot's path. Where there is no path with the preferred
clearance, narrow passages count too.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.mapping.zone_grid import ZoneGrid
from robrain.algorithms.navigation.navigation_grid import NavigationGrid
from robrain.algorithms.navigation.path_planning import distance_field, measured_field
from robrain.coordinator.planning.energy_budget import DETOUR
from robrain.coordinator.planning.snapshot import Floor
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE
from robrain.protocol.model.zone import Zone, ZoneKind

COARSE = 2
"""Pitch, in cells of the map, coarse but too fine for paths to jump a wall with room for a robot on both sides.
Narrow passages are searched at the map's own resolution."""
SLOW = 4.0
"""Cost of a metre of narrow floor, in metres of open floor (the driver squeezes at a quarter of its speed)."""
SNAP_M = 0.8
"""Maximum distance between a place and the nearest cell where a robot can stand."""
MEASURED = (ZoneKind.KEEP_OUT, ZoneKind.SPEED_LIMIT, ZoneKind.PENALTY)
"""Kinds of zones that change path lengths. One-way zones do not: lengths are symmetric."""
PACE_STEP = 0.05
"""Paces within this share count as equal."""
VARIANTS_MAX = 16
KEPT_BYTES = 48_000_000
"""Limit for the cached fields of a grid; beyond, the oldest are dropped."""


class PathLengths:
    """Path lengths on one floor, for robots of one size.

    Args:
        floor: the map; without one (None), lengths are straight lines times `DETOUR`.
        needed_m: clearance that robots prefer.
        unknown_cost: weight of a metre of unknown floor.
        narrow_m: clearance that robots accept where there is no other path; None to exclude narrow passages.
        zones: those that the robots obey, if not all do.
        pace_m_s: of the robots; a metre with a speed limit counts as the metres that they drive elsewhere meanwhile.

    """

    def __init__(
        self,
        floor: Floor | None,
        needed_m: float,
        unknown_cost: float,
        narrow_m: float | None = None,
        zones: Sequence[Zone] = (),
        pace_m_s: float = math.inf,
    ) -> None:
        self.version = 0 if floor is None else floor.version
        self.needed_m = needed_m
        self.unknown_cost = unknown_cost
        self._floor = floor
        self._narrow_m = None if narrow_m is None else min(narrow_m, needed_m)
        self._zones, self._pace_m_s = zones, pace_m_s
        self._grids: dict[float, _Grid] = {}
        """By the clearance that counts."""
        self._for_robots: dict[tuple[tuple[str, ...], float], PathLengths] = {}
        """By the zones that robots obey, and by their pace."""

    def of(self, robot: str, pace_m_s: float) -> "PathLengths":
        """Path lengths for a robot, with the zones that it obeys.

        Args:
            robot: its name.
            pace_m_s: its usual pace.

        """
        floor = self._floor
        all_zones = () if floor is None else floor.zones
        zones = [zone for zone in all_zones if zone.binds(robot) and (zone.kind in MEASURED or zone.is_shut)]
        if not zones:
            return self
        # Paces of one step share their paths, and those that robots learn later often do.
        step = round(math.log(pace_m_s) / PACE_STEP) if any(zone.speed_m_s is not None for zone in zones) else 0
        key = tuple(zone.name for zone in zones), math.exp(PACE_STEP * step)
        if key not in self._for_robots:
            if len(self._for_robots) == VARIANTS_MAX:
                self._for_robots.clear()
            self._for_robots[key] = PathLengths(
                floor, self.needed_m, self.unknown_cost, self._narrow_m, zones, pace_m_s=key[1]
            )
        return self._for_robots[key]

    def lengths_m(self, goals: Sequence[Point2D], starts: Sequence[Point2D]) -> NDArray[np.float64]:
        """Lengths (n, n), metres, symmetric, among goals and then starts; infinite where there is no path.

        No route leads from start to start: those entries are straight lines.
        """
        places = [*goals, *starts]
        xy = np.array([(place.x_m, place.y_m) for place in places]).reshape(-1, 2)
        apart_m = xy[:, None] - xy[None]
        straight_m = np.hypot(apart_m[:, :, 0], apart_m[:, :, 1])
        length_m: NDArray[np.float64] = straight_m.copy()
        if self._floor is None:
            return length_m * DETOUR
        from_place = self._grid(self._floor, self.needed_m).lengths_from(places, straight_m)
        for index in range(len(goals)):
            length_m[index] = length_m[:, index] = from_place(index)
        missing = np.isinf(length_m)
        if self._narrow_m is None or not missing.any():
            return length_m
        # Infinite lengths become those of narrow paths, from as few start places as possible.
        from_place = self._grid(self._floor, self._narrow_m).lengths_from(places, straight_m)
        while (count := missing.sum(axis=1)).any():
            index = int(np.argmax(count))
            found_m = np.where(missing[index], from_place(index), length_m[index])
            length_m[index] = length_m[:, index] = found_m
            missing[index] = missing[:, index] = False
        return length_m

    def _grid(self, floor: Floor, clearance_m: float) -> "_Grid":
        if clearance_m not in self._grids:
            zones = ZoneGrid(self._zones, floor.geometry)
            floor = floor._replace(classes=zones.close(floor.classes))
            slow = np.maximum(1.0, self._pace_m_s / zones.felt_limit_m_s()) if self._zones else None
            self._grids[clearance_m] = _Grid(
                floor, clearance_m, self.needed_m, self.unknown_cost, zones.surcharge, slow
            )
        return self._grids[clearance_m]


class _Grid:
    """The cells that paths are measured on.

    Args:
        floor: the map.
        needed_m: clearance of the narrowest place that counts.
        preferred_m: clearance below which a place is narrow.
        unknown_cost: weight of a metre of unknown floor.
        surcharge: extra cost of a metre for the choice of a path, (H, W).
        slow: factor on the length of a metre of the chosen path, (H, W); None if there are no zones.

    """

    def __init__(
        self,
        floor: Floor,
        needed_m: float,
        preferred_m: float,
        unknown_cost: float,
        surcharge: NDArray[np.float32],
        slow: NDArray[np.float64] | None,
    ) -> None:
        self._navigation = NavigationGrid(floor.classes, floor.geometry, needed_m, 1.0, preferred_m)
        self._step = COARSE if needed_m == preferred_m else 1
        self._pitch_m = self._step * floor.geometry.resolution_m
        traversable = self._navigation.traversable
        cost = np.where(floor.classes == FREE, 1.0, unknown_cost)
        cost[self._navigation.narrow] *= SLOW
        self._mask, self._cost = _every(self._step, traversable, np.where(traversable, cost + surcharge, np.inf))
        self._weight: NDArray[np.float32] | None = None
        if slow is not None:
            _, self._weight = _every(self._step, traversable, np.where(traversable, cost * slow, np.inf))
        self._fields: dict[tuple[int, int], NDArray[np.float32]] = {}
        self._bytes = 0

    def lengths_from(
        self, places: Sequence[Point2D], straight_m: NDArray[np.float64]
    ) -> Callable[[int], NDArray[np.float64]]:
        """A function that returns the lengths (n,) from the place of an index to all places."""
        cells = [self._cell(place) for place in places]
        there = np.array([cell is not None for cell in cells], np.bool_)
        rows, columns = np.array([cell for cell in cells if cell is not None], np.int64).reshape(-1, 2).T

        def lengths_m(index: int) -> NDArray[np.float64]:
            found_m = np.full(len(places), np.inf)
            cell = cells[index]
            if cell is not None:
                found_m[there] = self._field(cell)[rows, columns] * self._pitch_m
            found_m[:] = np.maximum(found_m, straight_m[index])
            found_m[index] = 0.0
            return found_m

        return lengths_m

    def _field(self, cell: tuple[int, int]) -> NDArray[np.float32]:
        field = self._fields.pop(cell, None)
        if field is None:
            field = distance_field(self._mask, self._cost, np.array([cell], np.int64))
            if self._weight is not None:
                field = measured_field(field, self._mask, self._cost, self._weight)
            self._bytes += field.nbytes
        self._fields[cell] = field
        while self._bytes > KEPT_BYTES and len(self._fields) > 1:
            self._bytes -= self._fields.pop(next(iter(self._fields))).nbytes
        return field

    def _cell(self, place: Point2D) -> tuple[int, int] | None:
        """The cell nearest to a place where a robot can stand; None if there is none within `SNAP_M`."""
        cell = self._navigation.snap(place, SNAP_M)
        return None if cell is None else (cell[0] // self._step, cell[1] // self._step)


def _every(
    step: int, traversable: NDArray[np.bool_], cost: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Downsample by `step`: a coarse cell is traversable if one of its cells is, at the cost of the cheapest."""
    if step == 1:
        return traversable, np.where(traversable, cost, 1.0).astype(np.float32)
    rows, columns = (math.ceil(size / step) for size in cost.shape)
    padding = (rows * step - cost.shape[0], columns * step - cost.shape[1])
    cost = np.pad(cost, ((0, padding[0]), (0, padding[1])), constant_values=np.inf)
    least = cost.reshape(rows, step, columns, step).min(axis=(1, 3))
    mask = np.isfinite(least)
    return mask, np.where(mask, least, 1.0).astype(np.float32)
