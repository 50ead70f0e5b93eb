"""`robrain up`: a team, or its parts on one machine, as processes that are watched and started again."""

import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, Protocol
from urllib.parse import urlsplit

import msgspec

from robrain.deploy.command_line.output import print_note
from robrain.deploy.command_line.terminal import say
from robrain.deploy.errors import ChildFailed, UsageError
from robrain.deploy.pki.router import ROUTER_READY
from robrain.deploy.processes.children import DASHBOARD_READY, read_addresses
from robrain.deploy.processes.live_process import ANY_PORT, HUB_READY, open_when_there
from robrain.deploy.supervision.credentials import Credentials, now_utc
from robrain.deploy.supervision.part import (
    ARENA,
    COORDINATOR,
    DASHBOARD,
    HUB,
    RECORDER,
    STAND_BY,
    STOCK_PARTS,
    Part,
    PartEvent,
    PartView,
)
from robrain.deploy.supervision.site import (
    Site,
    agent_part,
    coordinator_parts,
    dashboard_part,
    hub_part,
    recorder_part,
    router_part,
)
from robrain.deploy.supervision.supervisor import Supervisor
from robrain.deploy.supervision.team_status import TeamWatch
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import PortTaken, RobrainError
from robrain.protocol.model.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.hub import HUB_VARIABLE, hub_endpoint
from robrain.protocol.wire.session import check_endpoint, check_port_free, is_loopback, is_secured

if TYPE_CHECKING:  # brings the simulator, which the machine of a real robot does not need
    from robrain.sim.scenarios.scenario import Scenario

LOOK_PERIOD_S = 0.1
RENEW_PERIOD_S = 60.0
"""Between two checks for certificates that soon end."""
ANY_SECURED_PORT = "tls/127.0.0.1:0"
STARTING_PERIOD_S = 0.01
"""Between two checks of a hub that starts, for which all other parts wait."""


class UpStatus(NamedTuple):
    """The team at one moment, for display."""

    robots: list[tuple[str, str]]
    """Name, and its status in a few words."""
    coordinator_up: bool
    parts: list[PartView]
    """The processes of this machine."""
    sim_time_s: float
    explored_fraction: float


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
    """Number of restarts of each part; parts without one are omitted."""
    given_up: list[str] = []
    """Parts that failed too often and were not started again."""


class HubEvent(msgspec.Struct, frozen=True, tag_field="event", tag="hub", omit_defaults=True):
    """Endpoint of the team's hub."""

    endpoint: str
    tls: str = ""
    """Folder of an operator's certificate, for `robrain --tls`; empty if the team is plain."""


class JournalEvent(msgspec.Struct, frozen=True, tag_field="event", tag="journal"):
    """Journal of the coordinator; its backups are beside it."""

    path: str


class DashboardEvent(msgspec.Struct, frozen=True, tag_field="event", tag="dashboard"):
    """Address of the page."""

    url: str


class ForwarderEvent(msgspec.Struct, frozen=True, tag_field="event", tag="serial_forwarder"):
    """Address of the Serial Forwarder of a robot's base station."""

    robot: str
    address: str
    """`host:port`."""


UpEvent = HubEvent | JournalEvent | DashboardEvent | ForwarderEvent | PartEvent | UpResult


class UpPlan(NamedTuple):
    """Parts that are started on this machine, and the condition for its end."""

    name: str
    """Of the scenario, or of the machine in its team file."""
    team: str
    parts: Sequence[str]
    """Names of all parts that are started here."""
    scenario: "Scenario | None" = None
    """The simulated scenario; None with real robots."""
    words: Sequence[str] = ()
    """Arguments of a command line that name the scenario."""
    listen: str | None = None
    """Endpoint of the hub; None uses this machine's hub endpoint, or a free port if that is taken."""
    connect: str | None = None
    """Endpoint of the hub on another machine; None if it runs here."""
    robots: Sequence[str] = ()
    """The team's robots as far as they are known."""
    robot_files: Mapping[str, Path] = MappingProxyType({})
    """Files of robots that are not the scenario's own."""
    witnesses: Sequence[str] = ()
    """Robots that elect one of two coordinators; none if the coordinator is alone."""
    coordination: Sequence[str] = ()
    """Options of the coordinator of a team without a scenario."""
    journal: Path | None = None
    """Of the coordinator; None if it ends with the team."""
    record: Path | None = None
    dashboard_port: int | None = None
    is_secured: bool = False
    """Whether each part presents a certificate, and a router enforces the permissions of its role."""
    pki: Path | None = None
    """The folder of `robrain pki` of a secured team; None makes one for this run alone."""
    hosts: Sequence[str] = ()
    """Addresses at which a secured team's router is reached, beside loopback."""
    until_explored: float | None = None
    time_limit_s: float | None = None
    first_task: str = ""
    """A command that submits one, for the user; empty if there is none."""
    quiet: bool = False
    """Print no report while kernels are compiled."""

    @property
    def own_journal(self) -> Path | None:
        """Journal of this machine's coordinator; None if none runs here, or its tasks end with the team."""
        return self.journal if {COORDINATOR, STAND_BY} & set(self.parts) else None


class UpDisplay(Protocol):
    """Shows a team while it starts and runs."""

    def event(self, event: UpEvent) -> None:
        """Handle an event; a result is the last event."""

    def show(self, status: UpStatus) -> None:
        """Status of the team, ten times a second."""


class _Recorded(msgspec.Struct):
    """Fields of a recorder's summary that are read."""

    messages: int


class Printed:
    """Output lines of parts that others need. Called on the threads that read their output."""

    def __init__(self, dashboard_port: int | None) -> None:
        self.endpoint = ""
        self.page = ""
        self.forwarders: dict[str, str] = {}
        self.messages = 0
        """Recorded."""
        self._dashboard_port = dashboard_port
        self._shown_page = ""
        self._shown_forwarders: dict[str, str] = {}

    def dashboard_port(self) -> int | None:
        """Port of the page: once it is served it stays, so that browsers find it again."""
        return urlsplit(self.page).port if self.page else self._dashboard_port

    def events(self) -> list[UpEvent]:
        """Lines that parts have printed since the last call and that the user needs."""
        page, forwarders = self.page, self.forwarders
        found: list[UpEvent] = [] if page == self._shown_page else [DashboardEvent(page)]
        found += [
            ForwarderEvent(robot, address)
            for robot, address in forwarders.items()
            if self._shown_forwarders.get(robot) != address
        ]
        self._shown_page, self._shown_forwarders = page, forwarders
        return found

    def on_hub(self, line: str) -> None:
        """A line of the hub's."""
        for prefix in (HUB_READY, ROUTER_READY):
            where = line.removeprefix(prefix).split(",")[0]
            if line.startswith(prefix) and where.startswith(("tcp/", "tls/")) and not self.endpoint:  # not a warning
                self.endpoint = where

    def on_dashboard(self, line: str) -> None:
        """A line of the dashboard's."""
        if line.startswith(DASHBOARD_READY):
            self.page = line.removeprefix(DASHBOARD_READY)

    def on_arena(self, line: str) -> None:
        """A line of the arena's."""
        if said := read_addresses([line]):
            self.forwarders = {**self.forwarders, **said}

    def on_recorder(self, line: str) -> None:
        """A line of the recorder's: the last is its summary."""
        if line.startswith("{"):
            try:
                self.messages += msgspec.json.decode(line, type=_Recorded).messages
            except msgspec.MsgspecError:
                return


def parts_of(plan: UpPlan, site: Site, printed: Printed) -> list[Part]:
    """All parts but the hub, in the order of their start."""
    journal, coordination = plan.journal or site.folder / "team.journal", list(plan.coordination)
    simulated = None
    if plan.scenario is not None:
        from robrain.deploy.supervision.scenario_parts import ScenarioParts

        simulated = ScenarioParts(site, plan.scenario, quiet=plan.quiet)
        coordination += simulated.coordination()
    parts: list[Part] = []
    if RECORDER in plan.parts and plan.record is not None:
        provenance = None if simulated is None else simulated.write_provenance()
        parts.append(recorder_part(site, plan.record, provenance, printed.on_recorder))
    if ARENA in plan.parts and simulated is not None:
        parts.append(simulated.arena(plan.words, printed.on_arena))
    parts += coordinator_parts(site, journal, coordination, plan.parts, plan.witnesses)
    for name in plan.parts:
        if name in plan.robot_files:
            parts.append(agent_part(site, name, plan.robot_files[name], journal))
        elif name not in STOCK_PARTS and simulated is not None:
            parts.append(simulated.robot(name, journal))
    if DASHBOARD in plan.parts:
        parts.append(dashboard_part(site, printed.dashboard_port, printed.on_dashboard))
    return parts


def run_up(plan: UpPlan, should_stop: Callable[[], bool], display: UpDisplay) -> UpResult:
    """Start a team, or its parts on this machine, watch it, and stop it.

    Args:
        plan: parts to start, and the condition for the end.
        should_stop: polled ten times a second.
        display: receives events as they occur.

    Raises:
        RobrainError: a process cannot be started; the text gives the reason.

    """
    printed = Printed(plan.dashboard_port)
    with ExitStack() as closing:
        folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="robrain-")))
        supervisor = closing.enter_context(Supervisor(display.event))
        credentials = _prepared(plan, folder)
        if credentials is not None:
            closing.enter_context(credentials.as_operator())
        endpoint = plan.connect
        if endpoint is None:
            listen, taken = choose_endpoint(plan.listen, is_secured=credentials is not None)
            printed.endpoint = ""
            make_hub = router_part if credentials else hub_part
            hub = make_hub(lambda: printed.endpoint or listen, printed.on_hub)
            supervisor.add([hub if credentials is None else credentials.shown_by(hub)])
            if not _await_hub(supervisor, printed, should_stop):
                return _result(plan, "interrupted", None, supervisor, printed)
            endpoint = printed.endpoint
            if taken:
                say(f"{taken} is in use: the hub of this team is at {endpoint}")
            display.event(HubEvent(endpoint, str(credentials.operator) if credentials else ""))
        if plan.own_journal is not None:
            display.event(JournalEvent(str(plan.own_journal)))
        session = open_when_there("up", [endpoint], should_stop)
        if session is None:
            return _result(plan, "interrupted", None, supervisor, printed)
        closing.callback(session.close)
        wire = Endpoint(session, plan.team, LiveClock(), Drive.LIVE)
        closing.callback(wire.close)
        watch = TeamWatch(wire, plan.robots)
        if plan.first_task:
            say(f"a first task, once the robots are up: {plan.first_task}")
        parts = parts_of(plan, Site(folder, endpoint, plan.team, watch, is_loopback(endpoint)), printed)
        if credentials is not None:
            parts = [credentials.shown_by(part) for part in parts]
        closing.callback(supervisor.stop)  # while the folder is there, and the wire open
        first = [part for part in parts if part.name == RECORDER]
        rest = [part for part in parts if part.name != RECORDER]
        supervisor.add(first or rest)
        waiting = rest if first else []
        ended = ""
        renew_at_s = time.monotonic() + RENEW_PERIOD_S
        while not ended:
            supervisor.look()
            if credentials is not None and time.monotonic() >= renew_at_s:
                renew_at_s = time.monotonic() + RENEW_PERIOD_S
                try:
                    credentials.renew(plan.parts, now_utc())
                except (RobrainError, OSError) as error:  # the team continues with its current certificates
                    print_note(f"up: certificates are not renewed: {error}")
            if waiting and all(each.restarts.was_ready for each in supervisor.all if each.part.name == RECORDER):
                supervisor.add(waiting)
                waiting = []
            watch.look()
            for event in printed.events():
                display.event(event)
            display.show(_status(watch, supervisor))
            ended = _end_reason(watch, supervisor, plan, interrupted=should_stop())
            time.sleep(LOOK_PERIOD_S)
        robots_up = sum(robot.is_up for robot in watch.robots())
        supervisor.stop()
        return _result(plan, ended, watch, supervisor, printed, robots_up)


def _prepared(plan: UpPlan, folder: Path) -> Credentials | None:
    """The certificates of a secured team; None of a plain one."""
    if not plan.is_secured:
        return None
    if plan.listen is not None and not is_secured(check_endpoint(plan.listen)):
        raise UsageError(f"--listen {plan.listen}: expected tls/HOST:PORT for a secured team")
    credentials = Credentials(plan.pki or folder / "pki", plan.team)
    credentials.prepare(plan.parts, now_utc(), plan.hosts)
    return credentials


def choose_endpoint(listen: str | None, *, is_secured: bool = False) -> tuple[str, str]:
    """Endpoint for the hub, and this machine's hub endpoint if another process has that, else "".

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


def _status(watch: TeamWatch, supervisor: Supervisor) -> UpStatus:
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
    )


def _end_reason(watch: TeamWatch, supervisor: Supervisor, plan: UpPlan, *, interrupted: bool) -> str:
    explored = watch.truth.explored_fraction if watch.truth is not None else 0.0
    if interrupted:
        return "interrupted"
    if plan.until_explored is not None and explored >= plan.until_explored:
        return "explored"
    if plan.time_limit_s is not None and watch.sim_time_s >= plan.time_limit_s:
        return "time_limit"
    return f"the {supervisor.lost} was given up" if supervisor.lost else ""


def _result(
    plan: UpPlan,
    ended: str,
    watch: TeamWatch | None,
    supervisor: Supervisor,
    printed: Printed,
    robots_up: int = 0,
) -> UpResult:
    truth = watch.truth if watch is not None else None
    robots = truth.robots if truth is not None else []
    return UpResult(
        scenario=plan.name,
        ended=ended,
        robots_up=robots_up,
        sim_time_s=watch.sim_time_s if watch is not None else 0.0,
        explored_fraction=truth.explored_fraction if truth is not None else 0.0,
        collisions=sum(robot.collisions for robot in robots),
        recording=str(plan.record) if plan.record is not None else None,
        messages=printed.messages,
        journal=str(plan.own_journal) if plan.own_journal is not None else None,
        map_accuracy=truth.map_accuracy if truth is not None else None,
        pose_accuracy={robot.robot: robot.accuracy for robot in robots if robot.accuracy is not None},
        serial_forwarders=printed.forwarders,
        restarts={each.part.name: each.restarts.restarts for each in supervisor.all if each.restarts.restarts},
        given_up=supervisor.given_up,
    )
