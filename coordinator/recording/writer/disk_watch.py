"""Notices a disk that hangs while it hangs: the thread that writes cannot say so itself."""

import threading
import time
from collections.abc import Callable


class DiskWatch:
    """Calls `tell` with the seconds that a step has lasted, once each `period_s` while it lasts longer than that.

    Args:
        tell: called on the watch's own thread.
        period_s: how long a step may last before it is told.
    """

    def __init__(self, tell: Callable[[float], None], period_s: float) -> None:
        self._tell = tell
        self._period_s = period_s
        self._began_s: float | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="disk-watch", daemon=True)
        self._thread.start()

    def begin(self) -> None:
        """A step begins."""
        self._began_s = time.monotonic()

    def end(self) -> None:
        """The step is over."""
        self._began_s = None

    def close(self) -> None:
        """Stop watching; calling it again does nothing."""
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._ended.wait(self._period_s):
            began_s = self._began_s
            lasted_s = 0.0 if began_s is None else time.monotonic() - began_s
            if lasted_s > self._period_s:
                self._tell(lasted_s)
