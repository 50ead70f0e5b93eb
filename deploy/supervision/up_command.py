"""The work of `robrain up`: of a scenario, or of the parts of one machine in a team file."""

import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec
from rich.live import Live

from robrain.deploy.command_line.options import new_recording, next_file
from robrain.deploy.command_line.output import print_json, print_note
from robrain.deploy.command_line.terminal import both_at_a_terminal, clock_of, console, print_line, say
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.children import said
from robrain.deploy.processes.live_process import LiveStop
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
from robrain.deploy.supervision.team_file import HostTable, TeamFile, read_team_file
from robrain.deploy.supervision.top import drawn
from robrain.deploy.supervision.up import (
    Printed,
    Site,
    UpDisplay,
    UpOptions,
    UpResult,
    UpStatus,
    agent_part,
    coordinator_parts,
    dashboard_part,
    recorder_part,
    run_up,
    witnesses_among,
)
from robrain.protocol.access.identity import TLS_VARIABLE
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.wire.hub import CONNECT_VARIABLE, hub_endpoint

if TYPE_CHECKING:
    from robrain.sim.scenarios.scenario import Scenario


class HubEvent(msgspec.Struct, frozen=True, tag_field="event", tag="hub", omit_defaults=True):
    """Where the team's hub listens."""

    endpoint: str
    tls: str = ""
    """Folder of an operator's certificate, for `robrain --tls`; empty if the team is plain."""


class JournalEvent(msgspec.Struct, frozen=True, tag_field="event", tag="journal"):
    """Where the coordinator keeps its tasks."""

    path: str


class DashboardEvent(msgspec.Struct, frozen=True, tag_field="event", tag="dashboard"):
    """Where the page is served."""

    url: str


class ForwarderEvent(msgspec.Struct, frozen=True, tag_field="event", tag="serial_forwarder"):
    """Where the Serial Forwarder of a robot's base station listens."""

    robot: str
    address: str
    """`host:port`."""


class JsonEvents:
    """One event per line on stdout, as it occurs; the last is the result."""

    def __init__(self) -> None:
        self._forwarders: dict[str, str] = {}

    def hub(self, endpoint: str, taken: str, tls: Path | None = None) -> None:
        """Print where the hub listens; warn on stderr if that is not this machine's hub endpoint."""
        _warn_of_busy_endpoint(endpoint, taken)
        _print(HubEvent(endpoint, "" if tls is None else str(tls)))

    def journal(self, path: Path) -> None:
        """Print where the journal is."""
        _print(JournalEvent(str(path)))

    def dashboard(self, url: str) -> None:
        """Print where the page is."""
        _print(DashboardEvent(url))

    def part(self, event: PartEvent) -> None:
        """Print what happened to a part."""
        _print(event)

    def show(self, status: UpStatus) -> None:
        """Print new forwarders."""
        for robot, address in status.forwarders.items():
            if self._forwarders.get(robot) != address:
                self._forwarders[robot] = address
                _print(ForwarderEvent(robot, address))

    def ended(self, result: UpResult) -> None:
        """Print the result."""
        _print(result)


class PlainLines:
    """Endpoints on stdout; a line on stderr for each team member that joins or leaves."""

    def __init__(self, team: str = DEFAULT_TEAM, print_text: Callable[[str], None] = print_line) -> None:
        self._team = team
        self._before: dict[str, str] = {}
        self._print = print_text

    def hub(self, endpoint: str, taken: str, tls: Path | None = None) -> None:
        """Print where the hub listens, and how found by other commands."""
        _warn_of_busy_endpoint(endpoint, taken)
        needed = {} if endpoint == hub_endpoint() else {CONNECT_VARIABLE: endpoint}
        needed |= {} if tls is None else {TLS_VARIABLE: str(tls)}
        option = "" if self._team == DEFAULT_TEAM else f" with --team {self._team}"
        self._print(f"hub: {endpoint}  (other commands find it{option}{' after:' if needed else ''})")
        if needed:
            self._print(f"export {' '.join(f'{name}={shlex.quote(value)}' for name, value in needed.items())}")

    def journal(self, path: Path) -> None:
        """Print where the journal is."""
        self._print(f"journal: {path}")

    def dashboard(self, url: str) -> None:
        """Print where the page is."""
        self._print(f"dashboard: {url}")

    def part(self, event: PartEvent) -> None:
        """Print what happened to a part, in one line on stderr."""
        if event.is_news:
            say(event.words)

    def show(self, status: UpStatus) -> None:
        """Print what has changed."""
        now = dict(status.robots) | {"coordinator": "up" if status.coordinator_up else "starting"}
        for name, text in now.items():
            seen = "up" if text not in ("starting", "halted") and "lost" not in text and text != "gone" else text
            if self._before.get(name) != seen:
                self._before[name] = seen
                say(f"{name}: {seen}")
        self._show_forwarders(status)

    def _show_forwarders(self, status: UpStatus) -> None:
        for robot, address in status.forwarders.items():
            if self._before.get(address) != robot:
                self._before[address] = robot
                self._print(said(robot, address))

    def ended(self, result: UpResult) -> None:
        """Print the result of the run."""
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


class DrawnTable(PlainLines):
    """A live table of the team below the endpoints."""

    def __init__(self, team: str, live: Live) -> None:
        # Above the table rich would break long lines, which then could not be copied.
        super().__init__(team, say if both_at_a_terminal() else print_line)
        self._live = live

    def show(self, status: UpStatus) -> None:
        """Draw the team's status."""
        self._show_forwarders(status)
        heading = f"{status.explored_fraction:.1%} explored, {clock_of(status.sim_time_s)}; Ctrl-C stops the team"
        self._live.update(drawn(heading, status.parts))


@contextmanager
def up_display(team: str, *, as_json: bool) -> Iterator[UpDisplay]:
    """Choose the display of `robrain up` for the duration of the block."""
    if as_json:
        yield JsonEvents()
    elif console.is_terminal:
        with Live(console=console, refresh_per_second=5, redirect_stdout=False) as live:
            yield DrawnTable(team, live)
    else:
        yield PlainLines(team)


def _warn_of_busy_endpoint(endpoint: str, taken: str) -> None:
    if taken:
        say(f"{taken} is in use: the hub of this team is at {endpoint}")


def _print(event: HubEvent | JournalEvent | DashboardEvent | ForwarderEvent | PartEvent | UpResult) -> None:
    print_json(event)


class UpWords(NamedTuple):
    """Options of `robrain up` that a scenario and a team file share."""

    until_explored: float | None
    time_limit_s: float | None
    as_json: bool


class ScenarioSite(NamedTuple):
    """Options of `robrain up` for a scenario on one machine."""

    team: str
    listen: str | None
    dashboard: bool
    dashboard_port: int | None
    record: Path | None
    journal: Path | None
    stand_by: bool
    secured: bool = False
    pki: Path | None = None
    """Folder of the certificates; None makes some for the run alone."""


def up_scenario(scenario: "Scenario", words: Sequence[str], site: ScenarioSite, options: UpWords) -> UpResult:
    """Start a whole scenario on this machine, and stop it.

    Args:
        scenario: what is simulated.
        words: arguments of the command line that name it.
        site: what is started.
        options: when it ends, and how it is told.

    Raises:
        RobrainError: in one sentence.

    """
    world = scenario.world()
    robots = [robot.name for robot in world.robots]
    place = world.first_place() if scenario.starts_known else None
    wanted = [ARENA, COORDINATOR, *robots]
    wanted += [DASHBOARD] if site.dashboard else []
    wanted += [STAND_BY] if site.stand_by else []
    wanted += [RECORDER] if site.record is not None else []
    printed = Printed(site.dashboard_port)
    journal = site.journal or _new_journal(site.team)
    witnesses = witnesses_among(robots) if site.stand_by else []

    def make(where: Site) -> list[Part]:
        if place is not None and not options.as_json:
            print_note(f"a first task, once the robots are up: robrain task add visit --at {place.x_m:g},{place.y_m:g}")
        kept = journal or where.folder / "team.journal"
        return _of_scenario(where, scenario, words, wanted, printed, options, kept, site.record, {}, witnesses)

    up_options = UpOptions(
        team=site.team,
        listen=site.listen,
        robots=robots,
        until_explored=options.until_explored,
        time_limit_s=options.time_limit_s,
        record=site.record,
        journal=journal,
        parts=[HUB, *wanted],
        is_secured=site.secured or site.pki is not None,
        pki=site.pki,
    )
    return _run(scenario.name, make, up_options, printed, options)


def up_host(path: Path, host_name: str | None, options: UpWords) -> UpResult:
    """Start the parts of one machine of a team file, and stop them.

    Args:
        path: the team file.
        host_name: which machine; None if there is only one.
        options: when it ends, and how it is told.

    Raises:
        RobrainError: in one sentence.

    """
    team_file = read_team_file(path)
    host = team_file.host(path, host_name)
    folder, team = path.parent, team_file.team
    journal = folder / (team.journal or f"{team.name}.journal")
    record = _recording(path, team_file, host)
    files = {name: folder / file for name, file in team_file.robots.items() if name in host.parts}
    printed = Printed(team.dashboard_port)
    stands_by = any(STAND_BY in one.parts for one in team_file.hosts)
    if team.scenario:
        scenario, words = _scenario_of(path, team.scenario)
        known = [robot.name for robot in scenario.world().robots]
        witnesses = witnesses_among(sorted({*known, *team_file.robots})) if stands_by else []
        if unknown := [name for name in host.robots if name not in known and name not in files]:
            names = ", ".join(known)
            raise UsageError(
                f"{path}: hosts.{host.name}.parts: expected {', '.join(STOCK_PARTS)}, {names} or a "
                f"robot of [robots], got {unknown[0]}"
            )

        def make(where: Site) -> list[Part]:
            return _of_scenario(where, scenario, words, host.parts, printed, options, journal, record, files, witnesses)
    else:
        witnesses = witnesses_among(sorted(team_file.robots)) if stands_by else []
        kept = {"planning": team.planning, "rules": team.rules}

        def make(where: Site) -> list[Part]:
            options = [w for key, file in kept.items() if file for w in (f"--{key}", str(folder / file))]
            return _of_robot_files(where, host, printed, journal, options, record, files, witnesses)

    up_options = UpOptions(
        team=team.name,
        listen=team_file.endpoint if HUB in host.parts else None,
        connect=None if HUB in host.parts else team_file.endpoint,
        robots=host.robots,
        until_explored=options.until_explored,
        time_limit_s=options.time_limit_s,
        record=record,
        journal=journal if {COORDINATOR, STAND_BY} & set(host.parts) else None,
        parts=host.parts,
        is_secured=bool(team.pki),
        pki=folder / team.pki if team.pki else None,
        hosts=[team_file.hub_host.address],
    )
    return _run(host.name, make, up_options, printed, options)


def _new_journal(team: str) -> Path | None:
    """A new file in runs/; None, with a warning, if this folder cannot be written."""
    try:
        return next_file(Path("runs"), team, ".journal")
    except OSError as error:
        print_note(f"up: {error}: the journal and its backups end with the team; --journal FILE keeps them")
        return None


def _run(
    name: str, make: Callable[[Site], list[Part]], up_options: UpOptions, printed: Printed, options: UpWords
) -> UpResult:
    should_stop = LiveStop()
    with up_display(up_options.team, as_json=options.as_json) as display:
        result = run_up(name, make, up_options, printed, should_stop=should_stop, display=display)
    display.ended(result)
    return result


def _of_scenario(
    site: Site,
    scenario: "Scenario",
    words: Sequence[str],
    parts: Sequence[str],
    printed: Printed,
    options: UpWords,
    journal: Path,
    record: Path | None,
    files: dict[str, Path],
    witnesses: Sequence[str],
) -> list[Part]:
    from robrain.deploy.supervision.scenario_parts import WantedParts, scenario_parts

    wanted = WantedParts(
        parts,
        journal,
        record,
        printed.dashboard_port,
        printed.on_dashboard,
        printed.on_arena,
        printed.on_recorder,
        files,
        witnesses,
        quiet=options.as_json,
    )
    return scenario_parts(site, scenario, words, wanted)


def _of_robot_files(
    site: Site,
    host: HostTable,
    printed: Printed,
    journal: Path,
    coordination: Sequence[str],
    record: Path | None,
    files: dict[str, Path],
    witnesses: Sequence[str],
) -> list[Part]:
    """The parts of a machine of a team without a scenario."""
    parts: list[Part] = []
    if record is not None:
        parts.append(recorder_part(site, record, None, printed.on_recorder))
    parts += coordinator_parts(site, journal, coordination, host.parts, witnesses)
    parts += [agent_part(site, name, file, journal) for name, file in files.items()]
    if DASHBOARD in host.parts:
        parts.append(dashboard_part(site, printed.dashboard_port, printed.on_dashboard))
    return parts


def _recording(path: Path, team_file: TeamFile, host: HostTable) -> Path | None:
    if RECORDER not in host.parts:
        return None
    if team_file.team.record:
        return new_recording(path.parent / team_file.team.record)
    return next_file(path.parent / "runs", team_file.team.name)


def _scenario_of(path: Path, name: str) -> tuple["Scenario", list[str]]:
    """The scenario of a team file, and the words of a command line that name it."""
    from robrain.deploy.command_line.scenario_choice import choose_scenario

    if name.endswith(".toml") or "/" in name:
        name = str(path.parent / name)
    return choose_scenario(name, None, None, None, None), [name]
