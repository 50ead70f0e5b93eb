"""TCP socket: the text form over TCP, a command a line and an answer a line."""

import logging

import msgspec

from robrain.agent.errors import PluginError
from robrain.agent.plugin import Unit, external, unlocked
from robrain.plugins.device.command.interface import CommandInterface
from robrain.plugins.unit.tcp_socket.line_server import LineServer
from robrain.protocol.wire.endpoint import Drive

logger = logging.getLogger(__name__)

MAX_PORT = 65535


class TcpSocket(Unit):
    """Lets programs call the robot over TCP, in lines of text. There is no log-in."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """Where to listen, and to how many."""

        enabled: bool = False
        """Off by default, because there is no log-in."""
        host: str = "127.0.0.1"
        port: int = 0
        """0 takes a free port, which `port()` returns and the log names."""
        max_clients: int = 32
        idle_s: float = 600.0
        """Time of silence after which a client is disconnected."""

        def __post_init__(self) -> None:
            if not 0 <= self.port <= MAX_PORT:
                raise ValueError(f"expected port from 0 to {MAX_PORT}, got {self.port}")
            for name in ("max_clients", "idle_s"):
                if not getattr(self, name) > 0:
                    raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")

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
            self._server = LineServer(
                wanted.host, wanted.port, command.execute, max_clients=wanted.max_clients, idle_s=wanted.idle_s
            )
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
