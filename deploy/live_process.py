"""What every live process needs: its session, its endpoint, and the word to stop."""

import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import zenoh

from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import check_endpoint, open_session

CONNECT_VARIABLE = "ROBRAIN_CONNECT"
PARENT_VARIABLE = "ROBRAIN_PARENT"
"""Process id of the parent that started a process: it ends when that is not its parent any more."""


def endpoints(connect: str | None) -> list[str]:
    """`--connect`, or else the environment's ROBRAIN_CONNECT; several endpoints are separated by commas."""
    text = connect if connect is not None else os.environ.get(CONNECT_VARIABLE, "")
    return [check_endpoint(part.strip()) for part in text.split(",") if part.strip()]


@contextmanager
def session_of(connect: Sequence[str], listen: str | None) -> Iterator[zenoh.Session]:
    """A client of what is given to connect to, or else a hub that listens."""
    if connect or listen is None:
        session = open_session(mode="client", connect=connect)
    else:
        session = open_session(mode="router", listen=[listen])
    try:
        yield session
    finally:
        session.close()


@contextmanager
def live_endpoint(session: zenoh.Session, team: str) -> Iterator[Endpoint]:
    """An endpoint of the live drive, closed at the end of the block."""
    endpoint = Endpoint(session, team, WallClock(), Drive.LIVE)
    try:
        yield endpoint
    finally:
        endpoint.close()


def tell(text: str) -> None:
    """A line on stdout, for whoever started the process, a program maybe."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


class LiveStop:
    """Says when a live process should end: Ctrl-C, SIGTERM, or its parent's death."""

    def __init__(self) -> None:
        self.requested = False
        parent = os.environ.get(PARENT_VARIABLE, "")
        self._parent = int(parent) if parent.isdigit() else None
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._request)

    def __call__(self) -> bool:
        """Whether to end."""
        return self.requested or (self._parent is not None and os.getppid() != self._parent)

    def _request(self, _number: int, _frame: object) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
