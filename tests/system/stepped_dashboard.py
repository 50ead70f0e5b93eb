"""A dashboard within the test process, so that a test can look behind its page."""

import socket
import threading
import time

from robrain.dashboard import Dashboard
from robrain.protocol.wire.endpoint import Endpoint

PERIOD_S = 0.1


class Stepped:
    """A dashboard that is stepped on a thread; records the number of steps and the longest one."""

    def __init__(self, endpoint: Endpoint) -> None:
        self.dashboard = Dashboard(endpoint, port=0)
        self.steps = 0
        self.longest_s = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()
        self.dashboard.close()

    def waiting(self) -> int:
        """Messages buffered for browsers, including those for all of them."""
        server = self.dashboard._server._websock_server
        clients = list(server._client_state_from_id.values())
        return sum(len(client.message_buffer.message_from_id) for client in clients) + len(
            server._broadcast_buffer.message_from_id
        )

    def narrow(self) -> None:
        """Shrink the send buffers, so that messages for a hung browser pile up at once."""
        for connection in self.dashboard._server._websock_server._live_connections.values():
            connection.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)

    def _run(self) -> None:
        while not self._stop.wait(PERIOD_S):
            began_s = time.monotonic()
            self.dashboard.step(time.monotonic())
            self.longest_s = max(self.longest_s, time.monotonic() - began_s)
            self.steps += 1
