"""Map patches between a grid and the wire."""

import zlib
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.submap import IDENTITY, SURFACE, SURFACES_MAX, TILE_CELLS, Submap
from robrain.protocol.model.mapping.submap_atlas import SubmapAtlas, SubmapKey
from robrain.protocol.model.occupancy_grid import GridGeometry, PatchCells
from robrain.protocol.wire.map_messages import MapPatch

NS_PER_MS = 1_000_000
STAMP_MODULUS_MS = 1 << 31
MAX_CELLS = 1 << 24
OUTSIDE_MAX = 2_000
"""Cells by which a patch may lie outside the team's grid, as those of a robot that is off (chosen)."""
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


def to_message(
    robot: str, geometry: GridGeometry, patch: PatchCells, submap: int = 0, T_arena_local: Pose2D = IDENTITY
) -> MapPatch:
    """A patch of a robot's submap as it travels."""
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
        submap=submap,
        T_arena_local=T_arena_local,
    )


def joined_message(robot: str, geometry: GridGeometry, moved: Iterable[MapPatch]) -> MapPatch:
    """One message of several patches."""
    return MapPatch(
        robot=robot,
        resolution_m=geometry.resolution_m,
        origin_x_m=geometry.origin_x_m,
        origin_y_m=geometry.origin_y_m,
        width=geometry.width,
        height=geometry.height,
        parts=tuple(moved),
    )


def pose_message(
    robot: str,
    geometry: GridGeometry,
    submap: int,
    T_arena_local: Pose2D,
    *,
    withdrawn: bool = False,
    surfaces: NDArray[np.void] | None = None,
    variances: tuple[float, float] = (0.0, 0.0),
) -> MapPatch:
    """Says where a submap lies, or that it is wrong, or that it is finished and where in their cells its walls are."""
    return MapPatch(
        robot=robot,
        resolution_m=geometry.resolution_m,
        origin_x_m=geometry.origin_x_m,
        origin_y_m=geometry.origin_y_m,
        width=geometry.width,
        height=geometry.height,
        submap=submap,
        T_arena_local=T_arena_local,
        withdrawn=withdrawn,
        surfaces=b"" if surfaces is None else zlib.compress(surfaces.tobytes(), 1),
        variance_m2=float(variances[0]),
        variance_rad2=float(variances[1]),
    )


def submap_message(key: SubmapKey, submap: Submap, geometry: GridGeometry) -> MapPatch:
    """A whole submap, with the times of its tiles."""
    patch = PatchCells(submap.row, submap.column, submap.classes(), int(submap.stamp_ms.max(initial=0)))
    message = to_message(key[0], geometry, patch, key[1], submap.T_arena_local)
    surfaces = b"" if submap.surfaces is None else zlib.compress(submap.surfaces.tobytes(), 1)
    return msgspec.structs.replace(message, tiles_ms=zlib.compress(submap.stamp_ms.tobytes(), 1), surfaces=surfaces)


def whole_map(robot: str, atlas: SubmapAtlas, keys: Iterable[SubmapKey]) -> MapPatch | None:
    """Some submaps of an atlas in one message; None if there are none."""
    geometry = atlas.grid.geometry
    parts = [submap_message(key, atlas.submaps[key], geometry) for key in keys]
    return joined_message(robot, geometry, parts) if parts else None


def geometry_of(message: MapPatch) -> GridGeometry:
    """The grid that a patch belongs to (ValueError if its numbers are no grid)."""
    return GridGeometry(message.resolution_m, message.origin_x_m, message.origin_y_m, message.width, message.height)


def check_claim(message: MapPatch, now_ns: int) -> None:
    """Check that a patch is not from the future.

    Args:
        message: the patch.
        now_ns: by the receiver's clock.

    Raises:
        ValueError: it, or a part of it, is more than `AHEAD_MAX_MS` ahead. Just after the stamps wrap, so are patches
            from before.

    """
    latest_ms = max((part.observed_ms for part in message.parts), default=0)
    ahead_ms = max(message.observed_ms, latest_ms) - map_stamp_ms(now_ns)
    if ahead_ms > AHEAD_MAX_MS:
        raise ValueError(
            f"{message.robot}: its patch is from the future, {ahead_ms / 1000:.1f} s ahead, "
            "or the clocks of its machine and of this one differ"
        )


def take_message(atlas: SubmapAtlas, message: MapPatch) -> int:
    """Take a patch, and its parts, into an atlas of the same geometry.

    Parts about other robots' submaps are hearsay: they are taken where the atlas knows nothing of those submaps.

    Returns:
        How many cells of the map changed their class, at least.

    Raises:
        ValueError: a patch is for another grid, its cells do not match its size, or too many are occupied. What came
            before it is taken.

    """
    geometry = geometry_of(message)
    if geometry != atlas.grid.geometry:
        raise ValueError(f"{message.robot} maps {geometry}, expected {atlas.grid.geometry}")
    changed = _take_one(atlas, message) if message.withdrawn or message.cells or not message.parts else 0
    known = {key for part in message.parts if (key := (part.robot, part.submap)) in atlas.submaps}
    for part in message.parts:
        if part.parts:
            raise ValueError(f"{message.robot}: a part of its patch has parts")
        if part.robot == message.robot or (part.robot, part.submap) not in known:
            changed += _take_one(atlas, part)
    return changed


def _take_one(atlas: SubmapAtlas, patch: MapPatch) -> int:
    key = (patch.robot, patch.submap)
    if patch.withdrawn:
        atlas.withdraw(key)
        return 0
    atlas.move(key, patch.T_arena_local)
    changed = _take_cells(atlas, key, patch) if patch.rows or patch.columns or patch.cells else 0
    if patch.surfaces:
        atlas.take_surfaces(key, _surfaces_of(patch))
    return changed


def _surfaces_of(patch: MapPatch) -> NDArray[np.void]:
    """The walls' places of a finished submap. Raises ValueError."""
    inflater = zlib.decompressobj()
    try:
        data = inflater.decompress(patch.surfaces, SURFACES_MAX * SURFACE.itemsize + 1)
    except zlib.error as error:
        raise ValueError(f"{patch.robot}: the surfaces of its submap do not inflate: {error}") from error
    if len(data) % SURFACE.itemsize or len(data) > SURFACES_MAX * SURFACE.itemsize:
        raise ValueError(f"{patch.robot}: expected at most {SURFACES_MAX} surfaces of {SURFACE.itemsize} bytes each")
    return np.frombuffer(data, SURFACE)


def _take_cells(atlas: SubmapAtlas, key: SubmapKey, patch: MapPatch) -> int:
    height, width = atlas.grid.geometry.shape
    if max(-patch.row, patch.row - height, -patch.column, patch.column - width) > OUTSIDE_MAX:
        at = f"row {patch.row}, column {patch.column}"
        raise ValueError(
            f"{patch.robot}: expected a patch at most {OUTSIDE_MAX} cells outside the grid, got one at {at}"
        )
    cells = _cells_of(patch)
    if not patch.tiles_ms:
        return atlas.take(key, patch.row, patch.column, cells, patch.observed_ms)
    rows, columns = -(-patch.rows // TILE_CELLS), -(-patch.columns // TILE_CELLS)
    stamps_ms = _inflated(patch, patch.tiles_ms, np.dtype(np.int32), rows, columns)
    if stamps_ms.min() < 0 or stamps_ms.max() > patch.observed_ms:
        raise ValueError(f"{patch.robot}: expected times of tiles from 0 to {patch.observed_ms} ms")
    return atlas.take(key, patch.row, patch.column, cells, stamps_ms)


def _cells_of(message: MapPatch) -> NDArray[np.int8]:
    """The cells of a patch, int8 (rows, columns). Raises ValueError."""
    size = message.rows * message.columns
    if not 0 < size <= MAX_CELLS:
        raise ValueError(f"{message.robot}: expected 1 to {MAX_CELLS} cells in a patch, got {size}")
    box = _inflated(message, message.cells, np.dtype(np.int8), message.rows, message.columns)
    occupied = int(np.count_nonzero(box > 0))
    if occupied > OCCUPIED_MAX and occupied > OCCUPIED_MAX + (free := int(np.count_nonzero(box == 0))):
        raise ValueError(
            f"{message.robot}: expected at most {OCCUPIED_MAX} occupied cells in its patch beyond the free ones "
            f"that they were seen through, got {occupied} and {free} free ones"
        )
    return box


def _inflated(message: MapPatch, packed: bytes, dtype: "np.dtype[Any]", rows: int, columns: int) -> NDArray[Any]:
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
