"""The map as it was at any time of a recording: patches merged, with a copy kept every so often.

Patches say what changed, so the map at a time is made of all before it. Merging is the same as the team's, so what
is told here is what a listener of the run knew.
"""

import zlib
from collections.abc import Callable, Iterator
from typing import NamedTuple

import msgspec
import numpy as np

from robrain.protocol.model.occupancy_grid import UNKNOWN, GridGeometry, OccupancyGrid, PatchCells
from robrain.protocol.wire.map_patch import MAX_CELLS, geometry_of, map_stamp_ms, merge_message, to_message
from robrain.protocol.wire.messages import MapPatch

PATCHES_BETWEEN = 250
KEPT_MAX = 400
"""Copies that are kept; with more patches they stand farther apart."""
RECENT_MS = 2000
"""A patch may come this much later than another that was seen after it."""

Place = tuple[int, int]
"""Chunk and message in it; places compare as they follow each other in the file."""
PatchSource = Callable[[Place, Place], Iterator[bytes]]
"""The payloads of the map's messages from one place to before another."""


class _Kept(NamedTuple):
    place: Place
    geometry: GridGeometry
    classes: bytes
    stamps_ms: bytes


class MapAt:
    """Tells the merged map at any place of a recording.

    Args:
        patches: reads patches.
        total: how many there are.
    """

    def __init__(self, patches: PatchSource, total: int) -> None:
        self._patches = patches
        self._between = max(PATCHES_BETWEEN, total // KEPT_MAX)
        self._kept: list[_Kept] = []
        self._decoder = msgspec.json.Decoder(MapPatch)

    def keep(self, grid: OccupancyGrid, place: Place) -> None:
        """Keep a copy of the map as it is before `place`."""
        classes, stamps = zlib.compress(grid.classes().tobytes(), 1), zlib.compress(grid.stamp_ms.tobytes(), 1)
        self._kept.append(_Kept(place, grid.geometry, classes, stamps))

    def builder(self) -> "MapBuilder":
        """Takes all patches once, in order, and keeps copies for later."""
        return MapBuilder(self, self._between, self._decoder)

    def grid_at(self, place: Place) -> OccupancyGrid | None:
        """The map before `place`; None before the first patch."""
        kept = next((kept for kept in reversed(self._kept) if kept.place <= place), None)
        grid = None if kept is None else _restored(kept)
        start = (0, 0) if kept is None else kept.place
        for payload in self._patches(start, place):
            grid = merged(grid, payload, self._decoder)
        return grid


class MapBuilder:
    """Merges patches one after the other and has a copy kept now and then."""

    def __init__(self, store: MapAt, between: int, decoder: "msgspec.json.Decoder[MapPatch]") -> None:
        self._store = store
        self._between = between
        self._decoder = decoder
        self._grid: OccupancyGrid | None = None
        self._since = 0

    def take(self, payload: bytes, place: Place) -> None:
        """The next patch, which stands at `place`."""
        if self._grid is not None and self._since >= self._between:
            self._store.keep(self._grid, place)
            self._since = 0
        self._grid = merged(self._grid, payload, self._decoder)
        self._since += 1


def merged(
    grid: OccupancyGrid | None, payload: bytes, decoder: "msgspec.json.Decoder[MapPatch]"
) -> OccupancyGrid | None:
    """The map with one more patch; one that does not decode or fit is left out, as its listeners did."""
    try:
        patch = decoder.decode(payload)
        if grid is None:
            geometry = geometry_of(patch)
            if geometry.width * geometry.height > MAX_CELLS:
                return None
            fresh = OccupancyGrid(geometry)
            merge_message(fresh, patch)
            return fresh
        merge_message(grid, patch)
    except (msgspec.DecodeError, UnicodeDecodeError, ValueError, RecursionError):
        return grid
    return grid


def patches_of(robot: str, grid: OccupancyGrid, now_ns: int) -> list[MapPatch]:
    """Messages that tell a map to somebody who knows nothing of it, so that what comes later merges rightly.

    What is old goes into one patch; what was seen in the last two seconds keeps its own times, because a patch that
    comes late must neither replace what is newer nor be replaced by what is older.
    """
    recent_ms = map_stamp_ms(now_ns) - RECENT_MS
    known = grid.known()
    old = known & (grid.stamp_ms <= recent_ms)
    masks = [old] if old.any() else []
    masks += [known & (grid.stamp_ms == stamp) for stamp in np.unique(grid.stamp_ms[known & ~old])]
    classes = grid.classes()
    patches = []
    for mask in masks:
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        cells = np.where(mask[box], classes[box], np.int8(UNKNOWN))
        stamp_ms = int(grid.stamp_ms[box][mask[box]].max())
        patch = to_message(robot, grid.geometry, PatchCells(int(rows[0]), int(columns[0]), cells, stamp_ms))
        patches.append(msgspec.structs.replace(patch, stamp_ns=now_ns))
    return patches


def _restored(kept: _Kept) -> OccupancyGrid:
    grid = OccupancyGrid(kept.geometry)
    shape = kept.geometry.shape
    classes = np.frombuffer(zlib.decompress(kept.classes), np.int8).reshape(shape)
    stamps = np.frombuffer(zlib.decompress(kept.stamps_ms), np.int32).reshape(shape)
    # Merged as of time 0 they are known, and then take the times at which they were seen.
    grid.merge_patch(0, 0, classes, 0)
    grid.stamp_ms[:] = stamps
    return grid
