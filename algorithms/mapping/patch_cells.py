"""Cells that a map patch carries, and their grid."""

import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.model.grid_geometry import GridGeometry

MAX_CELLS = 1 << 24
"""Limit for the cells of a patch."""
OCCUPIED_MAX = 4_000
"""Occupied cells allowed in a patch beyond its free cells (chosen: two circles of 30 m around a robot, in cells of
0.1 m). A whole map has more of them, but also more free cells, through which they were seen."""


def geometry_of(message: MapPatch) -> GridGeometry:
    """The grid that a patch belongs to (ValueError if its numbers are no grid)."""
    return GridGeometry(message.resolution_m, message.origin_x_m, message.origin_y_m, message.width, message.height)


def cells_of(message: MapPatch) -> NDArray[np.int8]:
    """The cells of a patch, int8 (rows, columns). Raises ValueError."""
    size = message.rows * message.columns
    if not 0 < size <= MAX_CELLS:
        raise ValueError(f"{message.robot}: expected 1 to {MAX_CELLS} cells in a patch, got {size}")
    box = inflated(message, message.cells, np.dtype(np.int8), message.rows, message.columns)
    occupied = 0 if size <= OCCUPIED_MAX else int(np.count_nonzero(box > 0))
    if occupied > OCCUPIED_MAX and occupied > OCCUPIED_MAX + (free := int(np.count_nonzero(box == 0))):
        raise ValueError(
            f"{message.robot}: expected at most {OCCUPIED_MAX} occupied cells in its patch beyond the free ones "
            f"that they were seen through, got {occupied} and {free} free ones"
        )
    return box


def inflated(message: MapPatch, packed: bytes, dtype: "np.dtype[Any]", rows: int, columns: int) -> NDArray[Any]:
    """An array (rows, columns) that a patch carries. Raises ValueError."""
    size = rows * columns * dtype.itemsize
    inflater = zlib.decompressobj()
    try:
        data = inflater.decompress(packed, size + 1)
    except zlib.error as error:
        raise ValueError(f"{message.robot}: the cells of its patch do not inflate: {error}") from error
    if len(data) != size:
        raise ValueError(f"{message.robot}: expected {size} bytes of cells in its patch, got {len(data)}")
    # Of a writable buffer, which kernels take as it is.
    return np.frombuffer(bytearray(data), dtype).reshape(rows, columns)
