"""Map patches between a grid and the wire."""

import zlib
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.mapping.patch_cells import MAX_CELLS, cells_of, geometry_of, inflated
from robrain.algorithms.slam.submap import SURFACE, SURFACES_MAX, TILE_CELLS, Submap, SubmapStep
from robrain.algorithms.slam.submap_atlas import SubmapAtlas, SubmapKey
from robrain.protocol.clock import clock_difference_ns
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.map_frame import ARENA, MapFrame

MESSAGE_SHARE = 0.75
"""Share of an atlas that messages may fill; the rest is reserved for the robot's own cells."""
STEPS_MAX = 8
"""Number of different states of a submap for which the effect of one patch is kept."""


class _Kept:
    """Values computed from a patch."""

    def __init__(self, _patch: MapPatch) -> None:
        self.geometry: GridGeometry | None = None
        """The grid of the robots that have integrated the patch; None before the first of them."""
        self.steps: dict[int, SubmapStep] = {}
        """By the `id` of the evidence before, which each step keeps alive: some may have missed an earlier patch."""


def step_of(
    patch: MapPatch, atlas: SubmapAtlas, key: SubmapKey, cells: NDArray[np.int8], stamp_ms: int | NDArray[np.int32]
) -> SubmapStep:
    """Effect of a patch with these cells on a submap of an atlas, computed once for all holders of the same cells."""
    kept, submap = patch.derived(_Kept), atlas.shaped(key)
    step = kept.steps.get(id(submap.evidence))
    if step is None:
        step = _as_one_of(kept.steps.values(), submap.after(patch.row, patch.column, cells, stamp_ms))
        if len(kept.steps) < STEPS_MAX:
            kept.steps[id(submap.evidence)], kept.geometry = step, atlas.grid.geometry
    return step


def _as_one_of(steps: Iterable[SubmapStep], step: SubmapStep) -> SubmapStep:
    """The step; with the arrays of another one of the same patch if they are equal, so that the next is shared."""
    for other in steps:
        if (
            (other.row, other.column) == (step.row, step.column)
            and np.array_equal(other.evidence, step.evidence)
            and np.array_equal(other.stamp_ms, step.stamp_ms)
        ):
            return step._replace(evidence=other.evidence, stamp_ms=other.stamp_ms)
    return step


class SharedSteps:
    """Collects patches which others of the process have taken into the same cells, and has the atlas draw them at once.

    Args:
        atlas: that takes the patches.

    """

    def __init__(self, atlas: SubmapAtlas) -> None:
        self._atlas = atlas
        self._steps: list[tuple[SubmapKey, SubmapStep]] = []
        self._evidence: dict[SubmapKey, NDArray[np.int8]] = {}
        """Cells of the submaps after these steps."""
        self._more = 0
        """Bytes by which they grow."""

    def add(self, patch: MapPatch) -> bool:
        """Take a patch without parts as `merge_message` would, if its effect on its submap has been computed already.

        That is so for cells of a known submap that has not moved, newer than the cells there. Other patches need
        `flush`, then `merge_message`.
        """
        key, kept = (patch.robot, patch.submap), patch.derived(_Kept)
        submap, geometry = self._atlas.submaps.get(key), self._atlas.grid.geometry
        if submap is None or not kept.steps:
            return False
        step = kept.steps.get(id(self._evidence.get(key, submap.evidence)))
        if step is None:
            return False
        more = self._more + step.evidence.nbytes - step.before.nbytes
        if (
            not step.is_newest
            or (more and not self._atlas.has_room(more, MESSAGE_SHARE))
            or kept.geometry != geometry
            or patch.T_arena_local != submap.T_arena_local
            or patch.frame != submap.frame
            or patch.surfaces
        ):
            return False
        self._steps.append((key, step))
        self._evidence[key] = step.evidence
        self._more = more
        return True

    def flush(self) -> None:
        """Let the atlas draw the taken patches."""
        if self._steps:
            self._atlas.apply_steps(self._steps)
            self._steps = []
            self._evidence.clear()
            self._more = 0


NS_PER_MS = 1_000_000
STAMP_MODULUS_MS = 1 << 31
MESSAGE_CELLS_MAX = 1 << 27
"""Limit for the cells of all parts of a message: as many as an atlas holds."""
OUTSIDE_MAX = 2_000
"""Largest distance of a patch from the team's grid, in cells: 100 m at 0.05 m, more than any pose is wrong."""
AHEAD_MAX_MS = 5_000
"""Cells cannot be observed later than this after now. A patch from the future would override observations until then.
"""


def map_stamp_ms(stamp_ns: int) -> int:
    """A stamp as grids keep it: milliseconds in 31 bits.

    Stamps wrap every 24.8 days of the clock. Cells seen before a wrap are replaced only when they are seen again 24.8
    days later, so restart the team's maps then.
    """
    return stamp_ns // NS_PER_MS % STAMP_MODULUS_MS


def to_message(
    robot: str,
    geometry: GridGeometry,
    patch: PatchCells,
    submap: int = 0,
    T_arena_local: Pose2D = IDENTITY,
    frame: MapFrame = ARENA,
) -> MapPatch:
    """A patch of a robot's submap as it travels."""
    rows, columns = patch.cells.shape
    return msgspec.structs.replace(
        _blank(robot, geometry),
        row=patch.row,
        column=patch.column,
        rows=rows,
        columns=columns,
        observed_ms=patch.stamp_ms,
        cells=_deflated(patch.cells),
        submap=submap,
        T_arena_local=T_arena_local,
        frame=frame,
    )


def joined_message(robot: str, geometry: GridGeometry, parts: Iterable[MapPatch]) -> MapPatch:
    """One message of several patches."""
    return msgspec.structs.replace(_blank(robot, geometry), parts=tuple(parts))


def pose_message(
    robot: str,
    geometry: GridGeometry,
    submap: int,
    T_arena_local: Pose2D,
    frame: MapFrame = ARENA,
    *,
    withdrawn: bool = False,
    surfaces: NDArray[np.void] | None = None,
    variances: tuple[float, float] = (0.0, 0.0),
) -> MapPatch:
    """A message that moves, withdraws or finishes a submap; `surfaces` are those of a finished submap."""
    return msgspec.structs.replace(
        _blank(robot, geometry),
        submap=submap,
        T_arena_local=T_arena_local,
        frame=frame,
        withdrawn=withdrawn,
        surfaces=b"" if surfaces is None else _deflated(surfaces),
        variance_m2=float(variances[0]),
        variance_rad2=float(variances[1]),
    )


def submap_message(key: SubmapKey, submap: Submap, geometry: GridGeometry) -> MapPatch:
    """A message with a whole submap and the times of its tiles."""
    patch = PatchCells(submap.row, submap.column, submap.classes(), int(submap.stamp_ms.max(initial=0)))
    message = to_message(key[0], geometry, patch, key[1], submap.T_arena_local, submap.frame)
    surfaces = b"" if submap.surfaces is None else _deflated(submap.surfaces)
    return msgspec.structs.replace(message, tiles_ms=_deflated(submap.stamp_ms), surfaces=surfaces)


def whole_map(robot: str, atlas: SubmapAtlas, keys: Iterable[SubmapKey]) -> MapPatch | None:
    """One message with these submaps of an atlas; None if there are none."""
    geometry = atlas.grid.geometry
    parts = [submap_message(key, atlas.submaps[key], geometry) for key in keys]
    return joined_message(robot, geometry, parts) if parts else None


def is_near_grid(geometry: GridGeometry, row: int, column: int) -> bool:
    """Whether a cell is at most `OUTSIDE_MAX` cells outside the grid."""
    outside = max(-row, row - geometry.height, -column, column - geometry.width)
    return outside <= OUTSIDE_MAX


def in_own_time(message: MapPatch, now_ns: int) -> MapPatch:
    """A patch with the times of observation by the receiver's clock, which may differ from its sender's.

    Args:
        message: the patch.
        now_ns: by the receiver's clock.

    Raises:
        ValueError: it, or a part of it, claims to be observed more than `AHEAD_MAX_MS` from now.

    """
    ahead_ns = clock_difference_ns(message.stamp_ns, now_ns)
    if ahead_ns:
        message = _moved_in_time(message, -ahead_ns // NS_PER_MS)
    now_ms = map_stamp_ms(now_ns)
    for one in (message, *message.parts):
        ahead_ms = one.observed_ms - now_ms
        if AHEAD_MAX_MS < ahead_ms < STAMP_MODULUS_MS // 2:  # otherwise it was observed before the stamps wrapped
            raise ValueError(f"{message.robot}: its patch claims to be observed {ahead_ms / 1000:.1f} s from now")
    return message


def _moved_in_time(patch: MapPatch, by_ms: int) -> MapPatch:
    observed_ms = patch.observed_ms and (patch.observed_ms + by_ms) % STAMP_MODULUS_MS
    tiles_ms = b""
    if patch.tiles_ms:
        tiles_ms = _deflated(np.maximum(observed_ms - (patch.observed_ms - tiles_of(patch)), 0).astype(np.int32))
    parts = tuple(_moved_in_time(part, by_ms) for part in patch.parts)
    return msgspec.structs.replace(patch, observed_ms=observed_ms, tiles_ms=tiles_ms, parts=parts)


def merge_message(atlas: SubmapAtlas, message: MapPatch) -> int:
    """Merge a patch and its parts into an atlas of the same geometry.

    Parts of other robots' submaps are merged only if these submaps are new to the atlas.

    Returns:
        Least number of cells of the map that changed their class.

    Raises:
        ValueError: a patch is for another grid, its cells do not match its size, too many are occupied, or there is no
            room for it. That patch changes nothing; parts before it have been merged.

    """
    geometry = atlas.grid.geometry
    is_same_place = message.origin_x_m == geometry.origin_x_m and message.origin_y_m == geometry.origin_y_m
    is_same_size = message.width == geometry.width and message.height == geometry.height
    if not (is_same_place and is_same_size and message.resolution_m == geometry.resolution_m):
        raise ValueError(f"{message.robot} maps {geometry_of(message)}, expected {geometry}")
    if not message.parts:
        return _merge_one(atlas, message)
    cells = sum(part.rows * part.columns for part in message.parts)
    if cells > MESSAGE_CELLS_MAX:
        raise ValueError(f"{message.robot}: expected at most {MESSAGE_CELLS_MAX} cells in a message, got {cells}")
    changed = _merge_one(atlas, message) if message.withdrawn or message.cells else 0
    known = {key for part in message.parts if (key := (part.robot, part.submap)) in atlas.submaps}
    moves: dict[SubmapKey, tuple[Pose2D, MapFrame]] = {}
    atlas.hold()
    try:
        for part in message.parts:
            key = part.robot, part.submap
            if part.parts:
                raise ValueError(f"{message.robot}: a part of its patch has parts")
            if part.robot != message.robot and key in known:
                continue
            if part.withdrawn or part.surfaces or part.rows or part.columns or part.cells:
                moves.pop(key, None)
                changed += _merge_one(atlas, part)
            else:
                moves[key] = part.T_arena_local, part.frame
    finally:
        changed += atlas.draw_held()
        for frame in sorted({frame for _, frame in moves.values()}):
            atlas.move_all({key: place for key, (place, its) in moves.items() if its == frame}, frame)
    return changed


def _merge_one(atlas: SubmapAtlas, patch: MapPatch) -> int:
    key = (patch.robot, patch.submap)
    if patch.withdrawn:
        atlas.withdraw(key)
        return 0
    # A refused patch must change nothing, so all checks come first.
    statements = _statements_of(patch, atlas.grid.geometry) if patch.rows or patch.columns or patch.cells else None
    surfaces = _surfaces_of(patch) if patch.surfaces else None
    box = None if statements is None else (patch.row, patch.column, statements[0].shape, statements[1])
    atlas.check(key, box, surfaces, MESSAGE_SHARE)
    atlas.move(key, patch.T_arena_local, patch.frame)
    changed = 0 if statements is None else atlas.apply_step(key, step_of(patch, atlas, key, *statements))
    if surfaces is not None:
        atlas.set_surfaces(key, surfaces)
    return changed


def _blank(robot: str, geometry: GridGeometry) -> MapPatch:
    """A patch without cells or pose."""
    return MapPatch(
        robot=robot,
        resolution_m=geometry.resolution_m,
        origin_x_m=geometry.origin_x_m,
        origin_y_m=geometry.origin_y_m,
        width=geometry.width,
        height=geometry.height,
    )


def _deflated(array: NDArray[Any]) -> bytes:
    return zlib.compress(array.tobytes(), 1)


def _surfaces_of(patch: MapPatch) -> NDArray[np.void]:
    """Surfaces of a finished submap. Raises ValueError."""
    inflater = zlib.decompressobj()
    try:
        data = inflater.decompress(patch.surfaces, SURFACES_MAX * SURFACE.itemsize + 1)
    except zlib.error as error:
        raise ValueError(f"{patch.robot}: the surfaces of its submap do not inflate: {error}") from error
    if len(data) % SURFACE.itemsize or len(data) > SURFACES_MAX * SURFACE.itemsize:
        raise ValueError(f"{patch.robot}: expected at most {SURFACES_MAX} surfaces of {SURFACE.itemsize} bytes each")
    return np.frombuffer(data, SURFACE)


def tiles_of(patch: MapPatch) -> NDArray[np.int32]:
    """Time of observation of each tile of a patch of a whole submap. Raises ValueError."""
    if patch.rows * patch.columns > MAX_CELLS:
        raise ValueError(f"{patch.robot}: expected at most {MAX_CELLS} cells in a patch")
    rows, columns = -(-patch.rows // TILE_CELLS), -(-patch.columns // TILE_CELLS)
    return inflated(patch, patch.tiles_ms, np.dtype(np.int32), rows, columns)


def _statements_of(patch: MapPatch, team: GridGeometry) -> tuple[NDArray[np.int8], int | NDArray[np.int32]]:
    """Cells of a patch and their time of observation: one, or one for each tile. Raises ValueError."""
    if not is_near_grid(team, patch.row, patch.column):
        at = f"row {patch.row}, column {patch.column}"
        raise ValueError(
            f"{patch.robot}: expected a patch at most {OUTSIDE_MAX} cells outside the grid, got one at {at}"
        )
    cells = patch.derived(cells_of)
    if not patch.tiles_ms:
        return cells, patch.observed_ms
    stamps_ms = tiles_of(patch)
    if stamps_ms.min() < 0 or stamps_ms.max() > patch.observed_ms:
        raise ValueError(f"{patch.robot}: expected tile times from 0 to {patch.observed_ms} ms")
    return cells, stamps_ms
