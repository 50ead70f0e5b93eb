"""Messages between the coordinator and its planning process, and their encoding.

Requests are pickles: both sides run the same program, and a request holds everything that a plan depends on. Replies
are msgpack, which the coordinator decodes in a millisecond or two for any team size.
"""

import pickle
import socket
import struct
from typing import NamedTuple

import msgspec

from robrain.coordinator.planning.plan_in_force import PlanInForce
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.snapshot import Floor, Snapshot

RECEIVE_BYTES = 1 << 16
_LENGTH = struct.Struct("!Q")


class PlanRequest(NamedTuple):
    """A request for a plan; a later one has a greater number."""

    number: int
    snapshot: Snapshot
    policy: PlanningPolicy


class Ready(msgspec.Struct, frozen=True, tag=True):
    """The process accepts requests."""


class Made(msgspec.Struct, frozen=True, tag=True):
    """A plan."""

    planned: PlanInForce


class PlanFailed(msgspec.Struct, frozen=True, tag=True):
    """No plan can be made for a request."""

    why: str


class Done(msgspec.Struct, frozen=True, tag=True):
    """A request is complete, or was dropped for a later one."""

    number: int


Said = Ready | Made | PlanFailed | Done
"""Messages of the planning process."""


class RequestWriter:
    """Encodes requests for one process; the floor is sent only when it has changed."""

    def __init__(self) -> None:
        self._floor: Floor | None = None

    def encode(self, question: PlanRequest) -> bytes:
        """Encode a request for `RequestReader.read`."""
        snapshot = question.snapshot
        is_known = snapshot.floor is self._floor
        self._floor = snapshot.floor
        if is_known:
            snapshot = msgspec.structs.replace(snapshot, floor=None)
        return pickle.dumps((question._replace(snapshot=snapshot), is_known), pickle.HIGHEST_PROTOCOL)


class RequestReader:
    """Decodes the requests of one `RequestWriter`, in order."""

    def __init__(self) -> None:
        self._floor: Floor | None = None

    def read(self, body: bytes) -> PlanRequest:
        """Decode a request, with its floor."""
        question: PlanRequest
        question, is_known = pickle.loads(body)  # from the parent process alone
        if is_known:
            return question._replace(snapshot=msgspec.structs.replace(question.snapshot, floor=self._floor))
        self._floor = question.snapshot.floor
        return question


def encode_reply(said: Said) -> bytes:
    """Encode a message for `decode_reply`."""
    return msgspec.msgpack.encode(said)


def decode_reply(body: bytes) -> Said:
    """Decode a message of the process (msgspec.ValidationError if it is invalid)."""
    said: Said = msgspec.msgpack.decode(body, type=Said)
    return said


def send(connection: socket.socket, body: bytes) -> None:
    """Send one message (OSError; TimeoutError if the socket has a limit)."""
    connection.sendall(_LENGTH.pack(len(body)) + body)


def receive(connection: socket.socket) -> bytes:
    """Wait for the next message and return it (EOFError when the other end has closed)."""
    (length,) = _LENGTH.unpack(_exactly(connection, _LENGTH.size))
    return _exactly(connection, length)


def _exactly(connection: socket.socket, size: int) -> bytes:
    received = bytearray()
    while len(received) < size:
        part = connection.recv(min(RECEIVE_BYTES, size - len(received)))
        if not part:
            raise EOFError
        received += part
    return bytes(received)
