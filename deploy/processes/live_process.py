"""The parts of every live process: session, endpoint and stop signal."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import NamedTuple

import msgspec
import zenoh

from robrain.client.transport import open_client_session
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.lifeline import Lifeline
from robrain.deploy.processes.secured_start import warn_of_listening
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import NobodyThere, PortTaken
from robrain.protocol.safe_text import safe_json, safe_lines
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.hub import given_endpoints, hub_endpoint
from robrain.protocol.wire.session import check_endpoint, is_secured, may_answer, open_session

PARENT_VARIABLE = "ROBRAIN_PARENT"
"""Process id of the parent that started a process, which ends when its parent has changed."""
LOOK_AGAIN_S = 0.2
ANY_PORT = "tcp/127.0.0.1:0"


class Place(NamedTuple):
    """Endpoints that a process connects to or listens at; at least one of the two is empty."""

    connect: list[str]
    listen: list[str]


def place_of(connect: str | None, listen: str | None) -> Place:
    """The place that `--connect` or `--listen` gives; without either, ROBRAIN_CONNECT, or no endpoint.

    Raises:
        UsageError: both are given.
        WireError: an endpoint is invalid.

    """
    if listen is None:
        return Place(given_endpoints(connect), [])
    if connect is not None:
        raise UsageError(f"--connect {connect} and --listen {listen}: expected one of the two")
    return Place([], [check_endpoint(listen)])


@contextmanager
def client_session(connect: str | None) -> Iterator[zenoh.Session]:
    """Open a client session at the given endpoint, or else at this machine's hub.

    Raises:
        NobodyThere: nothing answers there.
        WireError: an endpoint is invalid.

    """
    with closing(open_client_session(connect)) as session:
        yield session


def open_hub(listen: str | None) -> tuple[zenoh.Session, str]:
    """Open a hub at `listen`; without it, at this machine's hub endpoint, or on a free port if that is taken.

    Returns:
        The hub, which the caller closes, and the endpoint of this machine's hub if another process has it, else "".

    Raises:
        PortTaken: another process listens at `listen`.
        WireError: the endpoint is invalid, or cannot be listened on.

    """
    warn_of_listening("hub", [listen or hub_endpoint()], note)
    try:
        return open_session(mode="router", listen=[listen or hub_endpoint()]), ""
    except PortTaken:
        if listen is not None:
            raise
    return open_session(mode="router", listen=[ANY_PORT]), hub_endpoint()


def open_when_there(
    who: str,
    connect: Sequence[str],
    should_stop: Callable[[], bool],
    *,
    mode: str = "client",
    listen: Sequence[str] = (),
) -> zenoh.Session | None:
    """Open a session with `open_session` as soon as one of its endpoints answers.

    Waits without a time limit, and says so once on stderr.

    Args:
        who: name of the waiting process, for the message.
        connect: endpoints; if there are none, it does not wait.
        should_stop: asked several times a second.
        mode: mode of the session.
        listen: endpoints to listen at.

    Returns:
        The session, which the caller closes; None if `should_stop` came first.

    Raises:
        WireError: an endpoint is invalid, or cannot be listened on.

    """
    has_said = False
    while not should_stop():
        if not connect or any(map(may_answer, connect)):
            try:
                return open_session(mode=mode, connect=connect, listen=listen)
            except NobodyThere as error:  # the hub may start later: try again
                if any(map(is_secured, connect)) and not has_said:
                    has_said = True
                    note(f"{who}: {error} Trying again until it answers")
        if not has_said:
            has_said = True
            where = ", ".join(connect)
            sys.stderr.write(f"{who}: nobody answers at {where} yet: waiting for `robrain up` or a router\n")
        time.sleep(LOOK_AGAIN_S)
    return None


@contextmanager
def live_endpoint(session: zenoh.Session, team: str) -> Iterator[Endpoint]:
    """An endpoint of the live drive, closed at the end of the block."""
    endpoint = Endpoint(session, team, LiveClock(), Drive.LIVE)
    try:
        yield endpoint
    finally:
        endpoint.close()


def tell(text: str) -> None:
    """Print a line of the command's result on stdout, at once; the lines of a longer text are indented."""
    sys.stdout.write(safe_lines(text, "  ") + "\n")
    sys.stdout.flush()


def print_json_line(value: object) -> None:
    """Print a value as a line of JSON on stdout, unbuffered; control characters are escaped."""
    sys.stdout.write(safe_json(msgspec.json.encode(value, enc_hook=str)) + "\n")
    sys.stdout.flush()


def note(text: str) -> None:
    """Print a line about progress on stderr; the lines of a longer text are indented."""
    sys.stderr.write(safe_lines(text, "  ") + "\n")
    sys.stderr.flush()


class LiveStop:
    """Tells when a live process must end: Ctrl-C, SIGTERM, or its parent's end.

    Each question is a beat of the process's main loop, which whoever supervises the process hears.
    """

    def __init__(self) -> None:
        self.requested = False
        self._lifeline = Lifeline()
        parent = os.environ.get(PARENT_VARIABLE, "")
        self._parent = int(parent) if parent.isdigit() else None
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._request)

    def __call__(self) -> bool:
        """Whether to end."""
        self._lifeline.beat()
        has_lost_parent = self._parent is not None and os.getppid() != self._parent
        return self.requested or has_lost_parent or self._lifeline.is_cut

    def wait(self) -> None:
        """Do nothing until the process must end."""
        while not self():
            time.sleep(LOOK_AGAIN_S)

    def ready(self) -> None:
        """Tell whoever supervises the process that it does its work now."""
        self._lifeline.ready()

    def _request(self, _number: int, _frame: object) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
