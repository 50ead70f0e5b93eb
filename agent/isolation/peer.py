"""Conversations: one end of a local connection between a robot's process and that of an isolated plugin.

The caller waits, and meanwhile answers requests of the other end. A call that goes down through a process and up again
to another plugin runs on one thread in each, as within one process. Separate processes exist in the live drive alone:
limits are counted by the machine's monotonic clock.
"""

import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress

import msgspec

from robrain.agent.isolation.contract import error_of, failure_of
from robrain.agent.isolation.messages import UNANSWERED, CallFailure, CallReply, Frame, Request

LARGEST_FRAME = 1 << 28
RECEIVE_BYTES = 1 << 16
_LENGTH = struct.Struct("!I")

Serve = Callable[[Request], bytes]
"""Handles the request, or raises."""


class PeerLost(Exception):
    """The other end of a conversation has gone."""


class PeerLate(Exception):
    """The other end did not answer in time; the conversation cannot be taken up again."""


class Peer:
    """One end.

    Args:
        connection: a connected stream socket; the peer owns it.
        plugin: the isolated plugin, for messages.
        serve: answers the other end.

    """

    def __init__(self, connection: socket.socket, plugin: str, serve: Serve) -> None:
        self._connection = connection
        self._plugin = plugin
        self._serve = serve
        self._lock = threading.RLock()
        self._received = bytearray()
        self._encoder = msgspec.msgpack.Encoder()
        self._decoder = msgspec.msgpack.Decoder(Frame)

    def ask(self, request: Request, limit_s: float | None = None) -> bytes:
        """Send a request, and return the answer; requests of the other end meanwhile are answered on this thread.

        Args:
            request: the request.
            limit_s: time limit of the other end; time spent on its own requests does not count.

        Raises:
            PeerLost: the other end has gone.
            PeerLate: it took too long.
            Exception: the error raised there.

        """
        with self._lock:
            self._send(request, limit_s)
            while True:
                began_s = time.monotonic()
                frame = self._receive(limit_s)
                if limit_s is not None:
                    limit_s -= time.monotonic() - began_s
                if isinstance(frame, CallReply):
                    return frame.value
                if isinstance(frame, CallFailure):
                    raise error_of(frame, self._plugin)
                if limit_s is not None and limit_s <= 0.0:  # however soon its next question would come
                    raise PeerLate
                self._answer(frame, limit_s)

    def send(self, request: Request) -> None:
        """Send a message without an answer."""
        with self._lock:
            self._send(request, None)

    def run(self) -> None:
        """Answer until the other end has gone."""
        while True:
            try:
                frame = self._receive(None)
                if not isinstance(frame, CallReply | CallFailure):
                    self._answer(frame, None)
            except PeerLost:
                return

    def hang_up(self) -> None:
        """End the conversation; threads that wait in `ask` or `run` at either end get to know."""
        with suppress(OSError):  # the other end has already closed the connection
            self._connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Hang up and give the connection back, once no thread is in `ask` any more; for `run`, by its own thread."""
        self.hang_up()
        with self._lock:
            self._connection.close()

    def _answer(self, request: Request, limit_s: float | None) -> None:
        answer: CallReply | CallFailure
        try:
            answer = CallReply(self._serve(request))
        except (PeerLost, PeerLate):
            raise
        except Exception as error:  # noqa: BLE001 - foreign plugin code; the error is the answer
            answer = failure_of(error)
        if not isinstance(request, UNANSWERED):
            self._send(answer, limit_s)

    def _send(self, frame: Frame, limit_s: float | None) -> None:
        encoded = self._encoder.encode(frame)
        if len(encoded) > LARGEST_FRAME:
            raise ValueError(f"{len(encoded)} bytes are too many for one call between processes")
        try:
            self._connection.settimeout(_at_least_a_moment(limit_s))
            self._connection.sendall(_LENGTH.pack(len(encoded)) + encoded)
        except TimeoutError as error:
            raise PeerLate from error
        except OSError as error:
            raise PeerLost from error

    def _receive(self, limit_s: float | None) -> Frame:
        deadline_s = None if limit_s is None else time.monotonic() + limit_s
        received = self._received
        while len(received) < (wanted := self._wanted()):
            left_s = None if deadline_s is None else deadline_s - time.monotonic()
            try:
                self._connection.settimeout(_at_least_a_moment(left_s))
                chunk = self._connection.recv(max(RECEIVE_BYTES, wanted - len(received)))
            except TimeoutError as error:
                raise PeerLate from error
            except OSError as error:
                raise PeerLost from error
            if not chunk:
                raise PeerLost
            received += chunk
        encoded = bytes(received[_LENGTH.size : wanted])
        del received[:wanted]
        try:
            frame: Frame = self._decoder.decode(encoded)
        except msgspec.DecodeError as error:  # native code over there has written where it should not
            raise PeerLost from error
        return frame

    def _wanted(self) -> int:
        """Bytes of the next frame, with its length, if that is known."""
        if len(self._received) < _LENGTH.size:
            return _LENGTH.size
        (length,) = _LENGTH.unpack_from(self._received)
        if length > LARGEST_FRAME:
            raise PeerLost
        return _LENGTH.size + int(length)


def _at_least_a_moment(limit_s: float | None) -> float | None:
    """A socket's timeout: zero would mean not to wait at all."""
    return None if limit_s is None else max(limit_s, 1e-4)
