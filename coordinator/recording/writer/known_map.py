"""The map that a recording has told so far, for the front of its next file."""

import msgspec

from robrain.coordinator.drawing.map_view import MapView
from robrain.coordinator.recording.reader.map_at import patches_of
from robrain.protocol.wire.messages.map_messages import MapPatch

PENDING_MAX = 256
"""Patches that wait to be merged."""


class KnownMap:
    """Merges the recorded patches when somebody asks, or when many wait. What does not decode or fit is left out."""

    def __init__(self) -> None:
        self._view = MapView()
        self._pending: list[bytes] = []
        self._decoder = msgspec.json.Decoder(MapPatch)

    @property
    def has_news(self) -> bool:
        """Whether patches wait to be merged."""
        return bool(self._pending)

    def take(self, payload: bytes) -> None:
        """The next patch, as it was on the wire."""
        self._pending.append(payload)
        if len(self._pending) >= PENDING_MAX:
            self.merged()

    def merged(self) -> MapView:
        """The map with all that was taken."""
        for payload in self._pending:
            try:
                self._view.merge(self._decoder.decode(payload))
            except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, ValueError):
                continue  # whoever listened left it out as well
        self._pending.clear()
        return self._view

    def patches(self, by: str, now_ns: int) -> list[MapPatch]:
        """Messages that tell the whole map to somebody who has heard of none, as said by `by`."""
        atlas = self.merged().atlas
        return [] if atlas is None else patches_of(by, atlas, now_ns)
