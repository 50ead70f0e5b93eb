"""The parts of every live process: session, endpoint, stop signal and certificate; and `robrain hub`."""

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from typing import NamedTuple

import zenoh

from robrain.client.transport import open_client_session
from robrain.deploy.command_line.output import print_message, print_result
from robrain.deploy.errors import UsageError
from robrain.protocol.access.identity import Identity
from robrain.protocol.access.member import MemberRole
from robrain.protocol.clock import LiveClock, steps
from robrain.protocol.errors import NobodyThere, PortInUse, WireError
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.hub import given_endpoints, hub_endpoint, missing_rights, team_endpoints
from robrain.protocol.wire.session import (
    check_endpoint,
    is_loopback,
    is_secured,
    listening_at,
    may_answer,
    open_session,
    own_identity,
)

LIFELINE_VARIABLE = "ROBRAIN_LIFELINE"
BEAT_S = 0.1
"""Time between two beats, at least."""
BEAT, READY = b".", b"!"
READ_BYTES = 4096


class Lifeline:
    """The supervised process's end of the lifeline; without a supervisor it has no effect.

    Args:
        monotonic_s: the clock, in seconds.

    """

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self.is_cut = False
        """Whether the supervisor has gone."""
        self._monotonic_s = monotonic_s
        self._next_beat_s = float("-inf")
        # Taken out of the environment: processes that this one starts must not beat for it.
        text = os.environ.pop(LIFELINE_VARIABLE, "")
        self._file = int(text) if text.isdigit() else -1
        try:
            if self._file >= 0:
                os.set_inheritable(self._file, False)
                os.set_blocking(self._file, False)
        except OSError:  # the variable is a leftover of another process's
            self._file = -1

    def beat(self) -> None:
        """Report that the main loop runs."""
        if self._file >= 0 and self._monotonic_s() >= self._next_beat_s:
            self._next_beat_s = self._monotonic_s() + BEAT_S
            self._write(BEAT)

    def ready(self) -> None:
        """Report that the process is ready."""
        if self._file >= 0:
            self._write(READY)

    def _write(self, what: bytes) -> None:
        try:
            with suppress(BlockingIOError):  # the supervisor hangs, and has beats enough to read
                os.write(self._file, what)
        except OSError:
            os.close(self._file)
            self._file, self.is_cut = -1, True


class Pulse(NamedTuple):
    """Signals that have arrived through a lifeline since it was last read."""

    beats: int
    is_ready: bool


class LifelineEnd:
    """The supervisor's end.

    The write end is passed to one process: `pass_on` is its number until `passed`.
    """

    def __init__(self) -> None:
        self._read, self.pass_on = os.pipe()
        os.set_blocking(self._read, False)

    def passed(self) -> None:
        """The process has its end: close ours of it."""
        if self.pass_on >= 0:
            os.close(self.pass_on)
            self.pass_on = -1

    def pulse(self) -> Pulse:
        """Signals that have arrived since the last call."""
        received = b""
        if self._read >= 0:
            with suppress(BlockingIOError):
                while got := os.read(self._read, READ_BYTES):
                    received += got
        return Pulse(received.count(BEAT), READY in received)

    def close(self) -> None:
        """Cut it."""
        self.passed()
        if self._read >= 0:
            os.close(self._read)
            self._read = -1


PrintText = Callable[[str], None]


def warn_of_listening(who: str, listen: Sequence[str], print_text: PrintText) -> None:
    """Warn of endpoints without certificates that other machines can reach."""
    for endpoint in listen:
        if not is_secured(endpoint) and not is_loopback(endpoint):
            print_text(
                f"{who}: warning: other machines can reach {endpoint}, and there is no log-in: anyone there can drive, "
                "halt and resume the robots; `robrain router` asks for certificates"
            )


def check_certificate(
    who: str, print_text: PrintText, connect: Sequence[str], team: str, role: MemberRole, name: str | None = None
) -> Identity | None:
    """Check the certificate that a process is to show; None if its endpoints ask for none.

    Warns when the certificate ends soon.

    Args:
        who: name of the process, for messages.
        print_text: prints a line.
        connect: the endpoints that it connects to.
        team: its team.
        role: role that its certificate must have.
        name: its name; None accepts any.

    Raises:
        WireError: there is no certificate, it cannot be used, or it is of another role, team or name.

    """
    if not any(map(is_secured, connect)):
        return None
    identity = own_identity(next(filter(is_secured, connect)))
    shown = identity.member
    wanted = f"{role}:{team}:{shown.name if name is None else name}"
    if shown.common_name != wanted:
        raise WireError(f"{identity.folder}: expected the certificate of {wanted}, got that of {shown.common_name}")
    warning = identity.warning()
    if warning:
        print_text(f"{who}: {warning}")
    return identity


def check_rights(
    who: str, print_text: PrintText, session: zenoh.Session, connect: Sequence[str], identity: Identity
) -> None:
    """Try the accesses that the process needs, as the router drops forbidden ones silently.

    Raises:
        WireError: the router allows none of them.

    """
    missing = missing_rights(session, connect, identity)
    if not missing:
        return
    where, shown = ", ".join(connect), identity.member.common_name
    text = f"the router at {where} does not let {shown} {', '.join(map(str, missing.denied))}"
    if missing.is_all:
        raise WireError(
            f"{text}: the certificate is revoked, or the router's members.json is older than the certificate"
        )
    print_text(f"{who}: warning: {text}: its rules are not those of this version of robrain")


PARENT_VARIABLE = "ROBRAIN_PARENT"
"""Process id of the parent that started a process, which ends when its parent has changed."""
POLL_S = 0.2
ANY_PORT = "tcp/127.0.0.1:0"


class Place(NamedTuple):
    """Endpoints of a process: either to connect to or to listen at. At least one of the two lists is empty."""

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
def client_endpoint(connect: str | None, team: str) -> Iterator[Endpoint]:
    """An endpoint of a client at the given endpoint of the team, or else at this machine's hub.

    Raises:
        NobodyThere: no router answers there.
        WireError: an endpoint is invalid.

    """
    with closing(open_client_session(connect)) as session, live_endpoint(session, team) as wire:
        yield wire


def open_hub(listen: str | None) -> tuple[zenoh.Session, str]:
    """Open a hub at `listen`; without it, at this machine's hub endpoint, or on a free port if that is taken.

    Returns:
        The hub, which the caller closes, and the endpoint of this machine's hub if another process has it, else "".

    Raises:
        PortInUse: another process listens at `listen`.
        WireError: the endpoint is invalid, or cannot be listened on.

    """
    warn_of_listening("hub", [listen or hub_endpoint()], print_message)
    try:
        return open_session(mode="router", listen=[listen or hub_endpoint()]), ""
    except PortInUse:
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

    Waits without a time limit, and reports it once on stderr.

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
    is_reported = False
    for _ in steps(should_stop, POLL_S):
        if not connect or any(map(may_answer, connect)):
            try:
                return open_session(mode=mode, connect=connect, listen=listen)
            except NobodyThere as error:  # the hub may start later: try again
                if any(map(is_secured, connect)) and not is_reported:
                    is_reported = True
                    print_message(f"{who}: {error} Trying again until it answers")
        if not is_reported:
            is_reported = True
            where = ", ".join(connect)
            print_message(f"{who}: nobody answers at {where} yet: waiting for `robrain up` or a router")
    return None


def live_endpoint(session: zenoh.Session, team: str) -> AbstractContextManager[Endpoint]:
    """An endpoint of the live drive, closed at the end of the block."""
    return closing(Endpoint(session, team, LiveClock(), Drive.LIVE))


@contextmanager
def wire_when_there(
    who: str, connect: str | None, team: str, should_stop: Callable[[], bool]
) -> Iterator[Endpoint | None]:
    """An endpoint of a team's client as soon as the team's router answers; None if `should_stop` came first.

    Args:
        who: name of the waiting process, for the message.
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        should_stop: asked several times a second.

    Raises:
        WireError: an endpoint is invalid.

    """
    session = open_when_there(who, team_endpoints(connect), should_stop)
    if session is None:
        yield None
        return
    with closing(session), live_endpoint(session, team) as wire:
        yield wire


class SendTimes:
    """When messages were last sent, by name."""

    def __init__(self) -> None:
        self._sent_ns: dict[str, int] = {}

    def is_due(self, name: str, period_ns: int, now_ns: int) -> bool:
        """Whether one was last sent at least a period ago; if so, the next one counts as sent now."""
        is_due = now_ns - self._sent_ns.get(name, -period_ns) >= period_ns
        if is_due:
            self._sent_ns[name] = now_ns
        return is_due


class LiveStop:
    """Reports when a live process must end: Ctrl-C, SIGTERM, or its parent's end.

    Each call is a beat of the process's main loop, which the supervisor receives.
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
        """Wait until the process must end."""
        for _ in steps(self, POLL_S):
            pass

    def ready(self) -> None:
        """Report to the supervisor that the process is ready."""
        self._lifeline.ready()

    def _request(self, _number: int, _frame: object) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True


HUB_READY = "hub: "


def hub_command(listen: str | None) -> None:
    """Route a team's messages until Ctrl-C.

    Args:
        listen: endpoint; None uses this machine's hub endpoint, or a free port if that is taken.

    Raises:
        PortInUse: another process listens at `listen`.
        WireError: it cannot be listened on.

    """
    should_stop = LiveStop()
    with closing(open_hub(listen)[0]) as session:
        where = [endpoint for endpoint in listening_at(session) if endpoint.startswith("tcp/")]
        print_result(f"{HUB_READY}{', '.join(where) or listen}")
        should_stop.ready()
        should_stop.wait()
