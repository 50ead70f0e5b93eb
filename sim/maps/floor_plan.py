"""A floor plan: which cells of the arena are wall, and where a round body can go.

The grid follows ROS nav_msgs/OccupancyGrid: row 0 has the lowest y, column 0 the lowest x. Cell (row, col) covers x
from origin_x_m + col · resolution_m to one resolution_m more, y likewise.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.recording.errors import MapError
from robrain.recording.reader.map_server import read_free

FAR_CELLS = 0.71
"""Half a cell's diagonal: so much less than that of its cell's middle a place's clearance can be."""


class PlacementError(MapError):
    """A floor plan has no room for a robot, a mote or a charger."""


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """Walls of an arena on a grid; everything outside the grid is wall.

    `occupied` is (H, W) bool, row 0 at the lowest y, kept as a read-only copy; cells of unknown content are occupied.
    `origin_x_m`, `origin_y_m` is the corner of cell (0, 0) with the lowest x and y: metres, arena frame.
    """

    occupied: NDArray[np.bool_]
    resolution_m: float
    origin_x_m: float
    origin_y_m: float
    name: str

    def __post_init__(self) -> None:
        occupied = np.array(self.occupied, dtype=np.bool_, order="C")
        occupied.setflags(write=False)
        object.__setattr__(self, "occupied", occupied)

    @cached_property
    def geometry(self) -> GridGeometry:
        """Position of its cells in the arena frame."""
        rows, columns = self.occupied.shape
        return GridGeometry(self.resolution_m, self.origin_x_m, self.origin_y_m, columns, rows)

    @property
    def size_m(self) -> tuple[float, float]:
        """Width along x and height along y, metres."""
        rows, cols = self.occupied.shape
        return cols * self.resolution_m, rows * self.resolution_m

    @cached_property
    def clearance_m(self) -> NDArray[np.float64]:
        """(H, W), metres from a cell's centre to the nearest edge of an occupied cell or of the grid; 0 if occupied.

        A disc of that radius about the centre meets no wall, a larger one does. Read-only.
        """
        walled = np.pad(self.occupied, 1, constant_values=True)
        clearance_m = distance_to_cells_m(walled, self.resolution_m)[1:-1, 1:-1]
        clearance_m.setflags(write=False)
        return clearance_m

    def clearance_at(self, x_m: float, y_m: float) -> float:
        """Clearance of the cell that holds a point, metres; 0 outside the grid."""
        cell = self.geometry.cell_of(x_m, y_m)
        return float(self.clearance_m[cell]) if self.geometry.contains(*cell) else 0.0

    def wall_distance_m(self, x_m: float, y_m: float, exact_up_to_m: float) -> float:
        """Distance in metres from a place, arena frame, to the nearest wall; 0 inside a wall and off the floor.

        Distances over `exact_up_to_m` are lower bounds.
        """
        row, column = self.geometry.cell_of(x_m, y_m)
        if not self.geometry.contains(row, column):
            return 0.0
        of_cell_m = float(self.clearance_m[row, column]) - FAR_CELLS * self.resolution_m
        if of_cell_m > exact_up_to_m:
            return of_cell_m
        x_m, y_m = x_m - self.origin_x_m, y_m - self.origin_y_m
        width_m, height_m = self.size_m
        reach = math.ceil(exact_up_to_m / self.resolution_m) + 1
        top, left = max(0, row - reach), max(0, column - reach)
        rows, columns = np.nonzero(self.occupied[top : row + reach + 1, left : column + reach + 1])
        beyond_x_m = np.abs((columns + left + 0.5) * self.resolution_m - x_m) - self.resolution_m / 2
        beyond_y_m = np.abs((rows + top + 0.5) * self.resolution_m - y_m) - self.resolution_m / 2
        to_wall_m = np.hypot(np.maximum(beyond_x_m, 0.0), np.maximum(beyond_y_m, 0.0)).min(initial=np.inf)
        return min(float(to_wall_m), x_m, width_m - x_m, y_m, height_m - y_m)

    def contains_free(self, x_m: float, y_m: float) -> bool:
        """Whether a point in the arena frame lies on the grid and in no wall."""
        row, col = self.geometry.cell_of(x_m, y_m)
        return self.geometry.contains(row, col) and not bool(self.occupied[row, col])

    def reachable(self, starts: list[Point2D], radius_m: float) -> NDArray[np.bool_]:
        """(H, W), the free cells that a round body of radius_m can sweep from any of the starts.

        The body's centre moves between 4-neighbours among cells with clearance_m ≥ radius_m. It sweeps the free cells
        whose centre comes within radius_m and half a cell, since it may be between two centres. A start where the body
        does not fit adds nothing.
        """
        passable = ~self.occupied & (self.clearance_m >= radius_m)
        # scipy's default structure in the plane is the 4-neighbourhood.
        labels, _ = ndimage.label(passable)
        cells = (self.geometry.cell_of(start.x_m, start.y_m) for start in starts)
        held = {int(labels[cell]) for cell in cells if self.geometry.contains(*cell)} - {0}
        if not held:
            return np.zeros_like(self.occupied)
        roamed = np.isin(labels, sorted(held))
        distance_m = ndimage.distance_transform_edt(~roamed) * self.resolution_m
        return ~self.occupied & (distance_m <= radius_m + self.resolution_m / 2)


def classes_on(
    geometry: GridGeometry, own: GridGeometry, free: NDArray[np.bool_], surface: NDArray[np.bool_]
) -> NDArray[np.int8]:
    """(H, W) classes of the cells of a grid.

    Args:
        geometry: of the grid.
        own: of the two masks.
        free: cells between walls; where both fall on one cell, it is occupied.
        surface: cells at the surfaces of walls. Cells in neither are unknown.

    """
    classes = np.full(geometry.shape, UNKNOWN, np.int8)
    for mask, value in ((free, FREE), (surface, OCCUPIED)):
        rows, columns = np.nonzero(mask)
        x_m = own.origin_x_m + (columns + 0.5) * own.resolution_m
        y_m = own.origin_y_m + (rows + 0.5) * own.resolution_m
        row = ((y_m - geometry.origin_y_m) / geometry.resolution_m).astype(np.int64)
        column = ((x_m - geometry.origin_x_m) / geometry.resolution_m).astype(np.int64)
        classes[row, column] = value
    return classes


def distance_to_cells_m(marked: NDArray[np.bool_], resolution_m: float) -> NDArray[np.float64]:
    """(H, W), metres from each cell's centre to the nearest point of a marked cell; 0 inside one, inf without.

    The point of a square that is nearest to the centre of another cell is a corner or the middle of a side. Thus the
    Euclidean distance transform on a lattice of half the pitch is exact. A transform on the cells measures from centre
    to centre: its gaps are up to 0.7 cells too wide.
    """
    if not marked.any():
        return np.full(marked.shape, np.inf)
    rows, cols = marked.shape
    clear = np.ones((2 * rows + 1, 2 * cols + 1), dtype=np.bool_)
    for row in range(3):
        for col in range(3):
            clear[row : row + 2 * rows : 2, col : col + 2 * cols : 2] &= ~marked
    distance: NDArray[np.float64] = ndimage.distance_transform_edt(clear)
    return np.ascontiguousarray(distance[1::2, 1::2]) * (resolution_m / 2)


def load_map(path: Path) -> FloorPlan:
    """The floor plan of a map_server YAML file, named after the file (MapError as `read_free`)."""
    free, settings = read_free(path)
    origin_x_m, origin_y_m, _ = settings.origin
    return FloorPlan(~free, settings.resolution, origin_x_m, origin_y_m, path.stem)
