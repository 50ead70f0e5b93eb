"""A submap: what one robot saw of the floor in one stretch of its way, as a grid that can be moved as a whole.

Submaps are those of Cartographer (Hess et al., *Real-time loop closure in 2D LIDAR SLAM*, ICRA 2016): within one, the
robot's drift is negligible; what is corrected later is where the submap lies. The cells lie on the lattice of the
team's grid, in the frame `local` of the robot that saw them. `T_arena_local` says where that is in the arena: the
identity while nothing has been corrected, so that cells need not be resampled.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.kernel_array import INT8, INT32, kernel_array
from robrain.protocol.model.occupancy_grid import FREE, OCCUPIED, UNKNOWN, GridGeometry, OccupancyGrid

BLOCK_CELLS = 32
"""A submap's box grows in steps of so many cells."""
TILE_CELLS = 8
"""Times of observation are kept for tiles of so many cells a side."""
SIDE_MAX_CELLS = 4096
"""Larger than any submap that a robot makes in one stretch of its way."""
IDENTITY = Pose2D(0.0, 0.0, 0.0)
SAYS_FREE, SAYS_OCCUPIED = np.int8(-60), np.int8(60)
"""Evidence of a submap's cell, as in `OccupancyGrid.log_odds`; 0 is no statement."""


SURFACE = np.dtype([("row", "<i4"), ("column", "<i4"), ("right", "i1"), ("up", "i1"), ("view", "u1")])
"""Where in a cell a wall is: the cell, on the lattice of the team's grid; the wall's place right of and above its
middle, in `PARTS` of a cell; the direction of the beams that met it, in 256 parts of a turn from the axis x."""
PARTS = 64
SURFACES_MAX = 1 << 16
"""Of one submap."""


class Submap:
    """Cells that one robot saw in one stretch of its way.

    `evidence` int8 (h, w) holds `SAYS_FREE`, `SAYS_OCCUPIED` or 0; its first cell is (`row`, `column`) of the lattice.
    `stamp_ms` int32 (h / 8, w / 8) is the latest observation in each tile.
    """

    def __init__(self, T_arena_local: Pose2D = IDENTITY) -> None:
        self.T_arena_local = T_arena_local
        self.row = self.column = 0
        self.evidence: NDArray[np.int8] = np.zeros((0, 0), np.int8)
        self.stamp_ms: NDArray[np.int32] = np.zeros((0, 0), np.int32)
        self.surfaces: NDArray[np.void] | None = None
        """(n,) of `SURFACE`; None until the submap is finished."""
        self.version = 0
        """Grows with every patch."""
        self.occupied = 0
        """Occupied cells."""

    @property
    def is_empty(self) -> bool:
        """Whether nothing was seen yet."""
        return self.evidence.size == 0

    def take(self, row: int, column: int, cells: NDArray[np.int8], stamp_ms: int | NDArray[np.int32]) -> None:
        """Take over statements int8 (h, w), classes of an `OccupancyGrid`, about the box at (row, column).

        `stamp_ms` is when they were made; or, for a box that begins where a tile does, when for each tile of it.

        Raises:
            ValueError: the submap would become larger than `SIDE_MAX_CELLS`, or tiles do not fit.

        """
        height, width = cells.shape
        if isinstance(stamp_ms, int):
            stamps_ms = np.full((1, 1), stamp_ms, np.int32)
        else:
            if row % TILE_CELLS or column % TILE_CELLS:
                raise ValueError(f"expected a box that begins where a tile does, got row {row}, column {column}")
            tiles = -(-height // TILE_CELLS), -(-width // TILE_CELLS)
            if stamp_ms.shape != tiles:
                raise ValueError(f"expected times of {tiles} tiles, got {stamp_ms.shape}")
            stamps_ms = kernel_array(stamp_ms, INT32)
        self._cover(row, column, height, width)
        self.occupied += _take(
            self.evidence,
            self.stamp_ms,
            row - self.row,
            column - self.column,
            kernel_array(cells, INT8),
            stamps_ms,
        )
        self.version += 1

    def latest_ms(self, row: int, column: int, height: int, width: int) -> int:
        """The latest observation in any tile that a box of cells touches; −1 if there was none."""
        latest_ms: int = _latest(self.stamp_ms, row - self.row, column - self.column, height, width)
        return latest_ms

    def classes(self) -> NDArray[np.int8]:
        """The statements as classes of an `OccupancyGrid`, int8 (h, w), a new array."""
        classes = np.full(self.evidence.shape, UNKNOWN)
        classes[self.evidence < 0] = FREE
        classes[self.evidence > 0] = OCCUPIED
        return classes

    def grid(self, team: GridGeometry) -> OccupancyGrid:
        """A new grid with the submap's cells and surfaces, in the submap's own frame; `team` is the team's."""
        height, width = self.evidence.shape
        resolution_m = team.resolution_m
        grid = OccupancyGrid(
            GridGeometry(
                resolution_m,
                team.origin_x_m + self.column * resolution_m,
                team.origin_y_m + self.row * resolution_m,
                width,
                height,
            ),
            surfaces=True,
        )
        grid.log_odds[:] = self.evidence
        if self.surfaces is not None:
            rows, columns = self.surfaces["row"] - self.row, self.surfaces["column"] - self.column
            inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
            rows, columns, surfaces = rows[inside], columns[inside], self.surfaces[inside]
            grid.surface_hits[rows, columns] = 8
            grid.surface_at[rows, columns, 0] = columns + 0.5 + surfaces["right"] / PARTS
            grid.surface_at[rows, columns, 1] = rows + 0.5 + surfaces["up"] / PARTS
            angles_rad = surfaces["view"] * (math.tau / 256)
            grid.surface_view[rows, columns, 0] = np.cos(angles_rad)
            grid.surface_view[rows, columns, 1] = np.sin(angles_rad)
        return grid

    def box_in_arena(self, resolution_m: float, origin: tuple[float, float]) -> tuple[int, int, int, int]:
        """Rows and columns (first, past the last) of the arena's lattice that the submap may cover, where it lies now.

        `origin` is the lattice's, in metres; the box may leave the team's grid.
        """
        return moved_box(
            self.T_arena_local,
            (self.row, self.column, self.row + self.evidence.shape[0], self.column + self.evidence.shape[1]),
            resolution_m,
            origin,
        )

    def _cover(self, row: int, column: int, height: int, width: int) -> None:
        """Let the box hold these cells; it grows by whole blocks."""
        first_row, first_column = _down(row), _down(column)
        end_row, end_column = _up(row + height), _up(column + width)
        if not self.is_empty:
            first_row, first_column = min(first_row, self.row), min(first_column, self.column)
            end_row = max(end_row, self.row + self.evidence.shape[0])
            end_column = max(end_column, self.column + self.evidence.shape[1])
        rows, columns = end_row - first_row, end_column - first_column
        if (rows, columns) == self.evidence.shape:
            return
        if max(rows, columns) > SIDE_MAX_CELLS:
            raise ValueError(f"expected a submap of at most {SIDE_MAX_CELLS} cells a side, got {rows} x {columns}")
        evidence = np.zeros((rows, columns), np.int8)
        stamp_ms = np.zeros((rows // TILE_CELLS, columns // TILE_CELLS), np.int32)
        if not self.is_empty:
            at_row, at_column = self.row - first_row, self.column - first_column
            old_rows, old_columns = self.evidence.shape
            evidence[at_row : at_row + old_rows, at_column : at_column + old_columns] = self.evidence
            tile_row, tile_column = at_row // TILE_CELLS, at_column // TILE_CELLS
            tiles = self.stamp_ms.shape
            stamp_ms[tile_row : tile_row + tiles[0], tile_column : tile_column + tiles[1]] = self.stamp_ms
        self.row, self.column, self.evidence, self.stamp_ms = first_row, first_column, evidence, stamp_ms


def moved_box(
    T_arena_local: Pose2D, box: tuple[int, int, int, int], resolution_m: float, origin: tuple[float, float]
) -> tuple[int, int, int, int]:
    """The box of the arena's lattice that holds a box of a moved lattice: rows and columns, first and past the last."""
    if T_arena_local == IDENTITY:
        return box
    cos, sin = math.cos(T_arena_local.yaw_rad), math.sin(T_arena_local.yaw_rad)
    xs, ys = [], []
    for row in (box[0], box[2]):
        for column in (box[1], box[3]):
            x_m, y_m = origin[0] + column * resolution_m, origin[1] + row * resolution_m
            xs.append((T_arena_local.x_m + cos * x_m - sin * y_m - origin[0]) / resolution_m)
            ys.append((T_arena_local.y_m + sin * x_m + cos * y_m - origin[1]) / resolution_m)
    return math.floor(min(ys)), math.floor(min(xs)), math.ceil(max(ys)), math.ceil(max(xs))


def _down(cell: int) -> int:
    return cell // BLOCK_CELLS * BLOCK_CELLS


def _up(cell: int) -> int:
    return -(-cell // BLOCK_CELLS) * BLOCK_CELLS


@njit(cache=True, nogil=True)
def _latest(stamps_ms: NDArray[np.int32], row: int, column: int, height: int, width: int) -> int:
    """The latest of the tiles that a box of cells touches; −1 if there is none."""
    latest_ms = -1
    end_row = min(-(-(row + height) // TILE_CELLS), stamps_ms.shape[0])
    end_column = min(-(-(column + width) // TILE_CELLS), stamps_ms.shape[1])
    for i in range(max(row // TILE_CELLS, 0), end_row):
        for j in range(max(column // TILE_CELLS, 0), end_column):
            latest_ms = max(latest_ms, stamps_ms[i, j])
    return latest_ms


@njit(cache=True, nogil=True)
def _take(
    evidence: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    first_row: int,
    first_column: int,
    cells: NDArray[np.int8],
    said_ms: NDArray[np.int32],
) -> int:
    """By how much the number of occupied cells has grown; `said_ms` (1, 1) is of all cells, else (h / 8, w / 8)."""
    more = 0
    is_one = said_ms.shape[0] == 1 and said_ms.shape[1] == 1
    # What comes late fills gaps and undoes nothing; a tile's time is that before this patch until all of it is in.
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            if cells[i, j] < 0:
                continue
            row, column = first_row + i, first_column + j
            stamp_ms = said_ms[0, 0] if is_one else said_ms[i // TILE_CELLS, j // TILE_CELLS]
            if evidence[row, column] != 0 and stamp_ms < stamps_ms[row // TILE_CELLS, column // TILE_CELLS]:
                continue
            now = SAYS_OCCUPIED if cells[i, j] > 0 else SAYS_FREE
            more += int(now > 0) - int(evidence[row, column] > 0)
            evidence[row, column] = now
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            if cells[i, j] >= 0:
                tile_row, tile_column = (first_row + i) // TILE_CELLS, (first_column + j) // TILE_CELLS
                stamp_ms = said_ms[0, 0] if is_one else said_ms[i // TILE_CELLS, j // TILE_CELLS]
                stamps_ms[tile_row, tile_column] = max(stamps_ms[tile_row, tile_column], stamp_ms)
    return more
