"""The data of one run for reports: its messages, read once and gathered by robot, mote and task."""

from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from robrain.protocol.clock import to_seconds
from robrain.protocol.messages.maps.map_messages import ExplorationLeft, MapPatch
from robrain.protocol.messages.motes.mote_messages import MoteFieldState, MoteReading
from robrain.protocol.messages.robots.plugin_messages import LogRecord
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.plan_messages import TaskEstimates
from robrain.protocol.messages.team.arena_messages import ArenaTruth
from robrain.protocol.messages.team.team_messages import Halt, TeamState
from robrain.protocol.model.accuracy import MapAccuracy, PoseAccuracy
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import EXPLORE, RECHARGE
from robrain.protocol.model.tasks.task import TaskState
from robrain.recording.drawing.drawn_map import ComposedMap
from robrain.recording.drawing.robot_history import model_power_w
from robrain.recording.provenance import SCENARIO_ATTACHMENT
from robrain.recording.reader.contents import RecordingContents, half, read_contents
from robrain.recording.reader.reading import read_front, read_messages
from robrain.recording.reader.recorded_message import received

SILENT_S = 3.0
"""A robot that publishes nothing for longer than this is silent; its state comes ten times a second."""
HAPPENINGS_MAX = 5000
BAD_LEVELS = ("error", "critical")


class Happening(msgspec.Struct, kw_only=True):
    """A fault of a run. All texts are of the wire: not escaped."""

    kind: str
    """halted, faulted, astray, silent, distrusted, task, log or team halt."""
    subject: str
    text: str
    start_s: float
    end_s: float | None = None
    """Time of its recovery; None without one, or for a fault without a duration."""
    lasts: bool = True
    """Whether it has a duration."""


class Happenings:
    """Follows the messages of a run, in order."""

    def __init__(self) -> None:
        self._all: list[Happening] = []
        self._open: dict[tuple[str, str], Happening] = {}
        self._last_seen_s: dict[str, float] = {}

    def handle(self, message: Any, t_s: float) -> None:
        """The next message; most are of no interest."""
        if isinstance(message, RobotState):
            self._handle_state(message, t_s)
        elif isinstance(message, TaskEvent):
            if message.state in ("failed", "lost_contact"):
                words = message.state.replace("_", " ") + (f": {message.why}" if message.why else "")
                self._point("task", message.task.id, words, t_s)
        elif isinstance(message, Halt):
            reason = f"by {message.by}" + (f": {message.reason}" if message.reason else "")
            self._follow("team halt", "team", "", reason if message.halted else "", t_s)
        elif isinstance(message, LogRecord) and message.level.lower() in BAD_LEVELS:
            self._point("log", f"{message.robot} {message.source}", message.text, t_s)

    def finish(self, end_s: float) -> list[Happening]:
        """All of them, by their beginnings; robots that were silent until the end included."""
        for robot, last_seen_s in self._last_seen_s.items():
            if end_s - last_seen_s > SILENT_S:
                self._begin("silent", robot, "", "said nothing until the end", last_seen_s)
        return sorted(self._all, key=lambda happening: happening.start_s)

    def _handle_state(self, state: RobotState, t_s: float) -> None:
        name = state.robot
        last_seen_s = self._last_seen_s.get(name, t_s)
        self._last_seen_s[name] = t_s
        if t_s - last_seen_s > SILENT_S:
            silent = Happening(kind="silent", subject=name, text="said nothing", start_s=last_seen_s, end_s=t_s)
            self._add(silent)
        self._follow("halted", name, "", f"by {', '.join(state.halted_by)}" if state.halted else "", t_s)
        self._follow("astray", name, "", state.lost, t_s)
        distrusted = state.battery.implausible if state.battery is not None else ""
        self._follow("distrusted", name, "", distrusted, t_s)
        faulted = {fault.plugin: fault.why or "does not run" for fault in state.faulted}
        for kind, key in [key for key in self._open if key[0] == "faulted" and key[1].startswith(f"{name}/")]:
            if key.partition("/")[2] not in faulted:
                self._open.pop((kind, key)).end_s = t_s
        for plugin, reason in faulted.items():
            self._follow("faulted", name, plugin, reason, t_s)

    def _follow(self, kind: str, subject: str, part: str, text: str, t_s: float) -> None:
        """A state that begins with a text, and ends when it is empty."""
        happening = self._open.get((kind, f"{subject}/{part}"))
        if text and happening is None:
            self._begin(kind, subject, part, text, t_s)
        elif not text and happening is not None:
            del self._open[kind, f"{subject}/{part}"]
            happening.end_s = t_s

    def _begin(self, kind: str, subject: str, part: str, text: str, t_s: float) -> None:
        words = f"{part}: {text}" if part else text
        happening = Happening(kind=kind, subject=subject, text=words, start_s=t_s)
        self._open[kind, f"{subject}/{part}"] = happening
        self._add(happening)

    def _point(self, kind: str, subject: str, text: str, t_s: float) -> None:
        self._add(Happening(kind=kind, subject=subject, text=text, start_s=t_s, lasts=False))

    def _add(self, happening: Happening) -> None:
        if len(self._all) < HAPPENINGS_MAX:
            self._all.append(happening)


STEP_S = 0.2
"""States of a robot closer together than this are not kept one by one."""
LONGEST_STEP_S = 5.0
"""Two states farther apart than this have a gap between them, in which energy is not reckoned."""


@dataclass
class RobotRun:
    """One robot through the run; arrays grow together, times in seconds of the run."""

    name: str
    t_s: "array[float]" = field(default_factory=lambda: array("d"))
    x_m: "array[float]" = field(default_factory=lambda: array("d"))
    y_m: "array[float]" = field(default_factory=lambda: array("d"))
    soc: "array[float]" = field(default_factory=lambda: array("d"))
    soc_sd: "array[float]" = field(default_factory=lambda: array("d"))
    measured_j: "array[float]" = field(default_factory=lambda: array("d"))
    """Since the beginning, at the battery's terminals."""
    predicted_j: "array[float]" = field(default_factory=lambda: array("d"))
    """The same by the robot's own model of its motion's energy."""
    agreement: "array[float]" = field(default_factory=lambda: array("d"))
    """Share of its beams that agree with its map, 0 to 1; nan where not reported."""
    accuracy: PoseAccuracy | None = None
    """Accuracy of its poses at the end; None without ground truth."""
    error_t_s: "array[float]" = field(default_factory=lambda: array("d"))
    error_m: "array[float]" = field(default_factory=lambda: array("d"))
    """Position error at these times by the ground truth; nan while the robot reported that it was lost."""
    is_silently_off: "array[int]" = field(default_factory=lambda: array("b"))
    """Whether it diverged silently at these times, 0 or 1."""
    distance_m: float | None = None
    """By the arena, as the next two; None without one."""
    energy_j: float | None = None
    collisions: int | None = None
    before: RobotState | None = None


@dataclass
class TaskRun:
    """One task through the run."""

    name: str
    kind: str
    state: str
    robot: str = ""
    queued_s: float = 0.0
    started_s: float | None = None
    ended_s: float | None = None
    reason: str = ""
    predicted_j: float | None = None
    """Energy that the plan predicted for the robot that did it."""
    measured_j: float | None = None
    """Energy that it took, as that robot reported."""
    spans: list[tuple[str, float, float | None]] = field(default_factory=list)
    """Robot, beginning and end of each time that a robot was at it."""


@dataclass
class MoteRun:
    """One mote through the run."""

    name: str
    place: Point2D | None = None
    t_s: "array[float]" = field(default_factory=lambda: array("d"))
    voltage_v: "array[float]" = field(default_factory=lambda: array("d"))


OWN_KINDS = (EXPLORE, RECHARGE)
"""Kinds of the coordinator's own tasks, which are not counted as tasks of the run."""


@dataclass
class RunData:
    """One run."""

    path: Path
    contents: RecordingContents
    duration_s: float
    explored: list[tuple[float, float]] = field(default_factory=list)
    """Time and explored share, 0 to 1, by the arena."""
    known_m2: list[tuple[float, float]] = field(default_factory=list)
    """Time and known area, by the coordinator."""
    mote_field: MoteFieldState | None = None
    """Status of the motes at the end, by the coordinator; None if it did no work for them on its own initiative."""
    left: ExplorationLeft | None = None
    """Regions that exploration left, as last published by the coordinator; None if it never did."""
    map_accuracy: list[tuple[float, MapAccuracy]] = field(default_factory=list)
    """Time and accuracy of the team's map by the ground truth; one entry for each change."""
    robots: dict[str, RobotRun] = field(default_factory=dict)
    motes: dict[str, MoteRun] = field(default_factory=dict)
    tasks: dict[str, TaskRun] = field(default_factory=dict)
    map: ComposedMap = field(default_factory=ComposedMap)
    happenings: list[Happening] = field(default_factory=list)
    scenario_toml: bytes = b""
    """Scenario file of the run; empty if there is none in the recording."""

    @property
    def name(self) -> str:
        """Name of the file without its ending."""
        return self.path.stem

    @property
    def asked(self) -> list[TaskRun]:
        """The tasks that people, scripts and rules asked for."""
        return [task for task in self.tasks.values() if task.kind not in OWN_KINDS]

    def count(self, state: TaskState) -> int:
        """The number of `asked` tasks in a state at the end of the recording."""
        return sum(task.state == state for task in self.asked)


def read_run(path: Path, on_progress: Callable[[float], None] | None = None) -> RunData:
    """Read a recording for a report.

    Raises:
        RecordingError: it cannot be read.
    """
    contents = read_contents(path, half(on_progress, 0.0))
    _, attachments = read_front(path)
    scenario_toml = attachments.get(SCENARIO_ATTACHMENT, b"")
    gather = _Gather(RunData(path, contents, contents.info.duration_s, scenario_toml=scenario_toml))
    start_ns = contents.info.start_ns
    for recorded in read_messages(path, half(on_progress, 0.5)):
        known = received(recorded)
        if known is not None:
            gather.handle(known.message, to_seconds(recorded.log_time_ns - start_ns))
    return gather.finish()


class _Gather:
    def __init__(self, run: RunData) -> None:
        self.run = run
        self._happenings = Happenings()
        self._expected_j: dict[str, float] = {}
        """Of the open tasks."""
        self._handlers: dict[type, Callable[[Any, float], None]] = {
            RobotState: self._handle_state,
            ArenaTruth: self._handle_truth,
            TeamState: self._handle_team,
            ExplorationLeft: self._handle_left,
            MapPatch: self._handle_patch,
            MoteReading: self._handle_reading,
            TaskEvent: self._handle_task,
            TaskEstimates: self._handle_estimates,
        }

    def handle(self, message: Any, t_s: float) -> None:
        handler = self._handlers.get(type(message))
        if handler is not None:
            handler(message, t_s)
        self._happenings.handle(message, t_s)

    def finish(self) -> RunData:
        run = self.run
        run.happenings = self._happenings.finish(run.duration_s)
        for task in run.tasks.values():
            task.spans = [(robot, start, run.duration_s if end is None else end) for robot, start, end in task.spans]
        return run

    def _handle_state(self, state: RobotState, t_s: float) -> None:
        robot = self.run.robots.setdefault(state.robot, RobotRun(state.robot))
        before = robot.before
        if before is not None and t_s - robot.t_s[-1] < STEP_S:
            return
        robot.before = state
        measured_j = robot.measured_j[-1] if robot.measured_j else 0.0
        predicted_j = robot.predicted_j[-1] if robot.predicted_j else 0.0
        if before is not None and (passed_s := t_s - robot.t_s[-1]) <= LONGEST_STEP_S:
            if before.battery is not None:
                measured_j += before.battery.voltage_v * before.battery.current_a * passed_s
            if before.energy is not None:
                predicted_j += model_power_w(before.energy, before.velocity) * passed_s
            elif before.battery is not None:  # before it has a model, there is no prediction and no comparison
                predicted_j = measured_j
        nan = float("nan")
        robot.t_s.append(t_s)
        robot.x_m.append(state.pose.x_m if state.pose is not None else nan)
        robot.y_m.append(state.pose.y_m if state.pose is not None else nan)
        robot.soc.append(state.battery.soc if state.battery is not None else nan)
        robot.soc_sd.append(state.battery.soc_sd if state.battery is not None else nan)
        robot.agreement.append(state.map_agreement if state.map_agreement is not None else nan)
        robot.measured_j.append(measured_j)
        robot.predicted_j.append(predicted_j)

    def _handle_truth(self, truth: ArenaTruth, t_s: float) -> None:
        self.run.explored.append((t_s, truth.explored_fraction))
        of_map = self.run.map_accuracy
        if truth.map_accuracy is not None and (not of_map or of_map[-1][1] != truth.map_accuracy):
            of_map.append((t_s, truth.map_accuracy))
        for reported in truth.robots:
            robot = self.run.robots.setdefault(reported.robot, RobotRun(reported.robot))
            robot.distance_m, robot.energy_j = reported.distance_m, reported.energy_j
            robot.collisions = reported.collisions
            accuracy = robot.accuracy = reported.accuracy
            if accuracy is not None and accuracy.error_m is not None:
                robot.error_t_s.append(t_s)
                robot.error_m.append(float("nan") if accuracy.is_lost else accuracy.error_m)
                robot.is_silently_off.append(accuracy.silent_for_s > 0)

    def _handle_team(self, team: TeamState, t_s: float) -> None:
        self.run.known_m2.append((t_s, team.known_area_m2))
        if team.mote_field:
            self.run.mote_field = team.mote_field

    def _handle_left(self, left: ExplorationLeft, _t_s: float) -> None:
        self.run.left = left

    def _handle_patch(self, patch: MapPatch, _t_s: float) -> None:
        try:
            self.run.map.merge(patch)
        except ValueError:  # it fits no map; its receivers refused it as well
            return

    def _handle_reading(self, reading: MoteReading, t_s: float) -> None:
        mote = self.run.motes.setdefault(reading.mote, MoteRun(reading.mote))
        mote.place = reading.place or mote.place
        mote.t_s.append(t_s)
        mote.voltage_v.append(reading.voltage_v)

    def _handle_estimates(self, estimates: TaskEstimates, _t_s: float) -> None:
        self._expected_j = {one.task: one.energy_j for one in estimates.tasks}

    def _handle_task(self, event: TaskEvent, t_s: float) -> None:
        name = event.task.id
        task = self.run.tasks.get(name)
        if task is None:
            task = self.run.tasks[name] = TaskRun(name, event.task.kind, event.state, queued_s=t_s)
        task.state, task.reason = event.state, event.why
        task.robot = event.robot or task.robot
        if task.spans and task.spans[-1][2] is None and (event.state != "running" or event.robot != task.spans[-1][0]):
            robot, start, _ = task.spans[-1]
            task.spans[-1] = (robot, start, t_s)
        if event.state == "running" and event.robot and (not task.spans or task.spans[-1][2] is not None):
            task.spans.append((event.robot, t_s, None))
            task.started_s = t_s if task.started_s is None else task.started_s
            task.predicted_j = self._expected_j.get(name, task.predicted_j)
        if event.state.ended:
            task.ended_s = t_s
            spent = event.result.get("energy_j")
            task.measured_j = float(spent) if isinstance(spent, (int, float)) else None
