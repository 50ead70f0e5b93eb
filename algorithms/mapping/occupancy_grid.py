"""A robot's belief about the arena's floor, cell by cell, and the merge of two such beliefs.

A cell holds its evidence as log odds and the time of its last observation. Scans add evidence with the inverse sensor
model of Thrun, Burgard, Fox, *Probabilistic Robotics*, chapter 9. Patches of teammates replace cells, and the later
statement wins. Merging is therefore commutative, associative and idempotent. Robots that received the same patches, in
any order and any number of times, agree on the class of every cell.

The sign of the log odds is the class; 0 is "never seen". Evidence that cancels out flips a cell instead of
forgetting it, so a known cell stays known.
"""

import math
from typing import NamedTuple

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import FLOAT64, INT8, Floats, kernel_array
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

LOG_ODDS_LIMIT = 100
"""Bound of the evidence. One unit is 1/20 nat, so the bound is a probability of 0.993."""
HIT_LOG_ODDS = 40
"""Evidence of a beam that ended in a cell: 2 nat, a probability of 0.88."""
MISS_LOG_ODDS = 10
"""Evidence of a scan that saw through a cell: half a nat, so it takes four such scans to undo one hit."""
FLIPPED_LOG_ODDS = 10
"""Evidence of the new class when a cell's evidence is used up and the cell flips."""
MERGED_LOG_ODDS = 60
"""Certainty of a teammate's statement."""
SURFACE_HITS_MAX = 30
"""Number of beams in the mean place of a cell; with more beams, older ones lose weight exponentially."""
HIT_DEPTH_CELLS = 0.2
"""Depth behind the measured end at which a beam's obstacle is assumed. A surface on the border of two cells then marks
the cell behind the border. Walls of a map lie on such borders, where range noise falls on either side."""


class Surfaces(NamedTuple):
    """Places of walls within their cells; valid where `log_odds` > 0 and `hits` > 0."""

    at: NDArray[np.float32]
    """(H, W, 2) mean x and y of the beams' ends, cells from the origin."""
    hits: NDArray[np.uint8]
    """(H, W) number of these beams, up to `SURFACE_HITS_MAX`."""
    seen_along: NDArray[np.float32]
    """(H, W, 2) mean direction of these beams as a vector."""
    drift: NDArray[np.float32]
    """(H, W, 2) variances of the sensor's pose when it first saw the wall: m², rad²."""


@njit(cache=True, nogil=True)
def classes(log_odds: NDArray[np.int8]) -> NDArray[np.int8]:
    """Class of each cell, by the sign of its evidence."""
    result = np.empty(log_odds.shape, np.int8)
    for row in range(log_odds.shape[0]):
        for column in range(log_odds.shape[1]):
            value = log_odds[row, column]
            result[row, column] = UNKNOWN if value == 0 else (OCCUPIED if value > 0 else FREE)
    return result


@njit(cache=True, nogil=True)
def patch_of(
    mask: NDArray[np.bool_], log_odds: NDArray[np.int8], stamps_ms: NDArray[np.int32]
) -> tuple[int, int, NDArray[np.int8], int]:
    """Classes of the masked cells: row and column of the smallest box of them, its cells, the latest stamp.

    A box without cells if no cell is masked.
    """
    height, width = mask.shape
    first_row, end_row, first_column, end_column = height, 0, width, 0
    for row in range(height):
        is_any = False
        for column in range(width):
            is_any |= mask[row, column]
        if not is_any:
            continue
        first_row, end_row = min(first_row, row), row + 1
        column = 0
        while column < first_column and not mask[row, column]:
            column += 1
        first_column = min(first_column, column)
        column = width
        while column > end_column and not mask[row, column - 1]:
            column -= 1
        end_column = max(end_column, column)
    if end_row == 0:
        return 0, 0, np.empty((0, 0), np.int8), 0
    cells = np.empty((end_row - first_row, end_column - first_column), np.int8)
    stamp_ms = -1
    for row in range(first_row, end_row):
        for column in range(first_column, end_column):
            if not mask[row, column]:
                cells[row - first_row, column - first_column] = UNKNOWN
                continue
            value = log_odds[row, column]
            cells[row - first_row, column - first_column] = UNKNOWN if value == 0 else (OCCUPIED if value > 0 else FREE)
            stamp_ms = max(stamp_ms, stamps_ms[row, column])
    return first_row, first_column, cells, stamp_ms


@njit(cache=True, nogil=True)
def contradict(
    log_odds: NDArray[np.int8],
    dirty: NDArray[np.bool_],
    seen_by: NDArray[np.int32],
    since: int,
    others: NDArray[np.int8],
    first_row: int,
    first_column: int,
) -> None:
    """Mark floor that was seen by scan `since` or a later one and that is a wall in `others`."""
    height, width = log_odds.shape
    for i in range(others.shape[0]):
        for j in range(others.shape[1]):
            row, column = first_row + i, first_column + j
            if others[i, j] <= 0 or row < 1 or column < 1 or row >= height - 1 or column >= width - 1:
                continue
            if log_odds[row, column] >= 0 or seen_by[row, column] < since:
                continue
            is_floor = True
            for k in range(row - 1, row + 2):
                for n in range(column - 1, column + 2):
                    is_floor = is_floor and log_odds[k, n] <= 0
            if is_floor:
                dirty[row, column] = True


@njit(cache=True, nogil=True)
def merge(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    dirty: NDArray[np.bool_],
    first_row: int,
    first_column: int,
    cells: NDArray[np.int8],
    stamp_ms: int,
) -> tuple[int, int]:
    """Changed classes and newly known cells of a last-writer-wins merge."""
    changed = 0
    discovered = 0
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            statement = cells[i, j]
            if statement < 0:
                continue
            row, column = first_row + i, first_column + j
            occupied = statement > 0
            value = log_odds[row, column]
            known_ms = stamps_ms[row, column]
            if value == 0:
                discovered += 1
                changed += 1
            elif stamp_ms > known_ms or (stamp_ms == known_ms and occupied and value < 0):
                changed += occupied != (value > 0)
            else:
                continue
            log_odds[row, column] = MERGED_LOG_ODDS if occupied else -MERGED_LOG_ODDS
            stamps_ms[row, column] = stamp_ms
            dirty[row, column] = False
    return changed, discovered


@njit(cache=True, nogil=True)
def observe(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    dirty: NDArray[np.bool_],
    cell: int,
    evidence: int,
    stamp_ms: int,
) -> tuple[int, int]:
    """Add evidence to one cell of the flattened grid; changed classes and newly known cells, each 0 or 1."""
    before = int(log_odds[cell])
    after = before + evidence
    if after == 0:
        after = FLIPPED_LOG_ODDS if evidence > 0 else -FLIPPED_LOG_ODDS
    log_odds[cell] = max(-LOG_ODDS_LIMIT, min(LOG_ODDS_LIMIT, after))
    stamps_ms[cell] = max(stamp_ms, stamps_ms[cell])
    if before != 0 and (before > 0) == (after > 0):
        return 0, 0
    dirty[cell] = True
    return 1, 1 if before == 0 else 0


@njit(cache=True, nogil=True)
def integrate_scan(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    dirty: NDArray[np.bool_],
    seen_by: NDArray[np.int32],
    surfaces: Surfaces,
    drift: tuple[float, float],
    shape: tuple[int, int],
    scan: int,
    first_scan: int,
    resolution_m: float,
    sensor_x: float,
    sensor_y: float,
    yaw_rad: float,
    angles_rad: Floats,
    ranges_m: Floats,
    range_max_m: float,
    stamp_ms: int,
    ignore: Floats,
) -> tuple[int, int]:
    """Changed classes and newly known cells of the flattened grid; sensor and circles in cells from its origin."""
    changed = 0
    discovered = 0
    beams = angles_rad.shape[0]
    end_x = np.full(beams, np.nan)
    end_y = np.full(beams, np.nan)
    is_hit = np.zeros(beams, np.bool_)
    height, width = shape
    keeps_surfaces = surfaces.hits.size > 1

    # Ends first: cells hit by this scan may not be freed by its beams.
    for beam in range(beams):
        range_m = ranges_m[beam]
        if not range_m > 0:
            continue
        direction_x = math.cos(yaw_rad + angles_rad[beam])
        direction_y = math.sin(yaw_rad + angles_rad[beam])
        length = min(range_m, range_max_m) / resolution_m
        end_x[beam] = sensor_x + length * direction_x
        end_y[beam] = sensor_y + length * direction_y
        is_hit[beam] = range_m < range_max_m
        for k in range(ignore.shape[0]):
            dx, dy = end_x[beam] - ignore[k, 0], end_y[beam] - ignore[k, 1]
            if dx * dx + dy * dy <= ignore[k, 2] * ignore[k, 2]:
                is_hit[beam] = False
        if not is_hit[beam]:
            continue
        at_x, at_y = end_x[beam], end_y[beam]
        end_x[beam] += HIT_DEPTH_CELLS * direction_x
        end_y[beam] += HIT_DEPTH_CELLS * direction_y
        row, column = math.floor(end_y[beam]), math.floor(end_x[beam])
        cell = row * width + column
        if not (0 <= row < height and 0 <= column < width):
            continue
        if keeps_surfaces:
            at, view = surfaces.at[row, column], surfaces.seen_along[row, column]
            hits = 0 if log_odds[cell] <= 0 and seen_by[cell] != scan + 1 else surfaces.hits[row, column]
            if hits == 0:
                surfaces.drift[row, column, 0], surfaces.drift[row, column, 1] = drift
            hits = min(hits + 1, SURFACE_HITS_MAX)
            surfaces.hits[row, column] = hits
            at[0] += (at_x - at[0]) / hits
            at[1] += (at_y - at[1]) / hits
            view[0] += (direction_x - view[0]) / hits
            view[1] += (direction_y - view[1]) / hits
        if seen_by[cell] != scan + 1:
            dirty[cell] |= seen_by[cell] < first_scan
            seen_by[cell] = scan + 1
            flips, finds = observe(log_odds, stamps_ms, dirty, cell, HIT_LOG_ODDS, stamp_ms)
            changed += flips
            discovered += finds

    # Then the path there: Amanatides and Woo, A Fast Voxel Traversal Algorithm for Ray Tracing, Eurographics 1987.
    start_row, start_column = math.floor(sensor_y), math.floor(sensor_x)
    crossed = np.empty(height + width, np.int64)
    for beam in range(beams):
        if math.isnan(end_x[beam]):
            continue
        row, column = start_row, start_column
        dx, dy = end_x[beam] - sensor_x, end_y[beam] - sensor_y
        # Crossings are counted, not compared with the beam's length, so that rounding cannot lead past its end.
        left_x = abs(math.floor(end_x[beam]) - start_column)
        left_y = abs(math.floor(end_y[beam]) - start_row)
        step_column = 1 if dx > 0 else -1
        step_row = 1 if dy > 0 else -1
        # Fractions of the beam from one border to the next, and from the sensor to the first.
        delta_x = 1.0 / abs(dx) if left_x > 0 else np.inf
        delta_y = 1.0 / abs(dy) if left_y > 0 else np.inf
        next_x = (column + 1 - sensor_x if dx > 0 else sensor_x - column) * delta_x if left_x > 0 else np.inf
        next_y = (row + 1 - sensor_y if dy > 0 else sensor_y - row) * delta_y if left_y > 0 else np.inf
        count = 0
        for _ in range(left_x + left_y):
            if 0 <= row < height and 0 <= column < width:
                crossed[count] = row * width + column
                count += 1
            if next_x < next_y:
                column += step_column
                left_x -= 1
                next_x = next_x + delta_x if left_x > 0 else np.inf
            else:
                row += step_row
                left_y -= 1
                next_y = next_y + delta_y if left_y > 0 else np.inf
        # The occupied cells just before a hit were grazed: a wall that fills half a cell is no less a wall.
        while is_hit[beam] and count > 0 and log_odds[crossed[count - 1]] > 0:
            count -= 1
        for k in range(count):
            cell = crossed[k]
            if seen_by[cell] < scan:
                dirty[cell] |= seen_by[cell] < first_scan
                seen_by[cell] = scan
                flips, finds = observe(log_odds, stamps_ms, dirty, cell, -MISS_LOG_ODDS, stamp_ms)
                changed += flips
                discovered += finds
    return changed, discovered


LAST_STAMP_MS = 2**31 - 1
NO_CIRCLES = np.empty((0, 3))


class PatchCells(msgspec.Struct, frozen=True, eq=False):
    """Statements about a box of cells.

    Row and column are those of its first cell. The array `cells` int8 (h, w) holds classes, where UNKNOWN is no
    statement. The stamp `stamp_ms` is the time to send the statements with.
    """

    row: int
    column: int
    cells: NDArray[np.int8]
    stamp_ms: int


class OccupancyGrid:
    """The belief of one robot (or of the coordinator) about every cell of a grid.

    With `surfaces` it also keeps the places of walls within their cells.

    `log_odds` int8 (H, W): evidence, 0 where nothing was ever seen. `stamp_ms` int32 (H, W): when the cell was last
    observed, in milliseconds of the run's clock, 0 before. `dirty` bool (H, W): own sensing changed the class since the
    last patch. `version` grows whenever a class changes; `known_count` counts the cells not UNKNOWN. Other code may
    read the arrays but not write them.
    """

    def __init__(self, geometry: GridGeometry, *, surfaces: bool = False) -> None:
        self.geometry = geometry
        self.log_odds: NDArray[np.int8] = np.zeros(geometry.shape, np.int8)
        self.stamp_ms: NDArray[np.int32] = np.zeros(geometry.shape, np.int32)
        self.dirty: NDArray[np.bool_] = np.zeros(geometry.shape, np.bool_)
        self.version = 0
        self.known_count = 0
        shape = geometry.shape if surfaces else (1, 1)
        at, view, drift = np.zeros((3, *shape, 2), np.float32)
        self.surfaces = Surfaces(at, np.zeros(shape, np.uint8), view, drift)
        # Per cell, the last scan that freed it (twice its number) or ended in it (twice its number plus one).
        self._seen_by: NDArray[np.int32] = np.zeros(geometry.shape, np.int32)
        self._scans = 0
        self._first_scan = self._published_scan = 0
        """Numbers of the first scan since `begin_stretch` and since `contradict`."""

    def classes(self) -> NDArray[np.int8]:
        """A new array of UNKNOWN, FREE and OCCUPIED, int8 (H, W)."""
        return classes(self.log_odds)

    def known(self) -> NDArray[np.bool_]:
        """A new mask of the seen cells, bool (H, W)."""
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

        `sensor` is the sensor's pose in the grid's frame, `angles_rad` (N,) the beams' directions from the sensor,
        `ranges_m` (N,) their measurements. A range of `range_max_m` or more, inf included, is a miss; NaN and ranges
        that are not positive are ignored. `ignore` (K, 3) holds circles x, y, radius in metres of the grid's frame. A
        beam that ends in a circle (a teammate) frees its path there but marks no obstacle.

        `drift` are the variances of the sensor's pose (m², rad²), stored with new surfaces.

        Every cell receives at most one update a scan. No cell is freed in which a beam of the same scan ended (Hornung
        et al., *OctoMap*, Autonomous Robots 2013). Nor does a beam free the unbroken run of occupied cells just before
        its end: it grazes their surface. Raises ValueError for arrays of other shapes and for a pose, a maximum range
        or a stamp out of bounds.
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
        changed, discovered = integrate_scan(
            self.log_odds.reshape(-1),
            self.stamp_ms.reshape(-1),
            self.dirty.reshape(-1),
            self._seen_by.reshape(-1),
            self.surfaces,
            (float(drift[0]), float(drift[1])),
            self.geometry.shape,
            2 * self._scans,
            2 * self._first_scan,
            float(self.geometry.resolution_m),
            (sensor.x_m - self.geometry.origin_x_m) / self.geometry.resolution_m,
            (sensor.y_m - self.geometry.origin_y_m) / self.geometry.resolution_m,
            float(sensor.yaw_rad),
            # Arrays off the wire are read-only. For this separate type numba would compile again.
            kernel_array(angles_rad, FLOAT64),
            kernel_array(ranges_m, FLOAT64),
            float(range_max_m),
            int(stamp_ms),
            self._in_cells(ignore),
        )
        self.count_drawn(changed, discovered)
        return changed

    def pop_patch(self) -> PatchCells | None:
        """The classes that own sensing changed since the last call, or None; they count as published from now on.

        The patch is stamped with the latest observation of its cells.
        """
        row, column, cells, stamp_ms = patch_of(self.dirty, self.log_odds, self.stamp_ms)
        if not cells.size:
            return None
        self.dirty[row : row + cells.shape[0], column : column + cells.shape[1]] = False
        return PatchCells(row, column, cells, int(stamp_ms))

    def merge_patch(self, row: int, column: int, cells: NDArray[np.int8], stamp_ms: int) -> int:
        """Take over statements int8 (h, w) about the box at (row, column); returns how many classes changed.

        A statement replaces cells that are unknown or older than `stamp_ms`; at the same time OCCUPIED replaces FREE. A
        replaced cell is no longer dirty, as it now holds another's word. Raises ValueError for a box that leaves the
        grid and for a stamp out of bounds.
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
        changed, discovered = merge(
            self.log_odds, self.stamp_ms, self.dirty, int(row), int(column), kernel_array(cells, INT8), int(stamp_ms)
        )
        self.count_drawn(changed, discovered)
        return changed

    def begin_stretch(self) -> None:
        """Begin a new stretch of the path: forget all cells that were not seen since the last call.

        From here on the first observation of a cell counts as a change, even if its class stays. The patches between
        two calls thus contain all cells seen between them (a submap). The grid holds the cells seen since the last call
        but one (the robot's recent surroundings).
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
        """Mark floor seen since the last call as changed where others have a wall, so that it is published again.

        `others` int8 (h, w) are the log odds of their map; its first cell is this grid's (`first_row`, `first_column`).
        Only floor with no wall in the neighbouring cells counts, because two maps of a wall may differ by a cell.
        """
        contradict(self.log_odds, self.dirty, self._seen_by, 2 * self._published_scan, others, first_row, first_column)
        self._published_scan = self._scans + 1

    def recent_surfaces(self) -> NDArray[np.int64]:
        """Rows and columns (n, 2) of the walls seen since `begin_stretch`; needs `surfaces`."""
        walls = (self.log_odds > 0) & (self.surfaces.hits > 0) & (self._seen_by >= 2 * self._first_scan)
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
        """Count cells whose class was changed in the arrays; `discovered` of them were unknown before."""
        self.version += changed > 0
        self.known_count += discovered

    def forget(self) -> None:
        """Reset all cells to unknown, as if nothing had ever been seen."""
        for array in (self.log_odds, self.stamp_ms, self.dirty, self._seen_by, self.surfaces.hits):
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


def _check_stamp(stamp_ms: int) -> None:
    if not 0 <= stamp_ms <= LAST_STAMP_MS:
        raise ValueError(f"expected 0 <= stamp_ms <= {LAST_STAMP_MS} (24 days of a run's clock), got {stamp_ms}")
