"""The process of an isolated plugin, as the robot's process holds it.

Three connections, each with a conversation of its own: the robot's calls, its emergency halts (which must get through
while a call is under way), and what the plugin's own threads have to say. The other end of a pipe is held open: when
this process ends, however it ends, the kernel ends the plugin's.
"""

import logging
import os
import socket
import sys
import threading
import weakref
from collections.abc import Callable

from robrain.agent.isolation.peer import Peer, Serve
from robrain.agent.isolation.process_group import ProcessGroup, how_it_ended

logger = logging.getLogger(__name__)

END_TIMEOUT_S = 1.0
"""A process that was told to end is killed after this."""
STDERR = 2

OnLost = Callable[[str], None]


class ChildProcess:
    """Starts the process of one plugin.

    Args:
        plugin: its name.
        serve: does what the plugin asks for.
        on_lost: told why, on a thread of its own, when the process ends of itself; not kept alive for that.

    Raises:
        OSError: the process cannot be started.

    """

    def __init__(self, plugin: str, serve: Serve, on_lost: "weakref.WeakMethod[OnLost]") -> None:
        self._plugin = plugin
        self._on_lost = on_lost
        self._is_ending = False
        pairs = [socket.socketpair() for _ in range(3)]
        lifeline, self._lifeline = os.pipe()
        theirs = [connection.fileno() for _, connection in pairs] + [lifeline]
        try:
            command = [sys.executable, "-m", "robrain.agent.isolation.child", plugin, *map(str, theirs)]
            self._group = ProcessGroup(command, stdout=STDERR, keep=theirs)
        except BaseException:
            os.close(self._lifeline)
            for connection, _ in pairs:
                connection.close()
            raise
        finally:
            os.close(lifeline)
            for _, connection in pairs:
                connection.close()
        self.calls, self.halts, self._asides = (Peer(connection, plugin, serve) for connection, _ in pairs)
        self._watcher = threading.Thread(target=self._watch, name=f"isolated-{plugin}", daemon=True)
        self._watcher.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._group.process.pid

    def end(self) -> None:
        """Let it end, or kill it if it does not; returns when it has gone. May be called again."""
        self._is_ending = True
        for peer in (self.calls, self.halts, self._asides):
            peer.hang_up()
        self._group.wait(END_TIMEOUT_S)
        self._give_back()

    def kill(self) -> None:
        """End it at once."""
        self._is_ending = True
        self._give_back()

    def how_it_ended(self) -> str:
        """Why a connection was lost, in words; a process that has only hung up is killed."""
        self._is_ending = True
        self._group.wait(END_TIMEOUT_S)
        self._give_back()
        return self._status()

    def _status(self) -> str:
        status = self._group.status
        return how_it_ended(status) if status is not None else "has hung up"

    def _give_back(self) -> None:
        self._group.kill()
        self.calls.close()
        self.halts.close()
        self._asides.hang_up()
        lifeline, self._lifeline = self._lifeline, -1
        if lifeline >= 0:
            os.close(lifeline)
        if threading.current_thread() is not self._watcher:
            self._watcher.join(END_TIMEOUT_S)

    def _watch(self) -> None:
        self._asides.run()
        self._asides.close()
        if self._is_ending:
            return
        why = self.how_it_ended()
        on_lost = self._on_lost()
        if on_lost is not None:
            on_lost(why)
