"""Replies to queries of a lockstep run, without time limits for queries that this process answers itself.

Zenoh's `get` returns after the handlers of this process have answered, however long they take. But Zenoh applies the
time limit of a query by the wall clock, on a separate thread. It would drop the reply of a slow handler, or after a
pause of the process, and the run would depend on the machine. Zenoh therefore gets a limit that never ends a query. A
limit by the wall clock applies only to replies from other processes, with which a run is not repeatable anyway.
"""

import threading
from typing import Any

import zenoh

NO_LIMIT_S = 1e9
"""Zenoh requires a number. It keeps about 650 bytes per query until the session is closed."""


def is_from_outside(reply: zenoh.Reply, own: zenoh.ZenohId) -> bool:
    """Whether another process sent a reply; `own` is the id of this process's session.

    The thread does not show it: the last to answer delivers all replies, and that may be the asker itself.
    """
    return reply.replier_id is None or reply.replier_id.zid != own


class LockstepReplies:
    """Collects the replies to one query; pass `handler()` to Zenoh's `get`.

    Args:
        own: id of the session that asks.

    """

    def __init__(self, own: zenoh.ZenohId) -> None:
        self.replies: list[zenoh.Reply] = []
        self._own = own
        self.from_outside = False
        """Whether another process has answered, or failed to in time."""
        self._is_over = threading.Event()

    def handler(self) -> "zenoh.handlers.Callback[Any]":
        """A callback that stores replies, on any thread that delivers them."""
        return zenoh.handlers.Callback(self._handle, self._is_over.set, indirect=False)

    def wait(self, outside_s: float) -> bool:
        """Call after `get`: wait at most this long for other processes, if any were asked; False if none replies."""
        if self.replies or self._is_over.wait(outside_s):
            return True
        self.from_outside = True
        return False

    def _handle(self, reply: zenoh.Reply) -> None:
        if is_from_outside(reply, self._own):
            self.from_outside = True
        self.replies.append(reply)
        self._is_over.set()
