"""The team's map as it is drawn: patches merged, and made into pictures and walls.

The kernels that merge patches are loaded with the first patch: a page must be seen before.
"""

from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.mapping.patch_cells import MAX_CELLS, geometry_of
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.model.grid_geometry import OCCUPIED, GridGeometry

if TYPE_CHECKING:  # loads kernels
    from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
    from robrain.algorithms.slam.submap_atlas import SubmapAtlas


class DrawnFloor(NamedTuple):
    """Cells and the grid that they belong to."""

    geometry: GridGeometry
    classes: NDArray[np.int8]
    """(height, width), row 0 at the lowest y: −1 unknown, 0 free, 100 occupied."""

    def picture(
        self, unknown: tuple[int, int, int], free: tuple[int, int, int], occupied: tuple[int, int, int]
    ) -> NDArray[np.uint8]:
        """RGB image uint8 (height, width, 3), a pixel a cell, row 0 at the lowest y."""
        # As unsigned bytes the classes are 255, 0 and 100.
        colors = np.empty((256, 3), np.uint8)
        colors[:] = unknown
        colors[0], colors[int(OCCUPIED)] = free, occupied
        picture: NDArray[np.uint8] = colors[self.classes.view(np.uint8)]
        return picture

    def wall_boxes(self) -> NDArray[np.float32]:
        """Rectangles that cover the occupied cells: float32 (N, 4), middle x, y and sizes, metres, arena frame."""
        geometry = self.geometry
        row, column, rows, columns = cover_with_boxes(self.classes == OCCUPIED).T
        in_cells = np.column_stack([column + columns / 2, row + rows / 2, columns, rows])
        in_metres = in_cells * geometry.resolution_m + (geometry.origin_x_m, geometry.origin_y_m, 0.0, 0.0)
        return in_metres.astype(np.float32)


def cover_with_boxes(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Boxes that cover exactly the true cells of `mask`: int64 (N, 4) of row, column, rows, columns.

    Runs of a row are joined with equal runs of the rows before; few boxes for straight walls, not the fewest.
    """
    edges = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    starts, ends = np.argwhere(edges == 1), np.argwhere(edges == -1)
    boxes: list[list[int]] = []
    open_boxes: dict[tuple[int, int], int] = {}
    for (row, start), (_, end) in zip(starts.tolist(), ends.tolist(), strict=True):
        above = open_boxes.get((start, end))
        if above is not None and boxes[above][0] + boxes[above][2] == row:
            boxes[above][2] += 1
        else:
            open_boxes[start, end] = len(boxes)
            boxes.append([row, start, 1, end - start])
    return np.array(boxes, np.int64).reshape(-1, 4)


FAR_M = 1e6
"""Places farther out than this are refused, because they cannot be drawn."""
_DECODER = msgspec.json.Decoder(MapPatch)


class ComposedMap:
    """Composes the submaps of all robots to one grid; the geometry is that of the first patch."""

    def __init__(self, atlas: "SubmapAtlas | None" = None) -> None:
        self.atlas = atlas
        """None before the first patch."""

    @property
    def grid(self) -> "OccupancyGrid | None":
        """The composed map; None before the first patch. Read-only."""
        return None if self.atlas is None else self.atlas.grid

    @property
    def floor(self) -> DrawnFloor | None:
        """The composed map, to be drawn; None before the first patch."""
        return None if self.grid is None else DrawnFloor(self.grid.geometry, self.grid.classes())

    @property
    def version(self) -> int:
        """Grows with every change that can be seen; 0 before the first patch."""
        return 0 if self.grid is None else 1 + self.grid.version

    @property
    def known_area_m2(self) -> float:
        """Area of the known cells, walls included."""
        return 0.0 if self.grid is None else self.grid.known_count * self.grid.geometry.resolution_m**2

    @property
    def size_m(self) -> float:
        """The longer side of the grid; 0 before the first patch."""
        return 0.0 if self.grid is None else max(self.grid.geometry.shape) * self.grid.geometry.resolution_m

    def merge(self, patch: MapPatch) -> None:
        """Merge a patch; later statements replace earlier ones.

        Raises:
            ValueError: the patch does not fit its own description or the grid of the patches before. Also: its grid is
                so large that it would fill the memory.
        """
        from robrain.algorithms.slam.map_patch import merge_message
        from robrain.algorithms.slam.submap_atlas import SubmapAtlas

        atlas = self.atlas
        if atlas is None:
            atlas = SubmapAtlas(checked_geometry(patch))
        merge_message(atlas, patch)
        self.atlas = atlas

    def handle(self, payload: bytes) -> None:
        """Merge a patch as it was on the wire; a patch that does not decode or fit is skipped, as by its receivers."""
        try:
            self.merge(_DECODER.decode(payload))
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, ValueError):
            return

    def known_bounds_m(self) -> tuple[float, float, float, float] | None:
        """x_min, y_min, x_max, y_max of the known area, metres, arena frame; None before the first patch."""
        if self.grid is None:
            return None
        known = self.grid.known()
        rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
        if rows.size == 0:
            return None
        geometry = self.grid.geometry
        return (
            geometry.origin_x_m + float(columns[0]) * geometry.resolution_m,
            geometry.origin_y_m + float(rows[0]) * geometry.resolution_m,
            geometry.origin_x_m + float(columns[-1] + 1) * geometry.resolution_m,
            geometry.origin_y_m + float(rows[-1] + 1) * geometry.resolution_m,
        )


def checked_geometry(patch: MapPatch) -> GridGeometry:
    """The grid of a patch (ValueError if it is no grid, or so large that it would fill the memory)."""
    geometry = geometry_of(patch)
    if geometry.width * geometry.height > MAX_CELLS:
        raise ValueError(f"expected at most {MAX_CELLS} cells, got {geometry.width} x {geometry.height}")
    size_m = max(geometry.shape) * geometry.resolution_m
    if max(abs(geometry.origin_x_m), abs(geometry.origin_y_m), size_m) > FAR_M:
        raise ValueError(f"expected a grid within {FAR_M:g} m, got {geometry}")
    return geometry
