"""A submap: the part of the floor that one robot saw on a few metres of its path, as a grid that can be moved.

Submaps are those of Cartographer (Hess et al., *Real-time loop closure in 2D LIDAR SLAM*, ICRA 2016). Within a submap,
the robot's drift is negligible. Only the pose of the submap is corrected later. The cells are aligned with the team's
grid, in the frame `local` of the robot that saw them. `T_arena_local` is the pose of that frame in the arena. It is the
identity until it is corrected, and cells need not be resampled.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.numeric.kernel_array import INT8, INT32, kernel_array
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.protocol.model.map_frame import ARENA, MapFrame

BLOCK_CELLS = 32
"""Step, in cells, by which a submap's box grows."""
TILE_CELLS = 8
"""Side of a tile, in cells; each tile keeps one time of observation."""
SIDE_MAX_CELLS = 4096
"""Largest side of a submap, in cells: more than a lidar sees on the path of one submap."""
STATES_FREE, STATES_OCCUPIED = np.int8(-60), np.int8(60)
"""Evidence of a free and an occupied cell, as in `OccupancyGrid.log_odds`; 0 means unknown."""

SURFACE = np.dtype([("row", "<i4"), ("column", "<i4"), ("right", "i1"), ("up", "i1"), ("view", "u1")])
"""Place of a wall within a cell. The fields `row` and `column` are those of the cell. The offset of the wall from the
cell's centre in x and y is in cells divided by `PARTS`. The field `view` is the mean direction of the beams that ended
there, in `VIEW_PARTS` of a turn from the x axis."""
PARTS = 64
VIEW_PARTS = 256
VIEWS = np.array(
    [(math.cos(part * (math.tau / VIEW_PARTS)), math.sin(part * (math.tau / VIEW_PARTS))) for part in range(VIEW_PARTS)]
)
"""(256, 2) unit vector of each direction `view`. Computed by the C library, because digests depend on it."""
SURFACES_MAX = 1 << 16
"""Surfaces of one submap."""
NO_CELLS: NDArray[np.int8] = np.zeros((0, 0), np.int8)
NO_TIMES: NDArray[np.int32] = np.zeros((0, 0), np.int32)
"""Evidence and stamps of every submap that has no cells yet, so that all share the result of its first patch."""


Box = tuple[int, int, int, int]
"""First row, first column, past-the-end row, past-the-end column."""


class Tiles(NamedTuple):
    """Tiles of a submap."""

    at: NDArray[np.int32]
    """(n, 2) row and column of each, in tiles from the submap's first cell."""
    stamps_ms: NDArray[np.int32]
    """(n,) latest observation in each."""
    cells: NDArray[np.int8]
    """(n, 8, 8) evidence."""


class SubmapStep(NamedTuple):
    """Effect of a patch on a submap.

    It is a value, so that all holders of the submap's old cells can share the new ones.
    """

    before: NDArray[np.int8]
    """The evidence to which the patch was applied, by identity."""
    row: int
    column: int
    evidence: NDArray[np.int8]
    stamp_ms: NDArray[np.int32]
    occupied: int
    """As those of `Submap`, after the patch."""
    tiles: Tiles
    """The tiles for which the patch has statements, after it."""
    is_newest: bool
    """Whether the patch was observed after all earlier cells of the tiles that it touches."""
    box: Box
    """The patch in whole tiles: first row, first column, past-the-end row and column, in the frame `local`."""


class Submap:
    """Cells that one robot saw on a few metres of its path.

    `evidence` int8 (h, w) holds `STATES_FREE`, `STATES_OCCUPIED` or 0; (`row`, `column`) of its first cell are counted
    from the origin of the team's grid. `stamp_ms` int32 (h / 8, w / 8) is the latest observation in each tile. These
    arrays are never written to: each patch makes new ones, which the submaps of several robots may share.
    """

    def __init__(self, T_arena_local: Pose2D = IDENTITY, frame: MapFrame = ARENA) -> None:
        self.T_arena_local = T_arena_local
        """Pose of the submap's frame in `frame`."""
        self.frame = frame
        self.row = self.column = 0
        self.evidence, self.stamp_ms = NO_CELLS, NO_TIMES
        self.surfaces: NDArray[np.void] | None = None
        """(n,) of `SURFACE`; None until the submap is finished."""
        self.version = 0
        """Increases with every patch and when the submap is finished."""
        self.occupied = 0
        """Number of occupied cells."""

    @property
    def is_empty(self) -> bool:
        """Whether it has no cells yet."""
        return self.evidence.size == 0

    def merge(self, row: int, column: int, cells: NDArray[np.int8], stamp_ms: int | NDArray[np.int32]) -> None:
        """Merge cells int8 (h, w), classes of an `OccupancyGrid`, into the box at (row, column).

        `stamp_ms` is the time of observation: one for all cells, or one for each tile of a box that begins at a tile's
        first cell.

        Raises:
            ValueError: the submap would become larger than `SIDE_MAX_CELLS`, or the tiles do not match the box.

        """
        self.growth(row, column, cells.shape, stamp_ms)
        self.become(self.after(row, column, cells, stamp_ms))

    def after(self, row: int, column: int, cells: NDArray[np.int8], stamp_ms: int | NDArray[np.int32]) -> SubmapStep:
        """Effect on the submap of cells that `growth` has checked.

        The submap stays unchanged; arguments as `merge`.
        """
        height, width = cells.shape
        latest_ms = latest(self.stamp_ms, row - self.row, column - self.column, height, width)
        stamps_ms = np.full((1, 1), stamp_ms, np.int32) if isinstance(stamp_ms, int) else kernel_array(stamp_ms, INT32)
        first_row, first_column, evidence, tiles_ms = self._covering(row, column, height, width)
        more, at, reported_ms, reported = add_cells(
            evidence, tiles_ms, row - first_row, column - first_column, kernel_array(cells, INT8), stamps_ms
        )
        return SubmapStep(
            self.evidence,
            first_row,
            first_column,
            evidence,
            tiles_ms,
            self.occupied + more,
            Tiles(at, reported_ms, reported),
            latest_ms < 0 or (isinstance(stamp_ms, int) and stamp_ms > latest_ms),
            (_tile_down(row), _tile_down(column), -_tile_down(-row - height), -_tile_down(-column - width)),
        )

    def become(self, step: SubmapStep) -> None:
        """Apply the step of a patch to the submap, whose `evidence` is `step.before`."""
        self.row, self.column, self.evidence, self.stamp_ms = step.row, step.column, step.evidence, step.stamp_ms
        self.occupied = step.occupied
        self.version += 1

    def growth(self, row: int, column: int, shape: tuple[int, ...], stamp_ms: int | NDArray[np.int32]) -> int:
        """Number of cells by which `merge` would enlarge the submap; arguments and errors are those of `merge`."""
        height, width = shape
        if not isinstance(stamp_ms, int):
            if row % TILE_CELLS or column % TILE_CELLS:
                raise ValueError(f"expected a box that begins where a tile does, got row {row}, column {column}")
            tiles = -(-height // TILE_CELLS), -(-width // TILE_CELLS)
            if stamp_ms.shape != tiles:
                raise ValueError(f"expected times of {tiles} tiles, got {stamp_ms.shape}")
        if self._holds(row, column, height, width):
            return 0
        first_row, first_column, end_row, end_column = self._box_with(row, column, height, width)
        rows, columns = end_row - first_row, end_column - first_column
        if max(rows, columns) > SIDE_MAX_CELLS:
            raise ValueError(f"expected a submap of at most {SIDE_MAX_CELLS} cells a side, got {rows} x {columns}")
        return rows * columns - self.evidence.size

    @property
    def size(self) -> int:
        """Bytes of the cells and surfaces."""
        return self.evidence.nbytes + (0 if self.surfaces is None else self.surfaces.nbytes)

    def classes(self) -> NDArray[np.int8]:
        """The cells as classes of an `OccupancyGrid`, int8 (h, w), a new array."""
        classes = np.full(self.evidence.shape, UNKNOWN)
        classes[self.evidence < 0] = FREE
        classes[self.evidence > 0] = OCCUPIED
        return classes

    def geometry(self, team: GridGeometry) -> GridGeometry:
        """Grid of the submap's cells in its own frame, aligned with the cells of the team's grid."""
        height, width = self.evidence.shape
        return GridGeometry(
            team.resolution_m,
            team.origin_x_m + self.column * team.resolution_m,
            team.origin_y_m + self.row * team.resolution_m,
            width,
            height,
        )

    def grid(self, team: GridGeometry) -> OccupancyGrid:
        """A new grid with the submap's cells and surfaces, in the submap's own frame; `team` is the team's grid."""
        height, width = self.evidence.shape
        grid = OccupancyGrid(self.geometry(team), surfaces=True)
        grid.log_odds[:] = self.evidence
        if self.surfaces is not None:
            rows, columns = self.surfaces["row"] - self.row, self.surfaces["column"] - self.column
            inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
            rows, columns, surfaces = rows[inside], columns[inside], self.surfaces[inside]
            grid.surfaces.hits[rows, columns] = 8
            grid.surfaces.at[rows, columns, 0] = columns + 0.5 + surfaces["right"] / PARTS
            grid.surfaces.at[rows, columns, 1] = rows + 0.5 + surfaces["up"] / PARTS
            grid.surfaces.seen_along[rows, columns] = VIEWS[surfaces["view"]]
        return grid

    @property
    def box(self) -> Box:
        """First row, first column, past-the-end row and past-the-end column of the cells, in the frame `local`."""
        return self.row, self.column, self.row + self.evidence.shape[0], self.column + self.evidence.shape[1]

    def _holds(self, row: int, column: int, height: int, width: int) -> bool:
        """Whether these cells lie in the submap's box."""
        rows, columns = self.evidence.shape
        at_row, at_column = row - self.row, column - self.column
        return at_row >= 0 and at_column >= 0 and at_row + height <= rows and at_column + width <= columns

    def _box_with(self, row: int, column: int, height: int, width: int) -> Box:
        """The submap's box, in whole blocks, enlarged by these cells."""
        first_row, first_column = _down(row), _down(column)
        end_row, end_column = _up(row + height), _up(column + width)
        if not self.is_empty:
            first_row, first_column = min(first_row, self.row), min(first_column, self.column)
            end_row = max(end_row, self.row + self.evidence.shape[0])
            end_column = max(end_column, self.column + self.evidence.shape[1])
        return first_row, first_column, end_row, end_column

    def _covering(
        self, row: int, column: int, height: int, width: int
    ) -> tuple[int, int, NDArray[np.int8], NDArray[np.int32]]:
        """First row and column, and copies of evidence and stamps, of the box enlarged to contain these cells."""
        if self._holds(row, column, height, width):
            return self.row, self.column, self.evidence.copy(), self.stamp_ms.copy()
        first_row, first_column, end_row, end_column = self._box_with(row, column, height, width)
        rows, columns = end_row - first_row, end_column - first_column
        evidence = np.zeros((rows, columns), np.int8)
        stamp_ms = np.zeros((rows // TILE_CELLS, columns // TILE_CELLS), np.int32)
        if not self.is_empty:
            at_row, at_column = self.row - first_row, self.column - first_column
            old_rows, old_columns = self.evidence.shape
            evidence[at_row : at_row + old_rows, at_column : at_column + old_columns] = self.evidence
            tile_row, tile_column = at_row // TILE_CELLS, at_column // TILE_CELLS
            tiles = self.stamp_ms.shape
            stamp_ms[tile_row : tile_row + tiles[0], tile_column : tile_column + tiles[1]] = self.stamp_ms
        return first_row, first_column, evidence, stamp_ms


def moved_box(T_arena_local: Pose2D, box: Box, grid: tuple[float, float, float]) -> Box:
    """Box of cells in the arena that contains a box of cells of the frame `local`.

    `grid` is resolution and origin of the team's grid, metres; the result may extend beyond the grid.
    """
    if T_arena_local == IDENTITY:
        return box
    yaw_rad = T_arena_local.yaw_rad
    motion = math.cos(yaw_rad), math.sin(yaw_rad), float(T_arena_local.x_m), float(T_arena_local.y_m)
    moved: Box = box_after(motion, box, grid)
    return moved


@njit(cache=True, nogil=True)
def box_after(motion: tuple[float, float, float, float], box: Box, grid: tuple[float, float, float]) -> Box:
    """As `moved_box`, after a motion by cos, sin, x and y."""
    cos, sin, x_m, y_m = motion
    resolution_m, origin_x_m, origin_y_m = grid
    low_x = low_y = np.inf
    high_x = high_y = -np.inf
    for row in (box[0], box[2]):
        for column in (box[1], box[3]):
            at_x_m, at_y_m = origin_x_m + column * resolution_m, origin_y_m + row * resolution_m
            x = (x_m + cos * at_x_m - sin * at_y_m - origin_x_m) / resolution_m
            y = (y_m + sin * at_x_m + cos * at_y_m - origin_y_m) / resolution_m
            low_x, low_y, high_x, high_y = min(low_x, x), min(low_y, y), max(high_x, x), max(high_y, y)
    return math.floor(low_y), math.floor(low_x), math.ceil(high_y), math.ceil(high_x)


def _down(cell: int) -> int:
    return cell // BLOCK_CELLS * BLOCK_CELLS


def _up(cell: int) -> int:
    return -(-cell // BLOCK_CELLS) * BLOCK_CELLS


def _tile_down(cell: int) -> int:
    return cell // TILE_CELLS * TILE_CELLS


@njit(cache=True, nogil=True)
def latest(stamps_ms: NDArray[np.int32], row: int, column: int, height: int, width: int) -> int:
    """The latest of the tiles that a box of cells touches; −1 if there is none."""
    latest_ms = -1
    end_row = min(-(-(row + height) // TILE_CELLS), stamps_ms.shape[0])
    end_column = min(-(-(column + width) // TILE_CELLS), stamps_ms.shape[1])
    for i in range(max(row // TILE_CELLS, 0), end_row):
        for j in range(max(column // TILE_CELLS, 0), end_column):
            latest_ms = max(latest_ms, stamps_ms[i, j])
    return latest_ms


@njit(cache=True, nogil=True)
def add_cells(
    evidence: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    first_row: int,
    first_column: int,
    cells: NDArray[np.int8],
    patch_ms: NDArray[np.int32],
) -> tuple[int, NDArray[np.int32], NDArray[np.int32], NDArray[np.int8]]:
    """Take cells into the arrays of a submap; `patch_ms` is (1, 1) for all cells, or (h / 8, w / 8) for tiles.

    Returns:
        The increase in the number of occupied cells, and the tiles for which there are statements, as in `Tiles`.

    """
    more = 0
    is_one = patch_ms.shape[0] == 1 and patch_ms.shape[1] == 1
    first_tile, first_tile_row = first_column // TILE_CELLS, first_row // TILE_CELLS
    tiles = (first_column + cells.shape[1] - 1) // TILE_CELLS - first_tile + 1
    is_reported = np.zeros(((first_row + cells.shape[0] - 1) // TILE_CELLS - first_tile_row + 1, tiles), np.bool_)
    # A late patch fills only unknown cells. A tile's time changes after all its cells have been compared with it.
    latest_ms = np.full(tiles, -1, np.int32)
    for i in range(cells.shape[0]):
        row = first_row + i
        tile_row = row // TILE_CELLS
        for j in range(cells.shape[1]):
            cell = cells[i, j]
            if cell < 0:
                continue
            column = first_column + j
            tile = column // TILE_CELLS
            stamp_ms = patch_ms[0, 0] if is_one else patch_ms[i // TILE_CELLS, j // TILE_CELLS]
            latest_ms[tile - first_tile] = max(latest_ms[tile - first_tile], stamp_ms)
            before = evidence[row, column]
            if before != 0 and stamp_ms < stamps_ms[tile_row, tile]:
                continue
            now = STATES_OCCUPIED if cell > 0 else STATES_FREE
            more += int(now > 0) - int(before > 0)
            evidence[row, column] = now
        if (row + 1) % TILE_CELLS == 0 or i == cells.shape[0] - 1:
            for n in range(tiles):
                is_reported[tile_row - first_tile_row, n] = latest_ms[n] >= 0
                stamps_ms[tile_row, first_tile + n] = max(stamps_ms[tile_row, first_tile + n], latest_ms[n])
            latest_ms[:] = -1
    at = np.empty((np.count_nonzero(is_reported), 2), np.int32)
    reported_ms = np.empty(at.shape[0], np.int32)
    reported = np.empty((at.shape[0], TILE_CELLS, TILE_CELLS), np.int8)
    n = 0
    for i in range(is_reported.shape[0]):
        for j in range(tiles):
            if is_reported[i, j]:
                row, column = first_tile_row + i, first_tile + j
                at[n, 0], at[n, 1], reported_ms[n] = row, column, stamps_ms[row, column]
                top, left = row * TILE_CELLS, column * TILE_CELLS
                reported[n] = evidence[top : top + TILE_CELLS, left : left + TILE_CELLS]
                n += 1
    return more, at, reported_ms, reported
