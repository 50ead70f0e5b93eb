"""Serial Forwarders of a live arena: each robot's base station as a TCP port that TinyOS' own tools talk to.

Any number of clients may listen to a base station and send by it, beside the robot itself. A forwarder speaks to the
rest of the arena by the wire alone.
"""

import select
import socket

import msgspec

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_RX, ARENA_RADIO_TX
from robrain.protocol.tinyos.serial_forwarder import GREETING, BadGreeting, PacketDecoder, encode
from robrain.protocol.wire.endpoint import Endpoint

LOOPBACK = "127.0.0.1"
MAX_CLIENTS = 16
"""Clients of one base station; a further client is disconnected."""
MAX_WAITING_BYTES = 65_536
"""A client that reads so slowly misses packets."""
CHUNK_BYTES = 4096


class ForwarderCounters(msgspec.Struct):
    """Counters of one forwarder."""

    received: int = 0
    """Packets handed to each client."""
    sent: int = 0
    """Packets that clients have sent on the air."""
    missed: int = 0
    """Packets that a slow client did not get."""
    refused: int = 0
    """Clients that were too many or greeted wrongly."""


class SerialForwarder:
    """One robot's base station, on loopback, as the protocol has no passwords.

    Its owner calls `step()` often. It never waits for anybody.

    Args:
        endpoint: source and receiver of packets.
        robot: owner of the base station.

    Raises:
        OSError: it cannot listen there.

    """

    def __init__(self, endpoint: Endpoint, robot: str) -> None:
        self.robot = robot
        self.counters = ForwarderCounters()
        self._server = socket.create_server((LOOPBACK, 0), backlog=MAX_CLIENTS)
        self._server.setblocking(False)
        self._clients: list[_Client] = []
        self._inbox = Inbox()
        endpoint.subscribe(self._inbox, ARENA_RADIO_RX, robot=robot)
        self._publisher = endpoint.publisher(ARENA_RADIO_TX, robot=robot)

    @property
    def address(self) -> tuple[str, int]:
        """Its address: host and port."""
        host, port = self._server.getsockname()[:2]
        return host, port

    @property
    def clients(self) -> int:
        """Number of connected clients."""
        return len(self._clients)

    def step(self) -> None:
        """Accept new clients, forward packets that the radio received, and send clients' packets."""
        packets = [packet for _, _, packet in self._inbox.drain_raw()] if len(self._inbox) else []
        everybody: list[socket.socket | _Client] = [self._server, *self._clients]
        readable, _, _ = select.select(everybody, (), (), 0.0)
        if self._server in readable:
            self._accept()
        self.counters.received += len(packets)
        for client in list(self._clients):
            try:
                if client in readable:
                    for packet in client.receive():
                        self._publisher.put_bytes(packet)
                        self.counters.sent += 1
                self.counters.missed += client.send(packets)
            except BadGreeting:
                self.counters.refused += 1
                self._forget(client)
            except OSError:
                self._forget(client)

    def close(self) -> None:
        """Hang up on everybody and listen no more."""
        for client in self._clients:
            client.close()
        self._clients.clear()
        self._server.close()

    def _accept(self) -> None:
        try:
            accepted, _ = self._server.accept()
        except OSError:  # it has gone again
            return
        if len(self._clients) >= MAX_CLIENTS:
            self.counters.refused += 1
            accepted.close()
            return
        self._clients.append(_Client(accepted))

    def _forget(self, client: "_Client") -> None:
        client.close()
        self._clients.remove(client)


class _Client:
    """One connection."""

    def __init__(self, accepted: socket.socket) -> None:
        accepted.setblocking(False)
        accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = accepted
        self._decoder = PacketDecoder()
        self._waiting = GREETING

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> list[bytes]:
        """Packets that it has sent (ConnectionError if it has hung up, BadGreeting if it is no client)."""
        try:
            data = self._socket.recv(CHUNK_BYTES)
        except BlockingIOError:
            return []
        if not data:
            raise ConnectionError("the client has hung up")
        return self._decoder.feed(data)

    def send(self, packets: list[bytes]) -> int:
        """Hand it packets, as soon as it has greeted; returns how many it misses."""
        missed = 0
        if self._decoder.has_greeted:
            for packet in packets:
                if len(self._waiting) > MAX_WAITING_BYTES:
                    missed += 1
                else:
                    self._waiting += encode(packet)
        try:
            while self._waiting:
                self._waiting = self._waiting[self._socket.send(self._waiting) :]
        except BlockingIOError:
            pass
        return missed

    def close(self) -> None:
        self._socket.close()
