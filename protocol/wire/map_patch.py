"""Map patches between a grid and the wire."""

import zlib

import numpy as np

from robrain.protocol.model.occupancy_grid import GridGeometry, OccupancyGrid, PatchCells
from robrain.protocol.wire.messages import MapPatch

NS_PER_MS = 1_000_000
STAMP_MODULUS_MS = 1 << 31
MAX_CELLS = 1 << 24
AHEAD_MAX_MS = 5_000
"""Largest difference between clocks of a team (chosen). A patch from later would override what is seen until then."""
OCCUPIED_MAX = 4_000
"""Occupied cells allowed in a patch beyond its free cells (chosen: two circles of 30 m around a robot, in cells of
0.1 m). A whole map has more of them, but also more free cells, through which they were seen."""


def map_stamp_ms(stamp_ns: int) -> int:
    """A stamp as grids keep it: milliseconds in 31 bits.

    They wrap every 24.8 days of the clock; cells seen before such a moment are replaced only by being seen again
    24.8 days later, so restart the team's maps then.
    """
    return stamp_ns // NS_PER_MS % STAMP_MODULUS_MS


def to_message(robot: str, geometry: GridGeometry, patch: PatchCells) -> MapPatch:
    """A patch as it travels."""
    rows, columns = patch.cells.shape
    return MapPatch(
        robot=robot,
        resolution_m=geometry.resolution_m,
        origin_x_m=geometry.origin_x_m,
        origin_y_m=geometry.origin_y_m,
        width=geometry.width,
        height=geometry.height,
        row=patch.row,
        column=patch.column,
        rows=rows,
        columns=columns,
        observed_ms=patch.stamp_ms,
        cells=zlib.compress(patch.cells.tobytes(), 1),
    )


def geometry_of(message: MapPatch) -> GridGeometry:
    """The grid that a patch belongs to (ValueError if its numbers are no grid)."""
    return GridGeometry(message.resolution_m, message.origin_x_m, message.origin_y_m, message.width, message.height)


def check_claim(message: MapPatch, now_ns: int) -> None:
    """Check that a patch is not from the future.

    Args:
        message: the patch.
        now_ns: by the receiver's clock.

    Raises:
        ValueError: it is more than `AHEAD_MAX_MS` ahead. Just after the stamps wrap, so are patches from before.

    """
    ahead_ms = message.observed_ms - map_stamp_ms(now_ns)
    if ahead_ms > AHEAD_MAX_MS:
        raise ValueError(
            f"{message.robot}: its patch is from the future, {ahead_ms / 1000:.1f} s ahead, "
            "or the clocks of its machine and of this one differ"
        )


def merge_message(grid: OccupancyGrid, message: MapPatch) -> int:
    """Merge a patch into a grid of the same geometry.

    Returns:
        How many cells changed their class.

    Raises:
        ValueError: the patch is for another grid, its cells do not match its size, or too many are occupied.

    """
    if geometry_of(message) != grid.geometry:
        raise ValueError(f"{message.robot} maps {geometry_of(message)}, expected {grid.geometry}")
    size = message.rows * message.columns
    if not 0 < size <= MAX_CELLS:
        raise ValueError(f"{message.robot}: expected 1 to {MAX_CELLS} cells in a patch, got {size}")
    inflater = zlib.decompressobj()
    try:
        cells = inflater.decompress(message.cells, size + 1)
    except zlib.error as error:
        raise ValueError(f"{message.robot}: the cells of its patch do not inflate: {error}") from error
    if len(cells) != size:
        raise ValueError(f"{message.robot}: expected {size} cells in its patch, got {len(cells)}")
    box = np.frombuffer(cells, dtype=np.int8).reshape(message.rows, message.columns)
    occupied, free = int(np.count_nonzero(box > 0)), int(np.count_nonzero(box == 0))
    if occupied > OCCUPIED_MAX + free:
        raise ValueError(
            f"{message.robot}: expected at most {OCCUPIED_MAX} occupied cells in its patch beyond the free ones "
            f"that they were seen through, got {occupied} and {free} free ones"
        )
    return grid.merge_patch(message.row, message.column, box, message.observed_ms)
