"""The known state of the team: messages update it, drawings and tables read it. No browser, no I/O."""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from robrain.algorithms.mapping.patch_cells import cells_of
from robrain.dashboard.state.shown_robot import ShownMote, ShownRecorder, ShownRobot
from robrain.protocol.border.border import Received
from robrain.protocol.border.reading_sieve import ReadingSieve, measured_at_ns
from robrain.protocol.messages.maps.map_messages import COORDINATOR_LEFT, ROBOT_MAP, ExplorationLeft, MapPatch
from robrain.protocol.messages.motes.mote_messages import MOTE_READING, MoteReading
from robrain.protocol.messages.robots import robot_messages
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, ROBOT_LOG, LogRecord, PluginEvent
from robrain.protocol.messages.robots.robot_messages import PlannedPath, RobotLinks, RobotState
from robrain.protocol.messages.tasks import plan_messages
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.tasks.plan_messages import ChargeSchedule, PlannedCharge, TaskEstimates
from robrain.protocol.messages.team import arena_messages
from robrain.protocol.messages.team.arena_messages import ArenaClock, ArenaPreparation, ArenaTruth, Scan
from robrain.protocol.messages.team.recorder_messages import RECORDER_STATE, RecorderState
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, HALT, Halt, TeamState
from robrain.protocol.messages.team.zone_messages import Zones
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.refusals import Refusal
from robrain.protocol.topic import Topic
from robrain.protocol.wire.presence import Change
from robrain.recording.drawing.drawn_map import ComposedMap, DrawnFloor, checked_geometry

HISTORY_POINTS = 400
HISTORY_STEP_S = 1.0
LOG_LINES = 100
LINKS = 200
RECORDERS = 20
Names = Mapping[str, str]
PLAN_S = 5.0
"""Time for which a run's floor plan is drawn if no map comes, in seconds of the run."""
RESTART_S = 1.0
"""An arena clock that falls back by more than this begins another run."""


OPEN_TASKS = 1000
ENDED_TASKS = 200
SPANS = 60
"""Number of spans that are kept for each robot."""


@dataclass
class Span:
    """A time in which a robot worked on a task, run's clock."""

    task: str
    kind: str
    start_ns: int
    end_ns: int | None = None
    state: TaskState = TaskState.RUNNING


@dataclass
class TaskBoard:
    """Tracks tasks by their events; all its memory is bounded."""

    open: dict[str, TaskEvent] = field(default_factory=dict)
    """The last event of every task that has not ended, oldest change first."""
    ended: deque[TaskEvent] = field(default_factory=lambda: deque(maxlen=ENDED_TASKS))
    """The last event of the tasks that have ended, oldest first."""
    spans: dict[str, deque[Span]] = field(default_factory=dict)
    """By robot."""
    estimates: TaskEstimates = field(default_factory=TaskEstimates)
    """The last estimates of the open tasks."""
    newest_ns: int = 0
    """The latest stamp of all events."""
    _running: dict[str, tuple[str, Span]] = field(default_factory=dict)

    def handle(self, event: TaskEvent) -> None:
        """Process an event; a repeated one changes nothing."""
        task = event.task.id
        known = self.open.pop(task, None)
        if event.state.ended:
            if any(other.task.id == task and other.change == event.change for other in self.ended):
                return
            self.ended.append(event)
        elif known is not None and known.change > event.change > 0:
            self.open[task] = known
            return
        else:
            self.open[task] = event
            while len(self.open) > OPEN_TASKS:
                del self.open[next(iter(self.open))]
        self.newest_ns = max(self.newest_ns, event.stamp_ns)
        self._add_to_span(event)

    def _add_to_span(self, event: TaskEvent) -> None:
        task, running = event.task.id, event.state in (TaskState.RUNNING, TaskState.LOST_CONTACT)
        robot, span = self._running.get(task, ("", None))
        if span is not None and not (running and robot == event.robot):
            span.end_ns, span.state = event.stamp_ns, event.state
            del self._running[task]
            span = None
        if not running or not event.robot:
            return
        if span is None:
            span = Span(task, event.task.kind, event.stamp_ns)
            self._running[task] = event.robot, span
            self.spans.setdefault(event.robot, deque(maxlen=SPANS)).append(span)
        span.state = event.state


RATE_WINDOW_S = 4.0

NO_ZONES = Zones(zones=[])


class RateMeter:
    """Growth of a total per second of the caller's clock, over a sliding window."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque()

    def add(self, now_s: float, total: float) -> None:
        """Add a sample of the total; a total that shrank restarts the meter."""
        if self._samples and total < self._samples[-1][1]:
            self._samples.clear()
        self._samples.append((now_s, total))
        while len(self._samples) > 2 and self._samples[1][0] <= now_s - RATE_WINDOW_S:
            self._samples.popleft()

    @property
    def per_s(self) -> float | None:
        """Growth per second; None while the samples span less than half a second."""
        if not self._samples:
            return None
        first_s, first = self._samples[0]
        last_s, last = self._samples[-1]
        if last_s - first_s < 0.5:
            return None
        return (last - first) / (last_s - first_s)


class FloorVersion(NamedTuple):
    """Changes with each part of the drawn floor."""

    run: int
    map: int
    is_plan: bool


class ShownTeam:
    """The state of the team according to its messages.

    `now_s` is always in seconds of one monotonic clock of the caller.
    """

    def __init__(self) -> None:
        self.robots: dict[str, ShownRobot] = {}
        self.robot_numbers: dict[str, int] = {}
        """Numbers of the looks of robots from an earlier view; other robots are numbered as they appear."""
        self.motes: dict[str, ShownMote] = {}
        self.board = TaskBoard()
        self.log: deque[LogRecord] = deque(maxlen=LOG_LINES)
        """The latest log records of all robots, oldest first."""
        self.recorders: dict[str, ShownRecorder] = {}
        self.map = ComposedMap()
        self.team: TeamState | None = None
        self.left: ExplorationLeft | None = None
        """Regions that exploration has left, as last published; None until it has ended once."""
        self.truth: ArenaTruth | None = None
        self.preparation: ArenaPreparation | None = None
        """Set while a lockstep run waits for its navigation to be compiled; None once it has begun."""
        self._plan: DrawnFloor | None = None
        """The floor plan, until the team's map has begun; kept for `PLAN_S` of a run at the longest."""
        self.halt: Halt | None = None
        self.sim_time_s: float | None = None
        self.connected = True
        """Whether the dashboard's own session has a link; without one the view is out of date."""
        self.is_replay = False
        """Whether the messages come from a recording."""
        self.coordinator_up = False
        self.chargers: tuple[Point2D, ...] = ()
        """Known places where robots can charge, arena frame."""
        self.charges: tuple[PlannedCharge, ...] = ()
        """The charges that the coordinator plans."""
        self.selected: frozenset[str] = frozenset()
        """Names of the robots that are selected in a browser."""
        self.explored: list[tuple[float, float]] = []
        """Arena time in seconds and explored share, 0 to 1; over the whole run, ever coarser."""
        self.team_seen_s: float | None = None
        """Arrival time of the coordinator's last summary, on the caller's clock."""
        self.rejected = 0
        """Number of messages that decoded but had impossible values."""
        self.refused: list[Refusal] = []
        """Messages that broke the contract of their topic, largest count first."""
        self.map_refused_s: float | None = None
        """Time of the last rejected map patch, on the caller's clock."""
        self.runs = 1
        """Runs seen: grows when the arena's clock starts over."""
        self._explored_step_s = HISTORY_STEP_S
        self._sieve = ReadingSieve()
        self._speed = RateMeter()
        self._traffic = RateMeter()
        handlers: dict[Topic[Any], Callable[[Any, Names, float], None]] = {
            robot_messages.ROBOT_STATE: self._handle_state,
            ROBOT_MAP: self._handle_patch,
            robot_messages.ROBOT_PATH: self._handle_path,
            robot_messages.ROBOT_LINKS: self._handle_links,
            ROBOT_EVENT: self._handle_event,
            ROBOT_LOG: self._handle_log,
            MOTE_READING: self._handle_reading,
            TASK_EVENT: self._handle_task,
            plan_messages.TASK_ESTIMATES: self._handle_estimates,
            COORDINATOR_STATE: self._handle_team,
            plan_messages.COORDINATOR_CHARGES: self._handle_charges,
            COORDINATOR_LEFT: self._handle_left,
            RECORDER_STATE: self._handle_recorder,
            HALT: self._handle_halt,
            arena_messages.ARENA_SCAN: self._handle_scan,
            arena_messages.ARENA_CLOCK: self._handle_clock,
            arena_messages.ARENA_TRUTH: self._handle_truth,
            arena_messages.ARENA_PREPARATION: self._handle_preparation,
        }
        self.others: dict[str, Any] = {}
        """The last message of each key of other topics, for parts of the page that read them."""
        self.topics = tuple(handlers)
        """The topics that `apply` understands."""
        self._handlers = {topic.name: handler for topic, handler in handlers.items()}

    @property
    def zones(self) -> Zones:
        """The team's zones, as they were last published."""
        return next((message for message in self.others.values() if isinstance(message, Zones)), NO_ZONES)

    def apply(self, received: Received, now_s: float) -> None:
        """Process a message; other topics are only kept, and a message with impossible values counts as `rejected`."""
        handler = self._handlers.get(received.topic.name)
        if handler is None:
            self.others[received.key] = received.message
            return
        try:
            handler(received.message, received.names, now_s)
        except ValueError:
            self.rejected += 1
            if received.topic is ROBOT_MAP:
                self.map_refused_s = now_s

    def apply_presence(self, change: Change) -> bool:
        """Process a robot's liveliness token; returns whether the robot has appeared."""
        self._robot(change.names["robot"]).present = change.present
        return change.present

    def count_messages(self, total: int, now_s: float) -> None:
        """Set the number of messages that have arrived since the start."""
        self._traffic.add(now_s, total)

    @property
    def floor(self) -> DrawnFloor | None:
        """The floor to draw: the team's map, or until there is one the floor plan; None if neither is known."""
        return self.map.floor if self._plan is None else self._plan

    @property
    def floor_geometry(self) -> GridGeometry | None:
        """The grid of that floor."""
        if self._plan is not None:
            return self._plan.geometry
        return None if self.map.grid is None else self.map.grid.geometry

    @property
    def floor_version(self) -> FloorVersion:
        """Version of the drawn floor."""
        return FloorVersion(self.runs, self.map.version, self._plan is not None)

    @property
    def explored_fraction(self) -> float | None:
        """Share of the reachable floor that is known, 0 to 1; None without an arena."""
        return None if self.truth is None else self.truth.explored_fraction

    @property
    def known_area_m2(self) -> float:
        """Area known to the coordinator, or to the dashboard if the coordinator is away."""
        if self.team is not None and self.coordinator_up:
            return self.team.known_area_m2
        return self.map.known_area_m2

    @property
    def speed(self) -> float | None:
        """Simulated seconds per second of wall time; None without an arena."""
        return self._speed.per_s

    @property
    def messages_per_s(self) -> float | None:
        """Messages that arrive per second; None in the first half second."""
        return self._traffic.per_s

    @property
    def tasks(self) -> dict[str, TaskEvent]:
        """The last event of every task that has not ended."""
        return self.board.open

    @property
    def halted(self) -> bool:
        """Whether the last halt message is in force; without one, whether any robot is halted."""
        if self.halt is not None:
            return self.halt.halted
        return any(robot.halted for robot in self.robots.values())

    def robots_in_order(self) -> list[ShownRobot]:
        """All robots in the order in which they appeared."""
        return list(self.robots.values())

    def goal_of(self, robot: ShownRobot) -> Point2D | None:
        """The place of its task, else the end of its path; arena frame."""
        status = robot.state.task if robot.state is not None else None
        event = self.tasks.get(status.id) if status is not None and not status.state.ended else None
        if event is not None:
            return event.task.place
        return robot.path[-1] if robot.path else None

    def _handle_state(self, state: RobotState, names: Names, now_s: float) -> None:
        self._robot(names["robot"]).handle_state(state, now_s)

    def _handle_patch(self, patch: MapPatch, names: Names, now_s: float) -> None:
        self.map.merge(patch)
        self._plan = None

    def _handle_path(self, path: PlannedPath, names: Names, now_s: float) -> None:
        self._robot(names["robot"]).path = path.points

    def _handle_links(self, links: RobotLinks, names: Names, now_s: float) -> None:
        self._robot(names["robot"]).links = links.links[:LINKS]

    def _handle_scan(self, scan: Scan, names: Names, now_s: float) -> None:
        self._robot(names["robot"]).scan = scan

    def _handle_reading(self, reading: MoteReading, names: Names, now_s: float) -> None:
        mote = self._mote(names["mote"])
        mote.receive(reading)
        if not self._sieve.is_new(reading):
            return
        before = mote.readings.get(reading.quantity)
        if before is None or measured_at_ns(before) <= measured_at_ns(reading):  # else it comes out of the mote's log
            mote.readings[reading.quantity] = reading

    def _handle_task(self, event: TaskEvent, names: Names, now_s: float) -> None:
        self.board.handle(event)

    def _handle_estimates(self, estimates: TaskEstimates, names: Names, now_s: float) -> None:
        self.board.estimates = estimates

    def _handle_event(self, event: PluginEvent, names: Names, now_s: float) -> None:
        self._robot(names["robot"]).events.append(event)

    def _handle_log(self, record: LogRecord, names: Names, now_s: float) -> None:
        self.log.append(record)

    def _handle_team(self, team: TeamState, names: Names, now_s: float) -> None:
        self.team, self.team_seen_s = team, now_s
        listed = {summary.name for summary in team.robots}
        for name in [name for name, view in self.robots.items() if name not in listed and view.has_gone]:
            del self.robots[name]
        for summary in team.robots:
            self._robot(summary.name).summary = summary

    def _handle_charges(self, schedule: ChargeSchedule, names: Names, now_s: float) -> None:
        self.charges = schedule.charges

    def _handle_left(self, left: ExplorationLeft, names: Names, now_s: float) -> None:
        self.left = left

    def _handle_recorder(self, state: RecorderState, names: Names, now_s: float) -> None:
        name = names["recorder"]
        if name not in self.recorders:  # it may succeed recorders that ended silently
            self.recorders = {other: view for other, view in self.recorders.items() if not view.is_silent(now_s)}
        if name in self.recorders or len(self.recorders) < RECORDERS:
            self.recorders.setdefault(name, ShownRecorder(name)).handle(state, now_s)

    def _handle_halt(self, halt: Halt, names: Names, now_s: float) -> None:
        self.halt = halt

    def _handle_clock(self, clock: ArenaClock, names: Names, now_s: float) -> None:
        self._set_time(clock.sim_time_s, now_s)

    def _handle_truth(self, truth: ArenaTruth, names: Names, now_s: float) -> None:
        self._set_time(truth.sim_time_s, now_s)
        self.truth = truth
        for robot in truth.robots:
            self._robot(robot.robot).truth = robot
        for mote in truth.motes:
            view = self._mote(mote.mote)
            view.place = view.place or mote.place
        if not self.explored or truth.sim_time_s - self.explored[-1][0] >= self._explored_step_s:
            self.explored.append((truth.sim_time_s, truth.explored_fraction))
        if len(self.explored) > HISTORY_POINTS:
            self.explored = self.explored[::2]
            self._explored_step_s *= 2

    def _handle_preparation(self, preparation: ArenaPreparation, names: Names, now_s: float) -> None:
        if self.sim_time_s is not None:
            return
        truth = preparation.truth
        if self._plan is None:
            self._plan = _plan_of(preparation.floor)
        self.preparation = preparation
        for robot in truth.robots:
            self._robot(robot.robot).start = robot.pose
        for mote in truth.motes:
            self._mote(mote.mote).place = mote.place

    def _set_time(self, sim_time_s: float, now_s: float) -> None:
        if self.preparation is not None:
            self.preparation = None
            for robot in self.robots.values():
                robot.start = None
        if self.sim_time_s is not None and sim_time_s < self.sim_time_s - RESTART_S:
            self._forget_run()
        self.sim_time_s = max(sim_time_s, self.sim_time_s or 0.0)
        if self.sim_time_s > PLAN_S:
            self._plan = None
        self._speed.add(now_s, self.sim_time_s)

    def _forget_run(self) -> None:
        """Clear all but the robots, as another run has begun."""
        self.runs += 1
        self.map = ComposedMap()
        self.motes.clear()
        self.board = TaskBoard()
        self.log.clear()
        self.explored.clear()
        self._explored_step_s = HISTORY_STEP_S
        self._sieve = ReadingSieve()
        self.truth = self.team = self.halt = self.sim_time_s = None
        self.charges = ()
        self.left = None
        for robot in self.robots.values():
            robot.forget_run()

    def _robot(self, name: str) -> ShownRobot:
        robot = self.robots.get(name)
        if robot is None:
            robot = self.robots[name] = ShownRobot(name, self.robot_numbers.get(name, len(self.robots)))
        return robot

    def _mote(self, name: str) -> ShownMote:
        mote = self.motes.get(name)
        if mote is None:
            mote = self.motes[name] = ShownMote(name)
        return mote


def _plan_of(patch: MapPatch) -> DrawnFloor:
    """A floor plan (ValueError if its cells do not fill its grid)."""
    geometry, cells = checked_geometry(patch), cells_of(patch)
    if cells.shape != geometry.shape:
        raise ValueError(f"expected a plan of {geometry.shape} cells, got {cells.shape}")
    return DrawnFloor(geometry, cells)
