"""TCP socket: the text form over TCP, a command a line and an answer a line, with a thread for each client."""

import logging
import math
import socket
import socketserver
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Annotated, Any

from msgspec import Meta

from robrain.agent.errors import PluginError
from robrain.agent.plugin import Unit, external, unlocked
from robrain.plugins.device.command import CommandInterface
from robrain.protocol.errors import ErrorCode
from robrain.protocol.line_splitter import LineSplitter
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive, PositiveInt
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.workers import OwnedThread, close_threads

logger = logging.getLogger(__name__)


MAX_LINE_BYTES = 4096


class Conversation:
    """Turns received bytes into answers.

    A line ends with a line feed, or with carriage return and line feed. One that is too long, or not UTF-8, is answered
    with an error; its rest is skipped and the session continues. An answer is always one line: breaks within it become
    ` | `.

    Args:
        execute: answers one command, and never raises.

    """

    def __init__(self, execute: Callable[[str], str]) -> None:
        self._execute = execute
        self._splitter = LineSplitter(MAX_LINE_BYTES)

    def feed(self, received: bytes) -> Iterator[bytes]:
        """The answers to the lines that end in the received bytes."""
        for line in self._splitter.feed(received):
            if line is None:
                yield _error(f"the line is longer than {MAX_LINE_BYTES} bytes")
                continue
            try:
                text = line.decode()
            except UnicodeDecodeError as error:
                yield _error(f"the line is not UTF-8 at byte {error.start}")
                continue
            yield as_line(self._execute(text))

    def end(self) -> Iterator[bytes]:
        """The answer to a last line that was not ended: it may have been cut, so it is not executed."""
        if self._splitter.has_begun:
            yield _error("the last line has no end, so it was not executed")


def as_line(answer: str) -> bytes:
    """An answer as a line to send."""
    one = " | ".join(answer.splitlines())
    return one.encode(errors="backslashreplace") + b"\n"


def _error(message: str) -> bytes:
    return as_line(f"error {ErrorCode.BAD_ARGUMENTS}: {message}")


MAX_PORT = 65535

FIRST_COMMAND_S = 10.0
"""A new client that has given no command within this time is disconnected: it would keep others out."""
REPORT_S = 10.0
"""Between two warnings that all places are taken."""
SEND_TIMEOUT_S = 5.0
"""Time after which a client that reads no answer is disconnected."""
POLL_S = 0.1
CLOSE_TIMEOUT_S = 2.0
"""A command that takes longer when the server closes is abandoned."""


class LineServer(socketserver.TCPServer):
    """Listens from the moment it is made until `close`.

    Args:
        wanted: address, and limits of the clients; one beyond `max_clients` is disconnected with a message.
        execute: answers one command; called on the clients' threads, several at a time.

    Raises:
        OSError: the address is not available.

    """

    def __init__(self, wanted: "TcpSocket.Parameters", execute: Callable[[str], str]) -> None:
        self._execute = execute
        self._max_clients = wanted.max_clients
        self._idle_s = wanted.idle_s
        self._clients: dict[socket.socket, OwnedThread] = {}
        self.refused = 0
        """Number of clients disconnected because `max_clients` were connected."""
        self._reported_s = -math.inf
        self._guard = threading.Lock()
        address = wanted.host, wanted.port
        super().__init__(address, socketserver.BaseRequestHandler, bind_and_activate=False)
        self.socket.close()
        family = socket.AF_INET6 if ":" in wanted.host else socket.AF_INET
        self.socket = socket.create_server(address, family=family, backlog=128)
        self.port: int = self.socket.getsockname()[1]
        self._thread = OwnedThread(f"tcp-{self.port}", self.serve_forever, POLL_S)

    @property
    def clients(self) -> int:
        """Number of connected clients."""
        with self._guard:
            return len(self._clients)

    def close(self) -> None:
        """Stop listening, disconnect all clients, and wait for their threads."""
        self.shutdown()
        self.server_close()
        self._thread.close(CLOSE_TIMEOUT_S)
        with self._guard:
            clients = dict(self._clients)
            for client in clients:
                with suppress(OSError):  # the client has already closed the connection
                    client.shutdown(socket.SHUT_RDWR)
        close_threads(clients.values(), CLOSE_TIMEOUT_S)

    def get_request(self) -> Any:
        """Accept a client; pause briefly if too many files are open."""
        try:
            return super().get_request()
        except OSError as error:
            logger.warning("no connection on port %d: %s", self.port, error)
            time.sleep(POLL_S)
            raise

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log the error of a client that could not be welcomed."""
        logger.exception("no connection from %s on port %d", client_address[0], self.port)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a client on a thread, if there is a place."""
        with self._guard:
            if len(self._clients) < self._max_clients:
                self._clients[request] = OwnedThread(f"tcp-{self.port}-client", self._serve, request)
                return
        self.refused += 1
        now_s = time.monotonic()
        if now_s - self._reported_s >= REPORT_S:
            self._reported_s = now_s
            busy = f"port {self.port}: {self._max_clients} clients are connected, which are all that may be"
            logger.warning("%s; another came from %s (%d so far)", busy, client_address[0], self.refused)
        with request, suppress(OSError):  # it has gone
            request.settimeout(SEND_TIMEOUT_S)
            request.sendall(as_line(f"error {ErrorCode.BUSY}: {self._max_clients} clients are connected already"))

    def _serve(self, client: socket.socket) -> None:
        conversation = Conversation(self._execute)
        ends_s = time.monotonic() + min(FIRST_COMMAND_S, self._idle_s)
        has_spoken = False
        try:
            with client:
                while received := self._received(client, None if has_spoken else ends_s):
                    has_spoken = has_spoken or b"\n" in received
                    self._send(client, conversation.feed(received))
                self._send(client, conversation.end())
        except OSError as error:
            logger.info("a client of port %d is cut off: %s", self.port, error)
        finally:
            with self._guard:
                del self._clients[client]

    def _received(self, client: socket.socket, ends_s: float | None) -> bytes:
        client.settimeout(self._idle_s if ends_s is None else max(ends_s - time.monotonic(), 1e-3))
        return client.recv(MAX_LINE_BYTES)

    def _send(self, client: socket.socket, answers: Iterable[bytes]) -> None:
        client.settimeout(SEND_TIMEOUT_S)
        for answer in answers:
            client.sendall(answer)


class TcpSocket(Unit):
    """Lets programs call the robot over TCP, in lines of text. There is no log-in."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """Address, and limits of the clients."""

        enabled: bool = False
        """Off by default, because there is no log-in."""
        host: str = "127.0.0.1"
        port: Annotated[int, Meta(ge=0, le=MAX_PORT)] = 0
        """0 takes a free port, which `port()` returns and the log names."""
        max_clients: PositiveInt = 32
        idle_s: Positive = 600.0
        """Time of silence after which a client is disconnected; it must give its first command within 10 s."""

    parameters: Parameters

    def init(self) -> None:
        self._server: LineServer | None = None

    def activate(self) -> None:
        command = self.env.use("command", CommandInterface)
        wanted = self.parameters
        if not wanted.enabled:
            return
        if self.env.wire.drive is Drive.LOCKSTEP:
            raise PluginError(
                self.env.plugin,
                f"{self.env.plugin} runs only in the live drive: a lockstep run has one thread and no clients",
            )
        try:
            self._server = LineServer(wanted, command.execute)
        except OSError as error:
            raise PluginError(
                self.env.plugin, f"{self.env.plugin} cannot listen on {wanted.host} port {wanted.port}: {error}"
            ) from error
        logger.info("%s: %s listens on %s port %d", self.env.robot, self.env.plugin, wanted.host, self._server.port)

    def deactivate(self) -> None:
        server, self._server = self._server, None
        if server is not None:
            server.close()

    # Without the lock: a client may ask this while `deactivate` waits for the clients to end.

    @external
    @unlocked
    def port(self) -> int:
        """Port of the server; 0 if there is none."""
        server = self._server
        return server.port if server is not None else 0

    @external
    @unlocked
    def clients(self) -> int:
        """Number of connected clients."""
        server = self._server
        return server.clients if server is not None else 0

    @external
    @unlocked
    def refused(self) -> int:
        """Number of clients refused because `max_clients` were connected."""
        server = self._server
        return server.refused if server is not None else 0
