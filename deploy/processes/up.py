"""`robrain up`: a whole team as processes of this machine: hub, arena, coordinator, one agent a robot."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol

import msgspec
import zenoh

from robrain.coordinator.recording.writer.provenance import Provenance
from robrain.coordinator.recording.writer.recorder import Recorder
from robrain.coordinator.team.roster import Roster
from robrain.deploy.processes.children import Children
from robrain.deploy.processes.dashboard_process import begin_dashboard
from robrain.deploy.processes.live_process import open_hub
from robrain.deploy.processes.robot_files import loadable_from_here, read_said, write_robot_files
from robrain.deploy.run.kernels import prepare_kernels
from robrain.deploy.run.planning_file import write_planning
from robrain.deploy.run.rules_file import write_rules
from robrain.protocol.model.mapping.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.errors import WireError
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.arena_messages import ArenaTruth
from robrain.protocol.wire.reasons.words import told
from robrain.protocol.wire.session import listening_at
from robrain.protocol.wire.topics import ARENA_TRUTH, COORDINATOR_ALIVE, ROBOT_ALIVE, ROBOT_STATE
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.world import manifest_texts

LOOK_PERIOD_S = 0.1


class TeamStatus(NamedTuple):
    """The team at one moment, for display."""

    robots: list[tuple[str, str]]
    """Name, and how it is in a few words."""
    coordinator_up: bool
    exited: list[tuple[str, int, str]]
    """Processes that ended by themselves: name, exit status, last line."""
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
    map_accuracy: MapAccuracy | None = None
    """Accuracy of the team's map at the end."""
    pose_accuracy: dict[str, PoseAccuracy] = {}
    """Accuracy of each robot's positions over the run."""
    serial_forwarders: dict[str, str] = {}
    """`host:port` at which each robot's base station could be reached."""


class UpOptions(NamedTuple):
    """How a team is brought up."""

    team: str
    listen: str | None = None
    """Endpoint of the hub; None uses this machine's hub endpoint, or a free port if that is taken."""
    dashboard: bool = True
    dashboard_port: int | None = None
    until_explored: float | None = None
    time_limit_s: float | None = None
    record: Path | None = None
    journal: Path | None = None
    quiet: bool = False
    """Do not report the compiling of kernels."""


class UpDisplay(Protocol):
    """Receives events while a team starts and runs."""

    def hub(self, endpoint: str, taken: str) -> None:
        """The hub listens at `endpoint`; `taken` is this machine's hub endpoint if another process has it, else ""."""

    def dashboard(self, url: str) -> None:
        """The page is served."""

    def show(self, status: TeamStatus) -> None:
        """Status of the team, ten times a second."""

    def ended(self, result: UpResult) -> None:
        """Final result of the run."""


def run_up(
    scenario: Scenario,
    scenario_argument: list[str],
    options: UpOptions,
    *,
    should_stop: Callable[[], bool],
    display: UpDisplay,
) -> UpResult:
    """Start a team, watch it, and stop it.

    Args:
        scenario: the scenario to simulate.
        scenario_argument: the command-line arguments that name the same scenario.
        options: options of the run.
        should_stop: polled ten times a second.
        display: receives events as they occur.

    Raises:
        RobrainError: a process cannot be started; the text says why.

    """
    world = scenario.world()
    hub, taken = open_hub(options.listen)
    wire = Endpoint(hub, options.team, WallClock(), Drive.LIVE)
    recorder = None
    children = Children()
    try:
        provenance = Provenance(
            scenario.name,
            scenario.toml,
            scenario.seed,
            world.map_png(),
            Drive.LIVE.value,
            options.team,
            manifest_texts(world, options.team),
        )
        recorder = Recorder(wire, options.record, provenance, visual=True) if options.record is not None else None
        watch = _Watch(wire, [robot.name for robot in world.robots], children)
        endpoint = _bound(hub)
        display.hub(endpoint, taken)
        prepare_kernels(quiet=options.quiet)  # once here, instead of in every process at the same time
        common = ["--connect", endpoint, "--team", options.team]
        with tempfile.TemporaryDirectory(prefix="robrain-") as folder, children:
            robot_files = write_robot_files(
                world, Path(folder), team=options.team, connect=endpoint, loadable=loadable_from_here(listening_at(hub))
            )
            children.start("arena", ["arena", *scenario_argument, *common])
            journal = options.journal if options.journal is not None else Path(folder) / "team.journal"
            planning = write_planning(Path(folder) / "planning.toml", scenario.planning)
            kept = ["--journal", str(journal), "--planning", str(planning)]
            if scenario.rules:
                kept += ["--rules", str(write_rules(Path(folder) / "rules.toml", scenario.rules))]
            children.start("coordinator", ["coordinator", *kept, *common])
            for path in robot_files:
                children.start(path.stem, ["agent", str(path)])
            page = None
            if options.dashboard:
                page = begin_dashboard(children, endpoint, options.team, options.dashboard_port)
            ended = ""
            while not ended:
                if page is not None and page.url:
                    display.dashboard(page.url)
                    page = None
                status = watch.look()
                if recorder is not None:
                    recorder.step()
                display.show(status)
                ended = _why_ended(status, options, interrupted=should_stop())
                time.sleep(LOOK_PERIOD_S)
        return _result(scenario, ended, status, watch, recorder, options)
    finally:
        if recorder is not None:
            recorder.close()
        wire.close()
        hub.close()


class _Watch:
    """Follows who is there."""

    def __init__(self, wire: Endpoint, expected: list[str], children: Children) -> None:
        self.truth: ArenaTruth | None = None
        self.robots_up = 0
        self._expected = expected
        self._children = children
        self._forwarders: dict[str, str] = {}
        self._clock = wire.clock
        self._roster = Roster()
        self._presence = wire.watch(ROBOT_ALIVE)
        self._coordinator = wire.watch(COORDINATOR_ALIVE)
        self._inbox = Inbox()
        wire.subscribe(self._inbox, ARENA_TRUTH)
        wire.subscribe(self._inbox, ROBOT_STATE)

    def look(self) -> TeamStatus:
        """Take in what has arrived."""
        now_ns = self._clock.now_ns()
        for change in self._presence.changes():
            self._roster.note_presence(change)
        for received in self._inbox.drain():
            if received.topic is ARENA_TRUTH:
                self.truth = received.message
            else:
                self._roster.note_state(received.message, now_ns)
        self._coordinator.changes()
        robots = []
        self.robots_up = 0
        for name in self._expected:
            robot = self._roster.robots.get(name)
            if robot is None:
                robots.append((name, "starting"))
            elif robot.is_up(now_ns):
                self.robots_up += 1
                halted = robot.state is not None and robot.state.halted
                robots.append((name, "halted" if halted else robot.state.behavior if robot.state else "up"))
            else:
                robots.append((name, told(robot.why_not_up(now_ns))))
        exited = [
            (child.name, status, next((line for line in reversed(list(child.lines)) if line.strip()), ""))
            for child in self._children.all
            if (status := child.exit_status) is not None
        ]
        truth = self.truth
        return TeamStatus(
            robots,
            bool(self._coordinator.present),
            exited,
            truth.sim_time_s if truth is not None else 0.0,
            truth.explored_fraction if truth is not None else 0.0,
            self._forwarders_told(),
        )

    def _forwarders_told(self) -> dict[str, str]:
        if len(self._forwarders) < len(self._expected):
            self._forwarders = read_said(list(self._children.all[0].lines)) if self._children.all else {}
        return self._forwarders


def _bound(hub: zenoh.Session) -> str:
    found = [endpoint for endpoint in listening_at(hub) if endpoint.startswith("tcp/")]
    if not found:
        raise WireError("the hub has no tcp/ endpoint to listen on")
    return found[0]


def _why_ended(status: TeamStatus, options: UpOptions, *, interrupted: bool) -> str:
    if interrupted:
        return "interrupted"
    if options.until_explored is not None and status.explored_fraction >= options.until_explored:
        return "explored"
    if options.time_limit_s is not None and status.sim_time_s >= options.time_limit_s:
        return "time_limit"
    if any(name == "arena" for name, _, _ in status.exited):
        return "the arena has stopped"
    return ""


def _result(
    scenario: Scenario, ended: str, status: TeamStatus, watch: _Watch, recorder: Recorder | None, options: UpOptions
) -> UpResult:
    truth = watch.truth
    robots = truth.robots if truth is not None else []
    return UpResult(
        scenario=scenario.name,
        ended=ended,
        robots_up=watch.robots_up,
        sim_time_s=status.sim_time_s,
        explored_fraction=status.explored_fraction,
        collisions=sum(robot.collisions for robot in robots),
        recording=str(options.record) if options.record is not None else None,
        messages=recorder.messages if recorder is not None else 0,
        map_accuracy=truth.map_accuracy if truth is not None else None,
        pose_accuracy={robot.robot: robot.accuracy for robot in robots if robot.accuracy is not None},
        serial_forwarders=status.forwarders,
    )
