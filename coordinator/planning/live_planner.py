"""Planning in live: in a separate process, so that the coordinator's loop never waits for a plan.

A separate interpreter leaves the loop its lock and, by priority, a core. If the process dies or hangs, another one is
started and gets the last request again; meanwhile the coordinator follows its present plan.
"""

import logging
import pickle
import socket
import struct
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import msgspec

from robrain.coordinator.planning.plan_in_force import PlanInForce
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.snapshot import PlanningRobot, Snapshot
from robrain.protocol.backoff import Backoff
from robrain.protocol.messages.tasks.task_messages import Remedy
from robrain.protocol.workers import OwnedThread, WorkerProcess, how_it_ended

MODULE = "robrain.coordinator.planning.worker_main"
EXIT_S = 20.0
"""Time limit for a process that is about to end, and for its reader thread to notice."""


RECEIVE_BYTES = 1 << 16
_LENGTH = struct.Struct("!Q")


class PlanRequest(NamedTuple):
    """A request for a plan; a later one has a greater number.

    It is sent as a pickle: both sides run the same program.
    """

    number: int
    snapshot: Snapshot
    policy: PlanningPolicy


class Supposition(NamedTuple):
    """A request for a plan that is not executed, about one task; it may be one more."""

    number: int
    snapshot: Snapshot
    policy: PlanningPolicy
    task: str
    """The task, whose costs are wanted."""
    absent: dict[str, PlanningRobot] = {}  # noqa: RUF012 - never changed
    """Robots of the team that plans exclude now."""


class Ready(msgspec.Struct, frozen=True, tag=True):
    """The process accepts requests."""


class Made(msgspec.Struct, frozen=True, tag=True):
    """A plan."""

    planned: PlanInForce


class PlanFailed(msgspec.Struct, frozen=True, tag=True):
    """No plan can be made for a request."""

    reason: str


class Done(msgspec.Struct, frozen=True, tag=True):
    """A request is complete, or was dropped for a later one."""

    number: int


class Supposed(msgspec.Struct, frozen=True, tag=True):
    """The plan of a `Supposition`."""

    number: int
    planned: PlanInForce | None
    """None if there is none."""
    remedies: list[Remedy] = []
    """Changes with which a plan would include the task, if this one does not."""
    blocks: list[str] = []
    """Places that cannot be reached while a robot is at the task."""


Reply = Ready | Made | PlanFailed | Done | Supposed
"""Messages of the planning process, in MessagePack: the coordinator decodes them in a millisecond or two."""


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


class PlannerProcess:
    """Starts the process.

    Args:
        on_reply: called with each message of the process, on a separate thread.
        on_lost: called on that thread when the process has ended.

    Raises:
        OSError: it cannot be started.

    """

    def __init__(self, on_reply: Callable[[Reply], None], on_lost: Callable[[], None]) -> None:
        self.is_lost = False
        """Whether the process has ended or sent an invalid message."""
        self._on_reply = on_reply
        self._on_lost = on_lost
        self._process = WorkerProcess(MODULE, [], sockets=2, stdout=subprocess.DEVNULL)
        self._requests, self._replies = self._process.sockets
        self._reader = OwnedThread("planner-replies", self._read)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def ask(self, request: PlanRequest | Supposition, limit_s: float) -> None:
        """Send a request.

        Raises:
            TimeoutError: the process does not accept it within the limit.
            OSError: the process has ended.

        """
        self._requests.settimeout(limit_s)
        send(self._requests, pickle.dumps(request, pickle.HIGHEST_PROTOCOL))

    def kill(self) -> None:
        """Kill it at once; call `end` afterwards."""
        self._process.kill()

    def end(self) -> str:
        """End it and free its resources; returns, in words, how it ended if it did so by itself."""
        if self.is_lost:  # it is about to
            self._process.ends_within(EXIT_S)
        status = self._process.status
        self._process.kill()
        self._reader.close(EXIT_S)  # the process has ended
        self._requests.close()
        self._replies.close()
        return "" if status is None else how_it_ended(status)

    def _read(self) -> None:
        try:
            while True:
                self._on_reply(msgspec.msgpack.decode(receive(self._replies), type=Reply))
        except (EOFError, OSError):
            pass
        except msgspec.ValidationError:
            logger.exception("the planner's process has sent an invalid message")
        self.is_lost = True
        self._on_lost()


logger = logging.getLogger(__name__)

KEPT_PLANS = 4
JOIN_S = 60.0
"""How long `close` waits for the threads, which wait for the killed process; long enough for a busy machine."""
GRACE_S = 30.0
"""Silence beyond a plan's deadline after which the process counts as hung. For a hundred robots on a new map the first
plan may take some seconds."""
START_S = 300.0
"""The same for its start. The first start on a machine compiles the allocators."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
"""Pause before the next process is started; it doubles each time until one has answered."""
TRIES = 3
"""A request over which this many processes were lost is abandoned; the next may succeed."""


class LivePlanner:
    """Returns the auction's plan at once, and any better one within the policy's deadline.

    Only the last request counts; it ends a running search at the next round.

    Args:
        on_made: called on a thread of the planner when a plan is ready.

    """

    def __init__(self, on_made: Callable[[], None]) -> None:
        self._on_made = on_made
        self._latest: PlanRequest | None = None
        self._made: deque[PlanInForce] = deque(maxlen=KEPT_PLANS)
        self.failure_reason = ""
        """Why planning failed for the last request; empty if it has not failed."""
        self._asked = 0
        self._answered = 0
        """Number of the last request that is complete."""
        self._lost = (0, 0)
        """The request that was running when a process was lost, and how many processes it has lost."""
        self._suppositions: deque[Supposition] = deque()
        """Those that were not sent yet."""
        self._supposed: deque[Supposed] = deque()
        self._pending: set[int] = set()
        """Suppositions without an answer."""
        self._backoff = Backoff(FIRST_PAUSE_S, LONGEST_PAUSE_S)
        self._received_s = 0.0
        self._is_ready = False
        self._wake = threading.Event()
        self._has_ended = threading.Event()
        self._process: PlannerProcess | None = None
        self._keeper: OwnedThread | None = None

    @property
    def pid(self) -> int | None:
        """Id of the present process; None if there is none."""
        process = self._process
        return None if process is None else process.pid

    def prepare(self) -> None:
        """Prepare for the first request: start the process, unless it has started."""
        if self._keeper is None and not self._has_ended.is_set():
            self._keeper = OwnedThread("planner", self._keep)

    def ask(self, snapshot: Snapshot, policy: PlanningPolicy) -> None:
        """Request a plan; replaces a waiting request."""
        self._asked += 1
        self._latest = PlanRequest(self._asked, snapshot, policy)
        self._wake.set()
        self.prepare()

    def suppose(self, supposition: Supposition) -> None:
        """Request a plan that is not executed; there is none while the process starts."""
        self.prepare()
        if not self._is_ready:
            self._supposed.append(Supposed(supposition.number, None))
            return
        self._pending.add(supposition.number)
        self._suppositions.append(supposition)
        self._wake.set()

    def supposed(self) -> list[Supposed]:
        """The answers to `suppose` since the last call."""
        return [self._supposed.popleft() for _ in range(len(self._supposed))]

    def finished_plans(self) -> list[PlanInForce]:
        """The plans made since the last call, the best last."""
        return [self._made.popleft() for _ in range(len(self._made))]

    @property
    def is_busy(self) -> bool:
        """Whether a requested plan may still arrive."""
        return self._asked > self._answered or bool(self._made)

    def close(self) -> None:
        """Kill the process, and end the threads."""
        self._has_ended.set()
        self._wake.set()
        process = self._process
        if process is not None:
            process.kill()  # it holds no state, and may be searching
        if self._keeper is not None:
            self._keeper.close(JOIN_S)

    # -- on the keeper's thread -----------------------------------------------------------------------------

    def _keep(self) -> None:
        while not self._has_ended.is_set():
            ending = self._run_one()
            if self._has_ended.is_set():
                return
            pause_s = self._backoff.fail(time.monotonic())
            logger.warning("the planner's process %s; there is another in %g s", ending, pause_s)
            self._record_lost()
            self._has_ended.wait(pause_s)

    def _run_one(self) -> str:
        """Start a process and send it requests until it is lost; returns why it was lost."""
        self._is_ready = False
        self._received_s = time.monotonic()
        try:
            process = self._process = PlannerProcess(self._receive, self._wake.set)
        except OSError as error:
            return f"cannot be started: {error}"
        try:
            ending = self._ask(process)
        except TimeoutError:
            ending = "accepts no request"
        except OSError as error:
            ending = f"cannot be asked: {error}"
        finally:
            self._process = None
            ended = process.end()
        return ended or ending

    def _ask(self, process: PlannerProcess) -> str:
        sent = self._answered
        while not self._has_ended.is_set():
            self._wake.clear()
            if process.is_lost:
                return "has hung up"
            request = self._latest
            while self._is_ready and self._suppositions:
                self._received_s = time.monotonic()
                process.ask(self._suppositions.popleft(), GRACE_S)
            if self._is_ready and request is not None and request.number > max(sent, self._answered):
                if sent <= self._answered:  # it was idle
                    self._received_s = time.monotonic()
                sent = request.number
                process.ask(request, GRACE_S)
            limit_s: float | None = None
            if not self._is_ready:
                limit_s = START_S
            elif request is not None and (sent > self._answered or self._pending):
                limit_s = request.policy.deadline_s + GRACE_S
            left_s = None if limit_s is None else self._received_s + limit_s - time.monotonic()
            if left_s is not None and left_s <= 0:
                return f"has sent nothing for {limit_s:g} s"
            self._wake.wait(left_s)
        return ""

    def _record_lost(self) -> None:
        self._suppositions.clear()
        while self._pending:
            self._supposed.append(Supposed(self._pending.pop(), None))
            self._on_made()
        request = self._latest
        if request is None or request.number <= self._answered:
            return
        number, losses = self._lost
        losses = losses + 1 if number == request.number else 1
        self._lost = request.number, losses
        if losses >= TRIES:
            logger.error("no plan %d could be made: %d processes were lost over it", request.snapshot.number, losses)
            self._answered = request.number

    # -- on the process' thread -----------------------------------------------------------------------------

    def _receive(self, reply: Reply) -> None:
        self._received_s = time.monotonic()
        match reply:
            case Ready():
                self._is_ready = True
            case Made(planned):
                self.failure_reason = ""
                self._made.append(planned)
                self._on_made()
            case Supposed(number):
                self._pending.discard(number)
                self._supposed.append(reply)
                self._on_made()
            case PlanFailed(reason):
                self.failure_reason = reason.rstrip().rpartition("\n")[2]
                logger.error("no plan could be made: %s", reason)
            case Done(number):
                self._answered = number
                self._backoff.succeed()
        self._wake.set()
