"""The work of `robrain up`: of a scenario, or of the parts of one machine in a team file."""

import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.live import Live

from robrain.deploy.command_line.options import new_recording, next_file
from robrain.deploy.command_line.output import print_json, print_note
from robrain.deploy.command_line.terminal import both_at_a_terminal, clock_of, console, print_line, say
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.children import forwarder_line
from robrain.deploy.processes.live_process import LiveStop
from robrain.deploy.supervision.part import HUB, RECORDER, STAND_BY, STOCK_PARTS, PartEvent
from robrain.deploy.supervision.supervisor import Supervisor
from robrain.deploy.supervision.team_file import HostTable, TeamFile, read_team_file
from robrain.deploy.supervision.team_status import TeamMonitor
from robrain.deploy.supervision.top import drawn
from robrain.deploy.supervision.up import (
    DashboardEvent,
    ForwarderEvent,
    HubEvent,
    JournalEvent,
    UpDisplay,
    UpEvent,
    UpPlan,
    UpResult,
    run_up,
    witnesses_among,
)
from robrain.protocol.access.identity import TLS_VARIABLE
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.wire.hub import CONNECT_VARIABLE, hub_endpoint

if TYPE_CHECKING:  # brings the simulator, which the machine of a real robot does not need
    from robrain.sim.scenarios.scenario import Scenario


class JsonEvents:
    """One event per line on stdout, as it occurs; the last is the result."""

    def event(self, event: UpEvent) -> None:
        """Print it."""
        print_json(event)

    def show(self, team: TeamMonitor, supervisor: Supervisor) -> None:
        """Do nothing: each change is an event."""


class PlainLines:
    """Endpoints on stdout; a line on stderr for each team member that joins or leaves.

    Args:
        team: name of the team.
        print_text: prints endpoints.

    """

    def __init__(self, team: str, print_text: Callable[[str], None] = print_line) -> None:
        self._team = team
        self._before: dict[str, str] = {}
        self._print = print_text

    def event(self, event: UpEvent) -> None:
        """Print it in words; a start of a part is no news."""
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
                    say(event.words)
            case UpResult():
                print_result_of(event)

    def show(self, team: TeamMonitor, supervisor: Supervisor) -> None:
        """Print the changes."""
        now = {robot.name: robot.words for robot in team.robots()}
        now["coordinator"] = "up" if team.has_coordinator else "starting"
        for name, text in now.items():
            seen = "up" if text not in ("starting", "halted", "gone") and "lost" not in text else text
            if self._before.get(name) != seen:
                self._before[name] = seen
                say(f"{name}: {seen}")

    def _print_hub(self, hub: HubEvent) -> None:
        """Print where the hub listens, and how other commands find it."""
        needed = {} if hub.endpoint == hub_endpoint() else {CONNECT_VARIABLE: hub.endpoint}
        needed |= {TLS_VARIABLE: hub.tls} if hub.tls else {}
        option = "" if self._team == DEFAULT_TEAM else f" with --team {self._team}"
        self._print(f"hub: {hub.endpoint}  (other commands find it{option}{' after:' if needed else ''})")
        if needed:
            self._print(f"export {' '.join(f'{name}={shlex.quote(value)}' for name, value in needed.items())}")


class DrawnTable(PlainLines):
    """A live table of the team below the endpoints."""

    def __init__(self, team: str, live: Live) -> None:
        # Above the table rich would break long lines, which then could not be copied.
        super().__init__(team, say if both_at_a_terminal() else print_line)
        self._live = live

    def show(self, team: TeamMonitor, supervisor: Supervisor) -> None:
        """Draw the team's status."""
        heading = f"{team.explored_fraction:.1%} explored, {clock_of(team.sim_time_s)}; Ctrl-C stops the team"
        words, now_s = {robot.name: robot.words for robot in team.robots()}, time.monotonic()
        names = [each.part.name for each in supervisor.all]
        parts = [
            each.status(now_s, team.messages(name), words.get(name, ""))
            for name, each in zip(names, supervisor.all, strict=True)
        ]
        self._live.update(drawn(heading, parts))


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


def up_command(plan: UpPlan, *, as_json: bool) -> UpResult:
    """Start the parts of a plan, show it, and stop it (RobrainError in one sentence)."""
    should_stop = LiveStop()
    with up_display(plan.team, as_json=as_json) as display:
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
    kept = {"--planning": team.planning, "--rules": team.rules}
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
        print_note(f"up: {error}: the journal and its backups end with the team; --journal FILE keeps them")
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
