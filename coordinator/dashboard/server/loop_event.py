"""Wakes viser's connections only on viser's own thread.

`asyncio.Event` is not thread-safe. viser 1.1 sets one in `AsyncMessageBuffer.push` on the pushing thread, while
connections start and stop waiting for it on the server's thread. With many browsers, drawing raised
`RuntimeError: deque mutated during iteration`. viser sets the same event again with `call_soon_threadsafe`, right after
the push or at the end of the atomic block; that second call wakes the connections, so the first can be ignored.
"""

import asyncio
import threading

import viser
from viser.infra._async_message_buffer import AsyncMessageBuffer


class LoopEvent(asyncio.Event):
    """An event that ignores `set` on any thread other than its loop's."""

    def __init__(self, thread: int) -> None:
        super().__init__()
        self._thread = thread

    def set(self) -> None:
        """Wake all waiters if called on the loop's thread."""
        if threading.get_ident() == self._thread:
            super().set()


def wake_on_own_thread(server: viser.ViserServer) -> None:
    """Replace the events of the server's buffer and of each client's buffer, now and when a client connects."""
    connections = server._websock_server

    async def exchange() -> None:
        # viser calls this on the server's thread before it starts the client's producers.
        connections.on_client_connect(lambda connection: _exchange(connection.get_message_buffer()))
        _exchange(connections.get_message_buffer())
        for client in list(connections._client_state_from_id.values()):
            _exchange(client.message_buffer)

    asyncio.run_coroutine_threadsafe(exchange(), server.get_event_loop()).result()


def _exchange(buffer: AsyncMessageBuffer) -> None:
    old = buffer.message_event
    buffer.message_event = LoopEvent(threading.get_ident())
    old.set()  # moves its waiters to the new event
