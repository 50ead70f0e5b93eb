"""A client's connection to a team: a session, its endpoints, and how time passes."""

import getpass
import os
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

import zenoh

from robrain.protocol.answers.asked import BY
from robrain.protocol.clock import Clock, LiveClock
from robrain.protocol.errors import NobodyThere
from robrain.protocol.keys import DEFAULT_TEAM, check_name
from robrain.protocol.links.exchange import EVERYWHERE
from robrain.protocol.model.tasks.halt_latch import NAME_LENGTH, OPERATOR
from robrain.protocol.topic import Q, Query, R
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.hub import nobody_answers, team_endpoints
from robrain.protocol.wire.session import open_session

T = TypeVar("T")

PATIENCE_S = 5.0
GATHER_S = 0.5
"""A token or a first message may take this long to arrive through the hub."""


class Transport(ABC):
    """Reaches one team: `LiveTransport` and `LockstepTransport`."""

    session: zenoh.Session
    """The Zenoh session of the client."""
    team: str
    """Name of the team."""
    clock: Clock
    """The clock that stamps messages."""
    drive: Drive
    """Whether time is real or virtual."""
    party = EVERYWHERE
    """Party whose radio the client uses, where a lockstep run simulates radios; see `Endpoint`."""
    patience_s = 0.0
    """How long queries to an absent coordinator are repeated; 0 where it cannot be absent."""
    gather_s = 0.0
    """How long to wait for robots to be discovered; 0 where all are known at once."""

    @abstractmethod
    def elapsed_s(self) -> float:
        """Seconds since the client began; never goes back."""

    @abstractmethod
    def pass_time(self, seconds: float) -> None:
        """Let that much time pass; in lockstep a whole number of ticks, at least one."""

    def open_folder(self, robot: str, folder: Path) -> None:  # noqa: B027 - optional
        """Let a robot that runs in this process load plugins from a folder; others have that in their own file."""

    def record_query(self, key: str, request: bytes) -> None:  # noqa: B027 - optional
        """Called with each query that may change a run; in lockstep it is recorded, so that the run is repeatable."""

    @abstractmethod
    def close(self) -> None:
        """Leave the team; in lockstep, end the run. May be called again."""


class LiveTransport(Transport):
    """A client session at a team's hub.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        patience_s: how long to ask a coordinator again that does not answer, as while it restarts.

    Raises:
        NobodyThere: nothing answers at the endpoint.
        WireError: the endpoint is invalid.
        BadName: the team's name is invalid.

    """

    drive = Drive.LIVE
    gather_s = GATHER_S

    def __init__(self, connect: str | None = None, *, team: str = DEFAULT_TEAM, patience_s: float = PATIENCE_S) -> None:
        self.team = check_name("team", team)
        self.patience_s = patience_s
        self.clock = LiveClock()
        self.session = open_client_session(connect)
        self._began_s = time.monotonic()

    def elapsed_s(self) -> float:
        """Seconds since the session was opened."""
        return time.monotonic() - self._began_s

    def pass_time(self, seconds: float) -> None:
        """Sleep."""
        time.sleep(seconds)

    def close(self) -> None:
        """Close the session."""
        if not self.session.is_closed():
            self.session.close()


def open_client_session(connect: str | None) -> zenoh.Session:
    """A client session at the given endpoint, or else at this machine's hub; the caller closes it.

    Raises:
        NobodyThere: nothing answers there.
        WireError: an endpoint is invalid.

    """
    where = team_endpoints(connect)
    try:
        return open_session(mode="client", connect=where)
    except NobodyThere as error:
        raise NobodyThere(nobody_answers(where)) from error


def operator_name() -> str:
    """`operator:USER`, or `operator:uid-1000` where no account has that number."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container's user without an account
        user = f"uid-{os.getuid()}"
    return f"{OPERATOR}:{re.sub(r'[^A-Za-z0-9_.-]', '_', user)}"[:NAME_LENGTH]


class _RecordedEndpoint(Endpoint):
    """Reports each query that may change something to its transport, before it asks."""

    def __init__(self, transport: Transport) -> None:
        super().__init__(transport.session, transport.team, transport.clock, transport.drive, party=transport.party)
        self._transport = transport

    def ask(
        self,
        topic: Query[Q, R],
        request: Q | None = None,
        *,
        timeout_s: float | None = None,
        by: str = "",
        **names: str,
    ) -> R:
        """As `Endpoint.ask`."""
        if not topic.reads_only:
            key = topic.key(self.team, **names)
            body = b"" if request is None else topic.requests.write(request)
            self._transport.record_query(f"{key}?{BY}={by}" if by else key, body)
        return super().ask(topic, request, timeout_s=timeout_s, by=by, **names)


class Listening:
    """Opens endpoints, and closes those that are left.

    Args:
        transport: to the team.

    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._open: list[Endpoint] = []

    def open(self) -> Endpoint:
        """A new endpoint of the team."""
        wire = _RecordedEndpoint(self._transport)
        self._open.append(wire)
        return wire

    def until_done(self, wire: Endpoint, items: Iterator[T]) -> Iterator[T]:
        """The items, after which the endpoint is closed."""
        try:
            yield from items
        finally:
            self.end(wire)

    def end(self, wire: Endpoint) -> None:
        """Close an endpoint, unless it is closed already."""
        if wire in self._open:
            self._open.remove(wire)
            wire.close()

    def close(self) -> None:
        """Close all that are open."""
        while self._open:
            self._open.pop().close()
