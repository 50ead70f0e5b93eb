"""What a robot believes about the arena's floor, cell by cell, and how two such beliefs become one.

A cell holds its evidence as log odds and the time of its last observation. Scans add evidence with the inverse
sensor model of Thrun, Burgard, Fox, *Probabilistic Robotics*, chapter 9; patches of team mates replace cells, the
later statement winning, which makes merging commutative, associative and idempotent: robots that heard the same
patches, in whatever order and however often, agree on the class of every cell.

The sign of the log odds is the class; 0 is "never seen". Evidence that cancels out flips a cell instead of
forgetting it, so a known cell stays known.
"""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.mapping import occupancy_kernels as kernels
from robrain.algorithms.numeric.kernel_array import FLOAT64, INT8, Floats, kernel_array
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

LAST_STAMP_MS = 2**31 - 1
NO_CIRCLES = np.empty((0, 3))


class PatchCells(msgspec.Struct, frozen=True, eq=False):
    """Statements about a box of cells.

    Row and column are those of its first cell; `cells` int8 (h, w) holds classes, where UNKNOWN is no statement;
    `stamp_ms` is the time to send the statements with.
    """

    row: int
    column: int
    cells: NDArray[np.int8]
    stamp_ms: int


class OccupancyGrid:
    """The belief of one robot (or of the coordinator) about every cell of a grid.

    With `surfaces` it also keeps the places of walls within their cells: `surface_at` float32 (H, W, 2), mean x and y
    of the beams' ends in cells from the origin; `surface_view` float32 (H, W, 2), mean direction of these beams as a
    vector; `surface_drift` float32 (H, W, 2), variances of the sensor's pose when it saw the wall first (m², rad²).
    They are valid where `log_odds` > 0 and `surface_hits` > 0, which counts the beams up to `SURFACE_HITS_MAX`.

    `log_odds` int8 (H, W): evidence, 0 where nothing was ever seen. `stamp_ms` int32 (H, W): when the cell was last
    observed, in milliseconds of the run's clock, 0 before. `dirty` bool (H, W): own sensing changed the class
    since the last patch. `version` grows whenever a class changes; `known_count` counts the cells not UNKNOWN.
    The arrays are to be read from outside, not written.
    """

    def __init__(self, geometry: GridGeometry, *, surfaces: bool = False) -> None:
        self.geometry = geometry
        self.log_odds: NDArray[np.int8] = np.zeros(geometry.shape, np.int8)
        self.stamp_ms: NDArray[np.int32] = np.zeros(geometry.shape, np.int32)
        self.dirty: NDArray[np.bool_] = np.zeros(geometry.shape, np.bool_)
        self.version = 0
        self.known_count = 0
        shape = geometry.shape if surfaces else (1, 1)
        self.surface_at: NDArray[np.float32] = np.zeros((*shape, 2), np.float32)
        self.surface_hits: NDArray[np.uint8] = np.zeros(shape, np.uint8)
        self.surface_view: NDArray[np.float32] = np.zeros((*shape, 2), np.float32)
        self.surface_drift: NDArray[np.float32] = np.zeros((*shape, 2), np.float32)
        # Per cell, the last scan that freed it (twice its number) or ended in it (twice its number plus one).
        self._seen_by: NDArray[np.int32] = np.zeros(geometry.shape, np.int32)
        self._scans = 0
        self._first_scan = self._published_scan = 0
        """Numbers of the first scan since `begin_stretch` and since `contradict`."""

    def classes(self) -> NDArray[np.int8]:
        """A new array of UNKNOWN, FREE and OCCUPIED, int8 (H, W)."""
        return kernels.classes(self.log_odds)

    def known(self) -> NDArray[np.bool_]:
        """A new mask of the cells that somebody has seen, bool (H, W)."""
        known: NDArray[np.bool_] = self.log_odds != 0
        return known

    def integrate_scan(
        self,
        sensor: Pose2D,
        angles_rad: Floats,
        ranges_m: Floats,
        range_max_m: float,
        stamp_ms: int,
        ignore: Floats,
        drift: tuple[float, float] = (0.0, 0.0),
    ) -> int:
        """Add the evidence of one scan; returns how many cells changed their class.

        `sensor` is the sensor's pose in the arena frame, `angles_rad` (N,) the beams' directions in the sensor's
        frame, `ranges_m` (N,) what they measured. A range of `range_max_m` or more, inf included, is a miss; NaN
        and ranges that are not positive say nothing. `ignore` (K, 3) holds circles x, y, radius in metres of the
        arena frame: a beam that ends in one (a team mate) frees its way there but marks no obstacle.

        `drift` are the variances of the sensor's pose (m², rad²), stored with new surfaces.

        Every cell takes at most one update a scan, and none is freed that a beam of the same scan ended in
        (Hornung et al., *OctoMap*, Autonomous Robots 2013). Nor does a beam free the unbroken run of occupied cells
        just before its end: it grazes their surface. Raises ValueError for arrays of other shapes and for a
        pose, a maximum range or a stamp out of bounds.
        """
        if angles_rad.shape != ranges_m.shape or angles_rad.ndim != 1:
            raise ValueError(f"expected (N,) angles and ranges, got {angles_rad.shape} and {ranges_m.shape}")
        if ignore.ndim != 2 or ignore.shape[1] != 3:
            raise ValueError(f"expected ignore circles of shape (K, 3), got {ignore.shape}")
        if not (math.isfinite(sensor.x_m) and math.isfinite(sensor.y_m) and math.isfinite(sensor.yaw_rad)):
            raise ValueError(f"expected a finite sensor pose, got {sensor}")
        if not (range_max_m > 0 and math.isfinite(range_max_m)):
            raise ValueError(f"expected a finite range_max_m > 0, got {range_max_m}")
        _check_stamp(stamp_ms)
        self._scans += 1
        changed, discovered = kernels.integrate_scan(
            self.log_odds.reshape(-1),
            self.stamp_ms.reshape(-1),
            self.dirty.reshape(-1),
            self._seen_by.reshape(-1),
            self.surface_at.reshape(-1, 2),
            self.surface_hits.reshape(-1),
            self.surface_view.reshape(-1, 2),
            self.surface_drift.reshape(-1, 2),
            (float(drift[0]), float(drift[1])),
            self.geometry.height,
            self.geometry.width,
            2 * self._scans,
            2 * self._first_scan,
            float(self.geometry.resolution_m),
            (sensor.x_m - self.geometry.origin_x_m) / self.geometry.resolution_m,
            (sensor.y_m - self.geometry.origin_y_m) / self.geometry.resolution_m,
            float(sensor.yaw_rad),
            # Arrays off the wire are read-only, a type of its own to numba, which would compile for it anew.
            kernel_array(angles_rad, FLOAT64),
            kernel_array(ranges_m, FLOAT64),
            float(range_max_m),
            int(stamp_ms),
            self._in_cells(ignore),
        )
        self._count(changed, discovered)
        return changed

    def pop_patch(self) -> PatchCells | None:
        """The classes that own sensing changed since the last call, or None; they count as told from now on.

        The patch is stamped with the latest observation of its cells.
        """
        row, column, cells, stamp_ms = kernels.patch_of(self.dirty, self.log_odds, self.stamp_ms)
        if not cells.size:
            return None
        self.dirty[row : row + cells.shape[0], column : column + cells.shape[1]] = False
        return PatchCells(row, column, cells, int(stamp_ms))

    def merge_patch(self, row: int, column: int, cells: NDArray[np.int8], stamp_ms: int) -> int:
        """Take over statements int8 (h, w) about the box at (row, column); returns how many classes changed.

        A statement replaces what is unknown or older than `stamp_ms`; at the same time OCCUPIED replaces FREE. A
        replaced cell is no longer dirty, as it now holds another's word. Raises ValueError for a box that
        leaves the grid and for a stamp out of bounds.
        """
        _check_stamp(stamp_ms)
        if cells.ndim != 2:
            raise ValueError(f"expected a box of cells (h, w), got shape {cells.shape}")
        height, width = cells.shape
        if row < 0 or column < 0 or row + height > self.geometry.height or column + width > self.geometry.width:
            raise ValueError(
                f"a patch of {height} x {width} cells at row {row}, column {column} leaves the grid of "
                f"{self.geometry.height} x {self.geometry.width} cells; do the robots share one geometry?"
            )
        changed, discovered = kernels.merge(
            self.log_odds, self.stamp_ms, self.dirty, int(row), int(column), kernel_array(cells, INT8), int(stamp_ms)
        )
        self._count(changed, discovered)
        return changed

    def begin_stretch(self) -> None:
        """Begin a new stretch of the path: forget all cells that were not seen since the last call.

        From here on the first observation of a cell counts as a change, even if its class stays. So the patches between
        two calls contain all that was seen between them (a submap), and the grid holds what was seen since the last
        call but one (the robot's recent surroundings).
        """
        old = self.known() & (self._seen_by < 2 * self._first_scan)
        self.log_odds[old] = 0
        self.stamp_ms[old] = 0
        self.dirty[:] = False
        forgotten = int(np.count_nonzero(old))
        self.known_count -= forgotten
        self.version += forgotten > 0
        self._first_scan = self._scans + 1

    def contradict(self, others: NDArray[np.int8], first_row: int, first_column: int) -> None:
        """Mark floor seen since the last call as changed where others have a wall, so that it is told again.

        `others` int8 (h, w) are the log odds of their map; its first cell is this grid's (`first_row`, `first_column`).
        Only floor with no wall in the neighbouring cells counts, because two maps of a wall may differ by a cell.
        """
        kernels.contradict(
            self.log_odds, self.dirty, self._seen_by, 2 * self._published_scan, others, first_row, first_column
        )
        self._published_scan = self._scans + 1

    def recent_surfaces(self) -> NDArray[np.int64]:
        """Rows and columns (n, 2) of the walls seen since `begin_stretch`; needs `surfaces`."""
        walls = (self.log_odds > 0) & (self.surface_hits > 0) & (self._seen_by >= 2 * self._first_scan)
        return np.argwhere(walls)

    def erase(self, first_row: int, first_column: int, end_row: int, end_column: int) -> int:
        """Make a box of cells unknown; returns how many were known."""
        box = np.s_[first_row:end_row, first_column:end_column]
        forgotten = int(np.count_nonzero(self.log_odds[box]))
        for array in (self.log_odds, self.stamp_ms, self.dirty, self._seen_by):
            array[box] = 0
        self.known_count -= forgotten
        self.version += forgotten > 0
        return forgotten

    def count_drawn(self, changed: int, discovered: int) -> None:
        """Count cells whose class was changed in the arrays directly; `discovered` of them were unknown before."""
        self.version += changed > 0
        self.known_count += discovered

    def forget(self) -> None:
        """Know nothing any more, as if nothing had ever been seen."""
        for array in (self.log_odds, self.stamp_ms, self.dirty, self._seen_by, self.surface_hits):
            array[:] = 0
        self.known_count = 0
        self.version += 1

    def _in_cells(self, circles: Floats) -> Floats:
        """Circles (K, 3) of the arena in cells from the grid's origin."""
        if not len(circles):
            return NO_CIRCLES
        geometry = self.geometry
        in_cells: Floats = (circles - (geometry.origin_x_m, geometry.origin_y_m, 0.0)) / geometry.resolution_m
        return in_cells

    def _count(self, changed: int, discovered: int) -> None:
        self.version += changed > 0
        self.known_count += discovered


def _check_stamp(stamp_ms: int) -> None:
    if not 0 <= stamp_ms <= LAST_STAMP_MS:
        raise ValueError(f"expected 0 <= stamp_ms <= {LAST_STAMP_MS} (24 days of a run's clock), got {stamp_ms}")
