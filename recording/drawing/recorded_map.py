"""The map of a recording: at any time of it, with copies kept at intervals, and as far as it is recorded.

Patches contain only changes, so the map at a time needs all patches before it. They are composed as in a run, so the
result is the map that a component of that run had.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import msgspec

from robrain.algorithms.slam.map_patch import merge_message, submap_message, whole_map
from robrain.algorithms.slam.submap_atlas import SubmapAtlas, SubmapKey
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.recording.drawing.drawn_map import ComposedMap

PATCHES_PER_COPY = 250
KEPT_MAX = 400
"""Copies that are kept; with more patches they stand farther apart."""

Place = tuple[int, int]
"""Chunk and message in it; places compare as they follow each other in the file."""
PatchSource = Callable[[Place, Place], Iterator[bytes]]
"""The payloads of the map's messages from one place to before another."""

PENDING_MAX = 256
"""Patches that wait to be merged."""


class _Kept(NamedTuple):
    place: Place
    geometry: GridGeometry
    submaps: list[MapPatch]


class RecordedMap:
    """Returns the composed map at any place of a recording.

    Args:
        patches: reads patches.
        total: their number.
    """

    def __init__(self, patches: PatchSource, total: int) -> None:
        self._patches = patches
        self._between = max(PATCHES_PER_COPY, total // KEPT_MAX)
        self._kept: list[_Kept] = []
        self._packed: dict[SubmapKey, tuple[int, MapPatch]] = {}
        """The last copy of each submap, and the version it is of: most submaps do not change from copy to copy."""
        self._map = ComposedMap()
        self._since_copy = 0

    def handle(self, payload: bytes, place: Place) -> None:
        """The next patch of the recording, which stands at `place`; a copy of the map is kept now and then."""
        if self._map.atlas is not None and self._since_copy >= self._between:
            self._keep(self._map.atlas, place)
            self._since_copy = 0
        self._map.handle(payload)
        self._since_copy += 1

    def atlas_at(self, place: Place) -> SubmapAtlas | None:
        """The map before `place`; None before the first patch."""
        kept = next((kept for kept in reversed(self._kept) if kept.place <= place), None)
        known = ComposedMap() if kept is None else ComposedMap(_restored(kept))
        start = (0, 0) if kept is None else kept.place
        for payload in self._patches(start, place):
            known.handle(payload)
        return known.atlas

    def _keep(self, atlas: SubmapAtlas, place: Place) -> None:
        """Keep a copy of the map as it is before `place`."""
        geometry = atlas.grid.geometry
        submaps = []
        for key, submap in sorted(atlas.submaps.items()):
            version, packed = self._packed.get(key, (-1, None))
            if packed is None or version != submap.version:
                packed = submap_message(key, submap, geometry)
            elif (packed.T_arena_local, packed.frame) != (submap.T_arena_local, submap.frame):
                packed = msgspec.structs.replace(packed, T_arena_local=submap.T_arena_local, frame=submap.frame)
            self._packed[key] = submap.version, packed
            submaps.append(packed)
        self._kept.append(_Kept(place, geometry, submaps))


def patches_of(robot: str, atlas: SubmapAtlas, now_ns: int) -> list[MapPatch]:
    """Messages with the whole map, for a receiver that starts here and is sent only later patches."""
    whole = whole_map(robot, atlas, sorted(atlas.submaps))
    return [] if whole is None else [msgspec.structs.replace(whole, stamp_ns=now_ns)]


def _restored(kept: _Kept) -> SubmapAtlas:
    atlas = SubmapAtlas(kept.geometry)
    for submap in kept.submaps:
        merge_message(atlas, submap)
    return atlas


class KnownMap:
    """Merges recorded patches on request, or when many wait. Patches that do not decode or fit are skipped."""

    def __init__(self) -> None:
        self._map = ComposedMap()
        self._pending: list[bytes] = []

    @property
    def has_news(self) -> bool:
        """Whether patches wait to be merged."""
        return bool(self._pending)

    def handle(self, payload: bytes) -> None:
        """The next patch, as it was on the wire."""
        self._pending.append(payload)
        if len(self._pending) >= PENDING_MAX:
            self.merged()

    def merged(self) -> ComposedMap:
        """The map with all patches so far."""
        for payload in self._pending:
            self._map.handle(payload)
        self._pending.clear()
        return self._map

    def patches(self, by: str, now_ns: int) -> list[MapPatch]:
        """Messages with the whole map for a receiver that has none, published by `by`."""
        atlas = self.merged().atlas
        return [] if atlas is None else patches_of(by, atlas, now_ns)
