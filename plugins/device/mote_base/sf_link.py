"""A base station behind a Serial Forwarder: packets over TCP, and a new connection when one is lost."""

import socket
from collections import deque

from robrain.plugins.device.mote_base.link import Backoff
from robrain.protocol.tinyos.serial_forwarder import GREETING, BadGreeting, Decoder, encode

CHUNK_BYTES = 65_536
MAX_UNSENT_BYTES = 4096
"""About a hundred packets; what comes when they wait already is not sent."""


class SfLink:
    """A client of a Serial Forwarder.

    Args:
        host: where it runs.
        port: where it listens.
        capacity: packets that are taken in a step; the oldest of more are dropped.
        backoff: when to connect again.
        timeout_s: how long the first connection and its greeting may take.

    Raises:
        OSError: nobody listens there, or nobody greets in time.
        BadGreeting: it is no Serial Forwarder.

    """

    def __init__(self, host: str, port: int, *, capacity: int, backoff: Backoff, timeout_s: float) -> None:
        self.dropped = 0
        self._unsent = self._reconnects = 0
        self._capacity = capacity
        self._backoff = backoff
        self._why_down = ""
        self._to_send = b""
        self._decoder = Decoder()
        self._early: list[bytes] = []
        self._socket: socket.socket | None = socket.create_connection((host, port), timeout=timeout_s)
        try:
            self._address = self._socket.getpeername()
            self._family = self._socket.family
            self._socket.sendall(GREETING)
            while not self._decoder.has_greeted:
                data = self._socket.recv(CHUNK_BYTES)
                if not data:
                    raise ConnectionError("it hung up before it greeted")
                self._early += self._decoder.feed(data)
            self._socket.setblocking(False)
        except BaseException:
            self._socket.close()
            raise

    def receive(self, now_ns: int) -> list[bytes]:
        """Packets since the last step; a lost connection is sought again when its time has come."""
        if self._socket is None:
            if self._backoff.is_due(now_ns):
                self._connect(now_ns)
            return []
        packets = deque(self._early, maxlen=self._capacity)
        self._early = []
        try:
            self._flush()
            # As much as the inbox holds, and no more: a forwarder that never ends must not keep the step.
            for _ in range(1 + self._capacity * 64 // CHUNK_BYTES):
                data = self._socket.recv(CHUNK_BYTES)
                if not data:
                    raise ConnectionError("the Serial Forwarder hung up")
                came = self._decoder.feed(data)
                self.dropped += max(0, len(packets) + len(came) - self._capacity)
                packets += came
        except BlockingIOError:
            pass
        except (OSError, BadGreeting) as error:
            self._lose(str(error), now_ns)
        if self._why_down and self._socket is not None:
            if self._decoder.has_greeted:
                self._why_down = ""
                self._reconnects += 1
                self._backoff.succeeded()
            elif self._backoff.is_due(now_ns):
                self._lose("nobody greets", now_ns)
        return list(packets)

    def send(self, packet: bytes, now_ns: int) -> None:
        """Hand a packet to the forwarder; without a connection it is counted as not sent."""
        if self._socket is None or self._why_down or len(self._to_send) > MAX_UNSENT_BYTES:
            self._unsent += 1
            return
        self._to_send += encode(packet)
        try:
            self._flush()
        except BlockingIOError:
            pass
        except OSError as error:
            self._lose(str(error), now_ns)

    def why_down(self) -> str:
        """Why there is no connection."""
        return self._why_down

    def counters(self) -> dict[str, int]:
        """Packets that could not be sent, and connections after the first."""
        return {"unsent": self._unsent, "reconnects": self._reconnects}

    def close(self) -> None:
        """Hang up."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connect(self, now_ns: int) -> None:
        """Begin a connection; whether it comes about shows when something is sent or received."""
        self._backoff.failed(now_ns)  # until the forwarder has greeted
        self._decoder = Decoder()
        self._to_send = GREETING
        self._socket = socket.socket(self._family, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._socket.connect_ex(self._address)

    def _flush(self) -> None:
        assert self._socket is not None
        while self._to_send:
            self._to_send = self._to_send[self._socket.send(self._to_send) :]

    def _lose(self, why: str, now_ns: int) -> None:
        self.close()
        self._why_down = f"{self._address[0]}:{self._address[1]}: {why}"
        self._to_send = b""
        if self._backoff.is_due(now_ns):
            self._backoff.failed(now_ns)
