"""Loads the code that merges maps, on a thread: it takes half a second, and the page is to be seen before."""

import contextlib
import sys
import threading
from collections import deque
from collections.abc import Iterable

from robrain.coordinator.drawing.map_view import MapView
from robrain.protocol.wire.border.border import Received
from robrain.protocol.wire.messages.maps.map_messages import MapPatch
from robrain.protocol.wire.topics import ROBOT_MAP

MERGER = "robrain.protocol.wire.messages.maps.map_patch"
HELD_PATCHES = 8192
JOIN_S = 3.0


class MapLoading:
    """Holds map patches back while the kernels that merge them are loaded, which begins with the first patch."""

    def __init__(self) -> None:
        self.dropped = 0
        """Patches that were too many to be held."""
        self._held: deque[Received] = deque(maxlen=HELD_PATCHES)
        self._is_over = MERGER in sys.modules
        self._thread: threading.Thread | None = None

    def let_through(self, received: Iterable[Received]) -> Iterable[Received]:
        """The messages that can be processed now: no patches while it loads, then first those that were held."""
        if self._is_over:
            return received
        if self._thread is not None and not self._thread.is_alive():
            self._is_over = True
            held, self._held = self._held, deque()
            return [*held, *received]
        return [one for one in received if not self._hold(one)]

    def forget(self) -> None:
        """Drop the held patches: their run is over."""
        self._held.clear()

    def close(self) -> None:
        """Wait for the thread: native code that it runs must not be cut off when the interpreter ends."""
        if self._thread is not None:
            self._thread.join(JOIN_S)

    def _hold(self, received: Received) -> bool:
        if received.topic is not ROBOT_MAP:
            return False
        if self._thread is None:
            self._thread = threading.Thread(target=load, args=(received.message,), name="loading", daemon=True)
            self._thread.start()
        self.dropped += len(self._held) == HELD_PATCHES
        self._held.append(received)
        return True


def load(patch: MapPatch) -> None:
    """Load what merges a patch."""
    with contextlib.suppress(ValueError):  # the view that it is meant for refuses it as well, and says so
        MapView().merge(patch)
