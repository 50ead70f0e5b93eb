"""Turns: one at a time in a plugin, and no caller waits for ever for one that hangs."""

import sys
import threading
from traceback import walk_stack
from types import TracebackType

from robrain.agent.errors import PluginHung
from robrain.protocol.clock import Clock, to_ns

COMPILER = "numba.core.dispatcher"


class PluginLock:
    """The lock of one plugin; may be taken again by the thread that has it.

    Locks are only acquired downwards: a caller that waits here is of a higher level, or comes from outside.

    Args:
        plugin: plugin of the lock.
        limit_s: how long a step or call may take; also how long one waits for a turn.
        clock: returns how long the plugin has been in its turn.

    """

    def __init__(self, plugin: str, limit_s: float, clock: Clock) -> None:
        self._plugin = plugin
        self.limit_s = limit_s
        self._limit_ns = to_ns(limit_s)
        self._now_ns = clock.now_ns
        self._lock = threading.RLock()
        self.depth = 0
        """How often the thread that is in the plugin has entered the turn; 0 if there is none."""
        self.caller = ""
        """The plugin that calls this one at present; empty if none does."""
        self._since_ns: int
        self._owner: int

    def set_limit(self, limit_s: float) -> None:
        """Another limit holds from now on: the manifest was edited."""
        self.limit_s = limit_s
        self._limit_ns = to_ns(limit_s)

    @property
    def owner(self) -> int | None:
        """The thread that is in the plugin, or None."""
        return self._owner if self.depth > 0 else None

    def acquire(self, timeout_s: float) -> bool:
        """Take the turn; False if it was not to be had in time."""
        if not self._lock.acquire(timeout=timeout_s):
            return False
        if self.depth == 0:
            self._since_ns = self._now_ns()
            self._owner = threading.get_ident()
        self.depth += 1
        return True

    def release(self) -> None:
        """Give the turn back."""
        self.depth -= 1
        self._lock.release()

    def is_overdue(self, now_ns: int) -> bool:
        """Whether a thread has been in the plugin for longer than the limit."""
        return self.depth > 0 and now_ns - self._since_ns > self._limit_ns

    @property
    def compiles(self) -> bool:
        """Whether the thread in the plugin compiles a kernel or waits for one: that may take minutes, but it ends."""
        frame = sys._current_frames().get(self._owner) if self.depth else None
        return frame is not None and any(one.f_globals.get("__name__") == COMPILER for one, _ in walk_stack(frame))

    def __enter__(self) -> None:
        # As `acquire`, written out: every call of a plugin by another passes here.
        if not self._lock.acquire(timeout=self.limit_s):
            raise PluginHung(self._plugin, f"{self._plugin} has not come back for {self.limit_s:g} s")
        if self.depth == 0:
            self._since_ns = self._now_ns()
            self._owner = threading.get_ident()
        self.depth += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.depth -= 1
        self._lock.release()


class LockstepTurn(PluginLock):
    """The turn of a plugin in a lockstep run, whose one thread needs no lock: only the depth is counted."""

    @property
    def owner(self) -> int | None:
        """The thread, while it is in the plugin, or None."""
        return threading.get_ident() if self.depth > 0 else None

    def acquire(self, timeout_s: float) -> bool:
        """Take the turn; always True."""
        self.depth += 1
        return True

    def release(self) -> None:
        """Give the turn back."""
        self.depth -= 1

    def is_overdue(self, now_ns: int) -> bool:
        """False: time does not advance while a thread is in a plugin."""
        return False

    def __enter__(self) -> None:
        self.depth += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.depth -= 1
