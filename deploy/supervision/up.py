"""`robrain up`: a team, or its parts on one machine, as processes that are watched and started again."""

import os
import shlex
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import msgspec
from rich.console import Group
from rich.live import Live

from robrain.deploy.command_line.options import new_recording, next_file
from robrain.deploy.command_line.output import print_json, print_message
from robrain.deploy.command_line.terminal import both_at_a_terminal, clock_of, console, print_line, print_progress
from robrain.deploy.errors import ChildFailed, UsageError
from robrain.deploy.processes.children import forwarder_line
from robrain.deploy.processes.live_process import ANY_PORT, LiveStop, live_endpoint, open_when_there
from robrain.deploy.supervision.credentials import Credentials
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
)
from robrain.deploy.supervision.site import DashboardEvent, ForwarderEvent, Printed, Site, hub_part, votes_option
from robrain.deploy.supervision.supervisor import Supervisor
from robrain.deploy.supervision.team_file import HostTable, TeamFile, read_team_file
from robrain.deploy.supervision.team_status import TeamMonitor
from robrain.deploy.supervision.top import members_table
from robrain.protocol.access.identity import TLS_VARIABLE
from robrain.protocol.clock import steps
from robrain.protocol.errors import PortInUse, RobrainError
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.messages.robots.witness_messages import WITNESSES_MAX
from robrain.protocol.model.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.wire.hub import CONNECT_VARIABLE, HUB_VARIABLE, hub_endpoint
from robrain.protocol.wire.session import check_endpoint, check_port_free, is_secured

if TYPE_CHECKING:  # brings the simulator, which the machine of a real robot does not need
    from robrain.sim.scenarios.scenario import Scenario

PERIOD_S = 0.1
RENEW_PERIOD_S = 60.0
"""Between two checks for certificates that soon end."""
ANY_SECURED_PORT = "tls/127.0.0.1:0"
STARTING_PERIOD_S = 0.01
"""Between two checks of a hub that starts, for which all other parts wait."""


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


def witnesses_among(robots: Sequence[str]) -> list[str]:
    """The robots of a team that elect its coordinator: an odd number, so that no vote ends in a tie.

    >>> witnesses_among(["r1", "r2", "r3", "r4"])
    ['r1', 'r2', 'r3']
    """
    count = min(len(robots), WITNESSES_MAX)
    return list(robots[: count - (count % 2 == 0)]) if robots else []


def parts_of(plan: UpPlan, site: Site) -> list[Part]:
    """All parts but the hub, in the order of their start."""
    journal, coordination = plan.journal or site.folder / "team.journal", list(plan.coordination)
    simulated = None
    if plan.scenario is not None:
        from robrain.deploy.supervision.scenario_parts import ScenarioParts

        simulated = ScenarioParts(site, plan.scenario, quiet=plan.quiet)
        coordination += simulated.coordination()
    parts: list[Part] = []
    if RECORDER in plan.parts and plan.record is not None:
        parts.append(site.recorder(plan.record, None if simulated is None else simulated.write_provenance()))
    if ARENA in plan.parts and simulated is not None:
        parts.append(simulated.arena(plan.words))
    parts += site.coordinators(journal, coordination, plan.parts, plan.witnesses)
    for name in plan.parts:
        if name in plan.robot_files:
            parts.append(site.part(name, "agent", str(plan.robot_files[name]), *votes_option(journal)))
        elif name not in STOCK_PARTS and simulated is not None:
            parts.append(simulated.robot(name, journal))
    if DASHBOARD in plan.parts:
        parts.append(site.dashboard())
    return parts


def run_up(plan: UpPlan, should_stop: Callable[[], bool], display: "UpDisplay") -> UpResult:
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
            listen, other = choose_endpoint(plan.listen, is_secured=credentials is not None)
            hub = hub_part(listen, printed, is_secured=credentials is not None)
            supervisor.add([hub if credentials is None else credentials.shown_by(hub)])
            if not _await_hub(supervisor, printed, should_stop):
                return _result(plan, "interrupted", None, supervisor, printed)
            endpoint = printed.endpoint
            if other:
                print_progress(f"{other} is in use: the hub of this team is at {endpoint}")
            display.event(HubEvent(endpoint, str(credentials.operator) if credentials else ""))
        if plan.own_journal is not None:
            display.event(JournalEvent(str(plan.own_journal)))
        session = open_when_there("up", [endpoint], should_stop)
        if session is None:
            return _result(plan, "interrupted", None, supervisor, printed)
        closing.callback(session.close)
        wire = closing.enter_context(live_endpoint(session, plan.team))
        team = TeamMonitor(wire, plan.robots)
        if plan.first_task:
            print_progress(f"a first task, once the robots are up: {plan.first_task}")
        parts = parts_of(plan, Site(folder, endpoint, plan.team, team, printed))
        if credentials is not None:
            parts = [credentials.shown_by(part) for part in parts]
        closing.callback(supervisor.stop)  # while the folder is there, and the wire open
        first = [part for part in parts if part.name == RECORDER]
        waiting = [part for part in parts if part.name != RECORDER]
        supervisor.add(first)
        ended = ""
        renew_at_s = time.monotonic() + RENEW_PERIOD_S
        while not ended:
            supervisor.update()
            if credentials is not None and time.monotonic() >= renew_at_s:
                renew_at_s = time.monotonic() + RENEW_PERIOD_S
                try:
                    credentials.renew(plan.parts, datetime.now(UTC))
                except (RobrainError, OSError) as error:  # the team continues with its current certificates
                    print_message(f"up: certificates are not renewed: {error}")
            if waiting and all(each.restarts.was_ready for each in supervisor.all if each.part.name == RECORDER):
                supervisor.add(waiting)
                waiting = []
            team.update()
            for event in printed.events():
                display.event(event)
            display.show(team, supervisor)
            ended = _end_reason(team, supervisor, plan, interrupted=should_stop())
            time.sleep(PERIOD_S)
        robots_up = sum(robot.is_up for robot in team.robots())
        supervisor.stop()
        return _result(plan, ended, team, supervisor, printed, robots_up)


def _prepared(plan: UpPlan, folder: Path) -> Credentials | None:
    """The certificates of a secured team; None of a plain one."""
    if not plan.is_secured:
        return None
    if plan.listen is not None and not is_secured(check_endpoint(plan.listen)):
        raise UsageError(f"--listen {plan.listen}: expected tls/HOST:PORT for a secured team")
    credentials = Credentials(plan.pki or folder / "pki", plan.team)
    credentials.prepare(plan.parts, datetime.now(UTC), plan.hosts)
    return credentials


def choose_endpoint(listen: str | None, *, is_secured: bool = False) -> tuple[str, str]:
    """Endpoint for the hub, and this machine's hub endpoint if another process has that, else "".

    A secured team listens at the host and port of ROBRAIN_HUB, or else at a free port.

    Raises:
        PortInUse: another process listens at `listen`.
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
    except PortInUse:
        return free, wanted
    return wanted, ""


def _await_hub(supervisor: Supervisor, printed: Printed, should_stop: Callable[[], bool]) -> bool:
    for _ in steps(should_stop, STARTING_PERIOD_S):
        supervisor.update()
        if supervisor.lost:
            raise ChildFailed("the hub did not start: it has failed too often")
        hub = supervisor.named(HUB)
        if printed.endpoint and hub is not None and hub.is_up:
            return True
    return False


def _end_reason(team: TeamMonitor, supervisor: Supervisor, plan: UpPlan, *, interrupted: bool) -> str:
    if interrupted:
        return "interrupted"
    if plan.until_explored is not None and team.explored_fraction >= plan.until_explored:
        return "explored"
    if plan.time_limit_s is not None and team.sim_time_s >= plan.time_limit_s:
        return "time_limit"
    return f"the {supervisor.lost} was given up" if supervisor.lost else ""


def _result(
    plan: UpPlan, ended: str, team: TeamMonitor | None, supervisor: Supervisor, printed: Printed, robots_up: int = 0
) -> UpResult:
    truth = team.truth if team is not None else None
    robots = truth.robots if truth is not None else []
    return UpResult(
        scenario=plan.name,
        ended=ended,
        robots_up=robots_up,
        sim_time_s=team.sim_time_s if team is not None else 0.0,
        explored_fraction=team.explored_fraction if team is not None else 0.0,
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


class UpDisplay:
    """Shows a team while it starts and runs, in one of three ways.

    As lines of JSON, one for each event as it occurs. At a terminal, as endpoints and a live table below them.
    Elsewhere, as endpoints on stdout, and a line on stderr for each team member that joins or leaves.

    Args:
        team: name of the team.
        live: draws the table; None at no terminal.
        as_json: print events only.

    """

    def __init__(self, team: str, live: Live | None, *, as_json: bool) -> None:
        self._team, self._live, self._as_json = team, live, as_json
        self._before: dict[str, str] = {}
        # Above the table rich would break long lines, which then could not be copied.
        self._print = print_progress if live is not None and both_at_a_terminal() else print_line

    def event(self, event: UpEvent) -> None:
        """Print an event, of which a result is the last; in words a start of a part is no news."""
        if self._as_json:
            print_json(event)
            return
        match event:
            case HubEvent():
                self._print_hub(event)
            case JournalEvent(path=path):
                self._print(f"journal: {path}")
            case DashboardEvent(url=url):
                self._print(f"dashboard: {url}")
            case ForwarderEvent(robot=robot, address=address):
                self._print(forwarder_line(robot, address))
            case PartEvent():
                if event.is_news:
                    print_progress(event.words)
            case UpResult():
                print_result_of(event)

    def show(self, team: TeamMonitor, supervisor: Supervisor) -> None:
        """Show the status of the team and of the processes of this machine; ten times a second."""
        if self._live is not None:
            self._live.update(self._table(team, supervisor))
        elif not self._as_json:
            now = {robot.name: robot.words for robot in team.robots()}
            now["coordinator"] = "up" if team.has_coordinator else "starting"
            for name, text in now.items():
                seen = "up" if text not in ("starting", "halted", "gone") and "lost" not in text else text
                if self._before.get(name) != seen:
                    self._before[name] = seen
                    print_progress(f"{name}: {seen}")

    def _print_hub(self, hub: HubEvent) -> None:
        """Print where the hub listens, and how other commands find it."""
        needed = {} if hub.endpoint == hub_endpoint() else {CONNECT_VARIABLE: hub.endpoint}
        needed |= {TLS_VARIABLE: hub.tls} if hub.tls else {}
        option = "" if self._team == DEFAULT_TEAM else f" with --team {self._team}"
        self._print(f"hub: {hub.endpoint}  (other commands find it{option}{' after:' if needed else ''})")
        if needed:
            self._print(f"export {' '.join(f'{name}={shlex.quote(value)}' for name, value in needed.items())}")

    @staticmethod
    def _table(team: TeamMonitor, supervisor: Supervisor) -> Group:
        words, now_s = {robot.name: robot.words for robot in team.robots()}, time.monotonic()
        parts = [
            each.status(now_s, team.messages(each.part.name), words.get(each.part.name, "")) for each in supervisor.all
        ]
        heading = f"{team.explored_fraction:.1%} explored, {clock_of(team.sim_time_s)}; Ctrl-C stops the team"
        return Group(heading, members_table(parts))


def print_result_of(result: UpResult) -> None:
    """Print the result of a run."""
    for name, count in result.restarts.items():
        again = "once" if count == 1 else f"{count} times"
        print_line(f"{name} was started again {again}{', then given up' if name in result.given_up else ''}")
    if not result.sim_time_s:
        print_line(result.ended)
        return
    from robrain.deploy.processes.run_display import accuracy_lines, print_recorded  # brings the simulator

    print_line(
        f"{result.ended}: {result.explored_fraction:.1%} explored in {clock_of(result.sim_time_s)}, "
        f"{result.collisions} collisions"
    )
    for line in accuracy_lines(result.map_accuracy, result.pose_accuracy):
        print_line(line)
    print_recorded(result.recording)


def up_command(plan: UpPlan, *, as_json: bool) -> UpResult:
    """Start the parts of a plan, show it, and stop it (RobrainError in one sentence)."""
    should_stop = LiveStop()
    is_drawn = console.is_terminal and not as_json
    with Live(console=console, refresh_per_second=5, redirect_stdout=False) if is_drawn else nullcontext() as live:
        display = UpDisplay(plan.team, live, as_json=as_json)
        result = run_up(plan._replace(quiet=as_json), should_stop, display)
    display.event(result)
    return result


def plan_of_host(path: Path, host_name: str | None) -> UpPlan:
    """Parts that one machine of a team file starts.

    Args:
        path: the team file.
        host_name: which machine; None if there is only one.

    Raises:
        RobrainError: in one sentence.

    """
    team_file = read_team_file(path)
    host = team_file.host(path, host_name)
    folder, team = path.parent, team_file.team
    files = {name: folder / file for name, file in team_file.robots.items() if name in host.parts}
    scenario: Scenario | None = None
    words: Sequence[str] = ()
    known: list[str] = []
    if team.scenario:
        scenario, words = _scenario_of(path, team.scenario)
        known = [robot.name for robot in scenario.world().robots]
        if unknown := [name for name in host.robots if name not in known and name not in files]:
            raise UsageError(
                f"{path}: hosts.{host.name}.parts: expected {', '.join(STOCK_PARTS)}, {', '.join(known)} or a "
                f"robot of [robots], got {unknown[0]}"
            )
    is_elected = any(STAND_BY in one.parts for one in team_file.hosts)
    kept = {"--planning": team.planning, "--rules": team.rules, "--floor": team.floor}
    has_hub = HUB in host.parts
    return UpPlan(
        name=host.name,
        team=team.name,
        parts=host.parts,
        scenario=scenario,
        words=words,
        listen=team_file.endpoint if has_hub else None,
        connect=None if has_hub else team_file.endpoint,
        robots=host.robots,
        robot_files=files,
        witnesses=witnesses_among(sorted({*known, *team_file.robots})) if is_elected else [],
        coordination=[word for option, file in kept.items() if file for word in (option, str(folder / file))],
        journal=folder / (team.journal or f"{team.name}.journal"),
        record=_recording(path, team_file, host),
        dashboard_port=team.dashboard_port,
        is_secured=bool(team.pki),
        pki=folder / team.pki if team.pki else None,
        hosts=[team_file.hub_host.address],
    )


def new_journal(team: str) -> Path | None:
    """A new file in runs/; None, with a warning, if this folder cannot be written."""
    try:
        return next_file(Path("runs"), team, ".journal")
    except OSError as error:
        print_message(f"up: {error}: the journal and its backups end with the team; --journal FILE keeps them")
        return None


def _recording(path: Path, team_file: TeamFile, host: HostTable) -> Path | None:
    if RECORDER not in host.parts:
        return None
    if team_file.team.record:
        return new_recording(path.parent / team_file.team.record)
    return next_file(path.parent / "runs", team_file.team.name)


def _scenario_of(path: Path, name: str) -> "tuple[Scenario, Sequence[str]]":
    """The scenario of a team file, and the words of a command line that name it."""
    from robrain.deploy.command_line.scenario_choice import choose_scenario

    if name.endswith(".toml") or "/" in name:
        name = str(path.parent / name)
    return choose_scenario(name, None, None, None, None), [name]
