"""The replies to a query of a lockstep run, which no clock of the machine ends.

A query that this process answers is answered before Zenoh's `get` returns, however long its handlers take. Zenoh counts
the time limit of a query on a thread of its own and would drop the reply of a handler that is slow, or of a process
that was stopped for a while: the run would depend on the machine. So Zenoh is given no limit worth the name. Only what
another process is to answer is waited for by the wall clock, and such a run cannot be repeated in any case.
"""

import threading
from typing import Any

import zenoh

NO_LIMIT_S = 1e9
"""Zenoh wants a number. It keeps some 650 bytes for each query until the session is closed."""


class LockstepReplies:
    """Collects the replies to one query; `handler` is what Zenoh's `get` is given."""

    def __init__(self) -> None:
        self.replies: list[zenoh.Reply] = []
        self.asker = threading.get_ident()
        self.from_outside = False
        """Whether another process has answered, or was waited for in vain."""
        self._is_over = threading.Event()

    def handler(self) -> "zenoh.handlers.Callback[Any]":
        """Takes the replies in, on the thread that brings them."""
        return zenoh.handlers.Callback(self._take, self._is_over.set, indirect=False)

    def wait(self, outside_s: float) -> bool:
        """Call after `get`: wait for other processes, if any were asked, for this long; False if they do not reply."""
        if self.replies or self._is_over.wait(outside_s):
            return True
        self.from_outside = True
        return False

    def _take(self, reply: zenoh.Reply) -> None:
        self.replies.append(reply)
        if threading.get_ident() != self.asker:
            self.from_outside = True
            self._is_over.set()
