"""An occupancy grid with surfaces, computed plainly: cell by cell, beam by beam, from its definition."""

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

Floats = NDArray[np.float64]
Cell = tuple[int, int]
HIT, MISS, FLIPPED, LIMIT = 40, -10, 10, 100
HIT_DEPTH_CELLS = 0.2
SURFACE_HITS_MAX = 30


class Surface:
    """Where in its cell a wall is."""

    def __init__(self, drift: tuple[float, float]) -> None:
        self.drift = drift
        self.hits = 0
        self.at, self.view = np.zeros(2), np.zeros(2)

    def add(self, at: Floats, view: Floats) -> None:
        self.hits = min(self.hits + 1, SURFACE_HITS_MAX)
        self.at = self.at + (at - self.at) / self.hits
        self.view = self.view + (view - self.view) / self.hits


class GridReference:
    """What `OccupancyGrid` promises."""

    def __init__(self, geometry: GridGeometry) -> None:
        self.geometry = geometry
        self.evidence: dict[Cell, int] = {}
        self.stamp_ms: dict[Cell, int] = {}
        self.dirty: set[Cell] = set()
        self.surfaces: dict[Cell, Surface] = {}
        self.recent: set[Cell] = set()
        """Seen since the stretch began."""
        self.untold: set[Cell] = set()
        """Seen since `contradict` was asked last."""

    def scan(
        self,
        sensor: Pose2D,
        angles_rad: Floats,
        ranges_m: Floats,
        range_max_m: float,
        stamp_ms: int,
        ignore: Floats,
        drift: tuple[float, float],
    ) -> int:
        """Take in a scan; how many cells changed their class."""
        resolution_m = self.geometry.resolution_m
        origin = np.array((self.geometry.origin_x_m, self.geometry.origin_y_m))
        start = (np.array((sensor.x_m, sensor.y_m)) - origin) / resolution_m
        hit: set[Cell] = set()
        ways: list[tuple[Floats, bool]] = []
        changed = 0
        for angle_rad, range_m in zip(angles_rad, ranges_m, strict=True):
            if not range_m > 0:
                continue
            beam = np.array((math.cos(sensor.yaw_rad + angle_rad), math.sin(sensor.yaw_rad + angle_rad)))
            end = start + beam * min(range_m, range_max_m) / resolution_m
            at_other = any(math.dist(origin + resolution_m * end, circle[:2]) <= circle[2] for circle in ignore)
            is_hit = range_m < range_max_m and not at_other
            deep = end + HIT_DEPTH_CELLS * beam if is_hit else end
            ways.append((deep, is_hit))
            cell = math.floor(deep[1]), math.floor(deep[0])
            if not is_hit or not self.geometry.contains(*cell):
                continue
            if self.evidence.get(cell, 0) <= 0 and cell not in hit:
                self.surfaces[cell] = Surface(drift)
            self.surfaces[cell].add(end, beam)
            if cell not in hit:
                hit.add(cell)
                changed += self._see(cell, HIT, stamp_ms)
        freed: set[Cell] = set()
        for end, is_hit in ways:
            crossed = [cell for cell in crossed_cells(start, end) if self.geometry.contains(*cell)]
            while is_hit and crossed and self.evidence.get(crossed[-1], 0) > 0:
                crossed.pop()
            for cell in crossed:
                if cell not in hit and cell not in freed:
                    freed.add(cell)
                    changed += self._see(cell, MISS, stamp_ms)
        return changed

    def begin_stretch(self) -> None:
        """Keep only what was seen in the stretch that ends now."""
        for cell in set(self.evidence) - self.recent:
            del self.evidence[cell], self.stamp_ms[cell]
        self.dirty.clear()
        self.recent = set()

    def contradict(self, others: NDArray[np.int8], first_row: int, first_column: int) -> None:
        """Floor that was seen since the last call, without walls about it, is dirty where others have a wall."""
        height, width = self.geometry.shape
        for i, j in np.argwhere(others > 0).tolist():
            row, column = first_row + i, first_column + j
            about = [(row + k, column + n) for k in (-1, 0, 1) for n in (-1, 0, 1)]
            is_inside = 1 <= row < height - 1 and 1 <= column < width - 1
            is_floor = self.evidence.get((row, column), 0) < 0 and (row, column) in self.untold
            if is_inside and is_floor and all(self.evidence.get(cell, 0) <= 0 for cell in about):
                self.dirty.add((row, column))
        self.untold.clear()

    def array(self, cells: dict[Cell, int]) -> NDArray[np.int64]:
        """(H, W) of values, 0 where there are none."""
        found = np.zeros(self.geometry.shape, np.int64)
        for cell, value in cells.items():
            found[cell] = value
        return found

    def _see(self, cell: Cell, evidence: int, stamp_ms: int) -> int:
        before = self.evidence.get(cell, 0)
        after = before + evidence
        if after == 0:
            after = FLIPPED if evidence > 0 else -FLIPPED
        self.evidence[cell] = max(-LIMIT, min(LIMIT, after))
        self.stamp_ms[cell] = max(stamp_ms, self.stamp_ms.get(cell, 0))
        flips = before == 0 or (before > 0) != (after > 0)
        if flips or cell not in self.recent:
            self.dirty.add(cell)
        self.recent.add(cell)
        self.untold.add(cell)
        return int(flips)


def crossed_cells(start: Floats, end: Floats) -> list[Cell]:
    """The cells on the way, without the last: between each two borders of cells that are crossed lies one."""
    borders = [0.0]
    for axis in range(2):
        low, high = sorted((math.floor(start[axis]), math.floor(end[axis])))
        borders += [(line - start[axis]) / (end[axis] - start[axis]) for line in range(low + 1, high + 1)]
    borders.sort()
    middles = [start + (end - start) * (a + b) / 2.0 for a, b in itertools.pairwise(borders)]
    return [(math.floor(y), math.floor(x)) for x, y in middles]
