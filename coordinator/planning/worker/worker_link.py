"""What a coordinator and the process that plans for it say to each other, and how it travels.

Questions go over as pickles: they are made and read by the same program, and hold whatever a plan depends on. What
comes back is msgpack, which the coordinator reads in a millisecond or two, whatever the size of the team.
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
    """What is to be planned; a later one has a greater number."""

    number: int
    snapshot: Snapshot
    policy: PlanningPolicy


class Ready(msgspec.Struct, frozen=True, tag=True):
    """The process can be asked."""


class Made(msgspec.Struct, frozen=True, tag=True):
    """A plan."""

    planned: PlanInForce


class Failed(msgspec.Struct, frozen=True, tag=True):
    """No plan can be made of a question."""

    why: str


class Done(msgspec.Struct, frozen=True, tag=True):
    """Nothing more comes of a question: it is answered, or left for a later one."""

    number: int


Said = Ready | Made | Failed | Done
"""By the process that plans."""


class RequestWriter:
    """Writes questions for one process; the floor goes over once, for as long as it stays the same."""

    def __init__(self) -> None:
        self._floor: Floor | None = None

    def encode(self, question: PlanRequest) -> bytes:
        """As `RequestReader.read` takes it."""
        snapshot = question.snapshot
        is_known = snapshot.floor is self._floor
        self._floor = snapshot.floor
        if is_known:
            snapshot = msgspec.structs.replace(snapshot, floor=None)
        return pickle.dumps((question._replace(snapshot=snapshot), is_known), pickle.HIGHEST_PROTOCOL)


class RequestReader:
    """Reads what one `RequestWriter` has written, in that order."""

    def __init__(self) -> None:
        self._floor: Floor | None = None

    def read(self, body: bytes) -> PlanRequest:
        """The question, with its floor."""
        question: PlanRequest
        question, is_known = pickle.loads(body)  # from the parent process alone
        if is_known:
            return question._replace(snapshot=msgspec.structs.replace(question.snapshot, floor=self._floor))
        self._floor = question.snapshot.floor
        return question


def encode_said(said: Said) -> bytes:
    """As `decode_said` takes it."""
    return msgspec.msgpack.encode(said)


def decode_said(body: bytes) -> Said:
    """What the process said (msgspec.ValidationError if it is none of that)."""
    said: Said = msgspec.msgpack.decode(body, type=Said)
    return said


def send(connection: socket.socket, body: bytes) -> None:
    """Send one message (OSError; TimeoutError if the socket has a limit)."""
    connection.sendall(_LENGTH.pack(len(body)) + body)


def receive(connection: socket.socket) -> bytes:
    """The next message; waits for it (EOFError when the other end has gone)."""
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
