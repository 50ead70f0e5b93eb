"""A floor as it is drawn: cells made into pictures and walls."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.grid_geometry import OCCUPIED, GridGeometry


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
