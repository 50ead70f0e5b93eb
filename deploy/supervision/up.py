"""`robrain up`: a team, or its parts on one machine, as processes that are watched and started again."""

import os
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple, Protocol
from urllib.parse import urlsplit

import msgspec

from robrain.deploy.errors import ChildFailed, UsageError
from robrain.deploy.pki.router import READY_PREFIX
from robrain.deploy.processes import dashboard_process, hub_process
from robrain.deploy.processes.forwarder_words import read_said
from robrain.deploy.processes.live_process import ANY_PORT, note, open_when_there
from robrain.deploy.supervision.credentials import Credentials, now_utc
from robrain.deploy.supervision.part import HUB, RECORDER, PartEvent, PartView
from robrain.deploy.supervision.site import MakeParts, Site, hub_part, router_part
from robrain.deploy.supervision.supervisor import Supervisor
from robrain.deploy.supervision.team_watch import TeamWatch
from robrain.protocol.model.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.wire.clock import LiveClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.errors import PortTaken, RobrainError
from robrain.protocol.wire.hub import HUB_VARIABLE, hub_endpoint
from robrain.protocol.wire.session import check_endpoint, check_port_free, is_loopback, is_secured

LOOK_PERIOD_S = 0.1
RENEW_PERIOD_S = 60.0
"""Between two looks at certificates that soon end."""
ANY_SECURED_PORT = "tls/127.0.0.1:0"
STARTING_PERIOD_S = 0.01
"""Between two looks at a hub that starts, for which everything else waits."""


class UpStatus(NamedTuple):
    """The team at one moment, for display."""

    robots: list[tuple[str, str]]
    """Name, and how it is in a few words."""
    coordinator_up: bool
    parts: list[PartView]
    """The processes of this machine."""
    sim_time_s: float
    explored_fraction: float
    forwarders: dict[str, str]
    """`host:port` of the Serial Forwarder of each robot's base station."""


class UpResult(msgspec.Struct, frozen=True, kw_only=True, tag_field="event", tag="result"):
    """Final result of `robrain up`; the last line of `up --json`."""

    scenario: str
    ended: str
    robots_up: int
    sim_time_s: float
    explored_fraction: float
    collisions: int
    recording: str | None
    messages: int
    journal: str | None = None
    """The coordinator's file; its backups are in the folder of that name with `.backups`."""
    map_accuracy: MapAccuracy | None = None
    """Accuracy of the team's map at the end."""
    pose_accuracy: dict[str, PoseAccuracy] = {}
    """Accuracy of each robot's positions over the run."""
    serial_forwarders: dict[str, str] = {}
    """`host:port` at which each robot's base station could be reached."""
    restarts: dict[str, int] = {}
    """How often each part was started again; those that never were are left out."""
    given_up: list[str] = []
    """Parts that failed too often and were not started again."""


class UpOptions(NamedTuple):
    """How a team is brought up."""

    team: str
    listen: str | None = None
    """Endpoint of the hub; None uses this machine's hub endpoint, or a free port if that is taken."""
    connect: str | None = None
    """Endpoint of the hub on another machine; None if it runs here."""
    robots: Sequence[str] = ()
    """The team's robots as far as they are known."""
    until_explored: float | None = None
    time_limit_s: float | None = None
    record: Path | None = None
    journal: Path | None = None
    """Of the coordinator; None if none runs here."""
    parts: Sequence[str] = ()
    """Names of all parts that are started here."""
    is_secured: bool = False
    """Whether each part shows a certificate, and a router lets it do what its role may."""
    pki: Path | None = None
    """The folder of `robrain pki` of a secured team; None makes one for this run alone."""
    hosts: Sequence[str] = ()
    """Addresses at which a secured team's router is reached, beside loopback."""


class UpDisplay(Protocol):
    """Receives events while a team starts and runs."""

    def hub(self, endpoint: str, taken: str, tls: Path | None) -> None:
        """The hub listens at `endpoint`.

        Args:
            endpoint: where.
            taken: this machine's hub endpoint if another process has it, else "".
            tls: folder of the operator's certificate, if the team is secured.

        """

    def journal(self, path: Path) -> None:
        """The coordinator keeps its tasks in this file, and its backups beside it."""

    def dashboard(self, url: str) -> None:
        """The page is served."""

    def part(self, event: PartEvent) -> None:
        """A part has failed, or is back."""

    def show(self, status: UpStatus) -> None:
        """Status of the team, ten times a second."""

    def ended(self, result: UpResult) -> None:
        """Final result of the run."""


class _Recorded(msgspec.Struct):
    """What is read of a recorder's summary."""

    messages: int


class Printed:
    """What parts print that others need to know. Called on the threads that read their output."""

    def __init__(self, dashboard_port: int | None) -> None:
        self.endpoint = ""
        self.page = ""
        self.forwarders: dict[str, str] = {}
        self.messages = 0
        """Recorded."""
        self._dashboard_port = dashboard_port

    def dashboard_port(self) -> int | None:
        """Port of the page: once it is served it stays, so that browsers find it again."""
        return urlsplit(self.page).port if self.page else self._dashboard_port

    def on_hub(self, line: str) -> None:
        """A line of the hub's."""
        for prefix in (hub_process.READY_PREFIX, READY_PREFIX):
            where = line.removeprefix(prefix).split(",")[0]
            if line.startswith(prefix) and where.startswith(("tcp/", "tls/")) and not self.endpoint:  # not a warning
                self.endpoint = where

    def on_dashboard(self, line: str) -> None:
        """A line of the dashboard's."""
        if line.startswith(dashboard_process.READY_PREFIX):
            self.page = line.removeprefix(dashboard_process.READY_PREFIX)

    def on_arena(self, line: str) -> None:
        """A line of the arena's."""
        if said := read_said([line]):
            self.forwarders = {**self.forwarders, **said}

    def on_recorder(self, line: str) -> None:
        """A line of the recorder's: the last is its summary."""
        if line.startswith("{"):
            try:
                self.messages += msgspec.json.decode(line, type=_Recorded).messages
            except msgspec.MsgspecError:
                return


def run_up(
    name: str,
    make_parts: MakeParts,
    options: UpOptions,
    printed: Printed,
    *,
    should_stop: Callable[[], bool],
    display: UpDisplay,
) -> UpResult:
    """Start a team, or its parts on this machine, watch it, and stop it.

    Args:
        name: of the scenario, or of the host.
        make_parts: makes all parts but the hub.
        options: options of the run.
        printed: what the parts print.
        should_stop: polled ten times a second.
        display: receives events as they occur.

    Raises:
        RobrainError: a process cannot be started; the text says why.

    """
    with ExitStack() as closing:
        folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="robrain-")))
        supervisor = closing.enter_context(Supervisor(display.part))
        credentials = _prepared(options, folder)
        if credentials is not None:
            closing.enter_context(credentials.as_operator())
        endpoint = options.connect
        if endpoint is None:
            listen, taken = choose_endpoint(options.listen, is_secured=credentials is not None)
            printed.endpoint = ""
            make_hub = router_part if credentials else hub_part
            hub = make_hub(lambda: printed.endpoint or listen, printed.on_hub)
            supervisor.add([hub if credentials is None else credentials.shown_by(hub)])
            if not _await_hub(supervisor, printed, should_stop):
                return _result(name, "interrupted", None, supervisor, printed, options)
            endpoint = printed.endpoint
            display.hub(endpoint, taken, credentials.operator if credentials else None)
        if options.journal is not None:
            display.journal(options.journal)
        session = open_when_there("up", [endpoint], should_stop)
        if session is None:
            return _result(name, "interrupted", None, supervisor, printed, options)
        closing.callback(session.close)
        wire = Endpoint(session, options.team, LiveClock(), Drive.LIVE)
        closing.callback(wire.close)
        watch = TeamWatch(wire, options.robots)
        parts = make_parts(Site(folder, endpoint, options.team, watch, is_loopback(endpoint)))
        if credentials is not None:
            parts = [credentials.shown_by(part) for part in parts]
        closing.callback(supervisor.stop)  # while the folder is there, and the wire open
        first = [part for part in parts if part.name == RECORDER]
        rest = [part for part in parts if part.name != RECORDER]
        supervisor.add(first or rest)
        waiting = rest if first else []
        ended, page = "", ""
        renew_at_s = time.monotonic() + RENEW_PERIOD_S
        while not ended:
            supervisor.look()
            if credentials is not None and time.monotonic() >= renew_at_s:
                renew_at_s = time.monotonic() + RENEW_PERIOD_S
                try:
                    credentials.renew(options.parts, now_utc())
                except (RobrainError, OSError) as error:  # the team goes on with what it has
                    note(f"up: certificates are not renewed: {error}")
            if waiting and all(each.restarts.was_ready for each in supervisor.all if each.part.name == RECORDER):
                supervisor.add(waiting)
                waiting = []
            watch.look()
            if printed.page != page:
                page = printed.page
                display.dashboard(page)
            display.show(_status(watch, supervisor, printed))
            ended = _why_ended(watch, supervisor, options, interrupted=should_stop())
            time.sleep(LOOK_PERIOD_S)
        robots_up = sum(robot.is_up for robot in watch.robots())
        supervisor.stop()
        return _result(name, ended, watch, supervisor, printed, options, robots_up)


def _prepared(options: UpOptions, folder: Path) -> Credentials | None:
    """The certificates of a secured team; None of a plain one."""
    if not options.is_secured:
        return None
    if options.listen is not None and not is_secured(check_endpoint(options.listen)):
        raise UsageError(f"--listen {options.listen}: expected tls/HOST:PORT for a secured team")
    credentials = Credentials(options.pki or folder / "pki", options.team)
    credentials.prepare(options.parts, now_utc(), options.hosts)
    return credentials


def choose_endpoint(listen: str | None, *, is_secured: bool = False) -> tuple[str, str]:
    """Where the hub is to listen, and this machine's hub endpoint if another process has that, else "".

    A secured team listens at the host and port of ROBRAIN_HUB, or else at a free port.

    Raises:
        PortTaken: another process listens at `listen`.
        WireError: it cannot be listened on.

    """
    if listen is not None:
        check_port_free(check_endpoint(listen))
        return listen, ""
    wanted, free = hub_endpoint(), ANY_PORT
    if is_secured:
        free = ANY_SECURED_PORT
        wanted = f"tls/{wanted.partition('/')[2]}" if os.environ.get(HUB_VARIABLE) else free
    try:
        check_port_free(wanted)
    except PortTaken:
        return free, wanted
    return wanted, ""


def _await_hub(supervisor: Supervisor, printed: Printed, should_stop: Callable[[], bool]) -> bool:
    while not should_stop():
        supervisor.look()
        if supervisor.lost:
            raise ChildFailed("the hub did not start: it has failed too often")
        hub = supervisor.named(HUB)
        if printed.endpoint and hub is not None and hub.is_up:
            return True
        time.sleep(STARTING_PERIOD_S)
    return False


def _status(watch: TeamWatch, supervisor: Supervisor, printed: Printed) -> UpStatus:
    robots = watch.robots()
    words = {robot.name: robot.words for robot in robots}
    now_s = time.monotonic()
    truth = watch.truth
    return UpStatus(
        [(robot.name, robot.words) for robot in robots],
        watch.has_coordinator,
        [each.view(now_s, watch.messages(each.part.name), words.get(each.part.name, "")) for each in supervisor.all],
        watch.sim_time_s,
        truth.explored_fraction if truth is not None else 0.0,
        printed.forwarders,
    )


def _why_ended(watch: TeamWatch, supervisor: Supervisor, options: UpOptions, *, interrupted: bool) -> str:
    explored = watch.truth.explored_fraction if watch.truth is not None else 0.0
    if interrupted:
        return "interrupted"
    if options.until_explored is not None and explored >= options.until_explored:
        return "explored"
    if options.time_limit_s is not None and watch.sim_time_s >= options.time_limit_s:
        return "time_limit"
    return f"the {supervisor.lost} was given up" if supervisor.lost else ""


def _result(
    name: str,
    ended: str,
    watch: TeamWatch | None,
    supervisor: Supervisor,
    printed: Printed,
    options: UpOptions,
    robots_up: int = 0,
) -> UpResult:
    truth = watch.truth if watch is not None else None
    robots = truth.robots if truth is not None else []
    return UpResult(
        scenario=name,
        ended=ended,
        robots_up=robots_up,
        sim_time_s=watch.sim_time_s if watch is not None else 0.0,
        explored_fraction=truth.explored_fraction if truth is not None else 0.0,
        collisions=sum(robot.collisions for robot in robots),
        recording=str(options.record) if options.record is not None else None,
        messages=printed.messages,
        journal=str(options.journal) if options.journal is not None else None,
        map_accuracy=truth.map_accuracy if truth is not None else None,
        pose_accuracy={robot.robot: robot.accuracy for robot in robots if robot.accuracy is not None},
        serial_forwarders=printed.forwarders,
        restarts={each.part.name: each.restarts.restarts for each in supervisor.all if each.restarts.restarts},
        given_up=supervisor.given_up,
    )
