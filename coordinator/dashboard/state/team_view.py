"""What the dashboard knows of its team: messages come in, drawings and tables read it. No browser, no I/O."""

import math
from collections import deque
from collections.abc import Callable
from typing import Any

from robrain.coordinator.dashboard.state.rate_meter import RateMeter
from robrain.coordinator.dashboard.state.recorder_view import RecorderView
from robrain.coordinator.dashboard.state.robot_view import MoteView, RobotView
from robrain.coordinator.dashboard.state.task_board import TaskBoard
from robrain.coordinator.drawing.map_view import FAR_M, MapView
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.wire.border.border import Received
from robrain.protocol.wire.border.reading_sieve import ReadingSieve, taken_at_ns
from robrain.protocol.wire.border.refusals import Refusal
from robrain.protocol.wire.messages.arena_messages import ArenaClock, ArenaTruth, Scan
from robrain.protocol.wire.messages.map_messages import MapPatch
from robrain.protocol.wire.messages.mote_messages import MoteReading
from robrain.protocol.wire.messages.offer_messages import TaskEvent
from robrain.protocol.wire.messages.plan_messages import ChargeSchedule, PlannedCharge
from robrain.protocol.wire.messages.plugin_messages import Event, LogRecord
from robrain.protocol.wire.messages.recorder_messages import RecorderState
from robrain.protocol.wire.messages.robot_messages import PlannedPath, RobotLinks, RobotState
from robrain.protocol.wire.messages.team_messages import Halt, TeamState
from robrain.protocol.wire.presence import Change
from robrain.protocol.wire.topic import Topic
from robrain.protocol.wire.topics import (
    ARENA_CLOCK,
    ARENA_SCAN,
    ARENA_TRUTH,
    COORDINATOR_CHARGES,
    COORDINATOR_STATE,
    HALT,
    MOTE_READING,
    RECORDER_STATE,
    ROBOT_EVENT,
    ROBOT_LINKS,
    ROBOT_LOG,
    ROBOT_MAP,
    ROBOT_PATH,
    ROBOT_STATE,
    TASK_DECISION,
    TASK_EVENT,
)

HISTORY_POINTS = 400
HISTORY_STEP_S = 1.0
LOG_LINES = 100
LINKS = 200
RECORDERS = 20
FAR_MM = round(FAR_M * 1000)
FULL_TURN_RAD = 2 * math.pi
RESTART_S = 1.0
"""An arena clock that falls back by more than this tells of another run."""


class TeamView:
    """The team as its messages tell it.

    Times called `now_s` are seconds of one steady clock of the caller's.
    """

    def __init__(self) -> None:
        self.robots: dict[str, RobotView] = {}
        self.look_order: dict[str, int] = {}
        """Which look robots have that are to keep the one of an earlier view; others get theirs as they appear."""
        self.motes: dict[str, MoteView] = {}
        self.board = TaskBoard()
        self.log: deque[LogRecord] = deque(maxlen=LOG_LINES)
        """What robots told last, oldest first."""
        self.recorders: dict[str, RecorderView] = {}
        self.map = MapView()
        self.team: TeamState | None = None
        self.truth: ArenaTruth | None = None
        self.halt: Halt | None = None
        self.sim_time_s: float | None = None
        self.connected = True
        """Whether the dashboard's own session has a link; without one nothing here is to be trusted."""
        self.is_replay = False
        """Whether all this comes out of a recording."""
        self.coordinator_up = False
        self.chargers: tuple[Point2D, ...] = ()
        """Where robots can charge, arena frame, as far as anybody has told."""
        self.charges: tuple[PlannedCharge, ...] = ()
        """Who charges where and when, as the coordinator foresees it."""
        self.selected: frozenset[str] = frozenset()
        """Robots that somebody who looks on has selected."""
        self.explored: list[tuple[float, float]] = []
        """Arena time in seconds and explored share, 0 to 1; over the whole run, ever coarser."""
        self.team_heard_s: float | None = None
        """When the last summary of the coordinator arrived, on the caller's clock."""
        self.rejected = 0
        """Messages that decoded but made no sense."""
        self.refused: list[Refusal] = []
        """Messages that broke the contract of their topic, largest count first."""
        self.map_refused_s: float | None = None
        """When a map patch was last rejected, on the caller's clock."""
        self.runs = 1
        """Runs seen: grows when the arena's clock starts over."""
        self._explored_step_s = HISTORY_STEP_S
        self._sieve = ReadingSieve()
        self._speed = RateMeter()
        self._traffic = RateMeter()
        self._takers: dict[str, Callable[[Received, float], None]] = {topic.name: take for topic, take in self._table()}

    # -- what comes in --------------------------------------------------------------------------------------

    @property
    def topics(self) -> tuple[Topic[Any], ...]:
        """The topics that `apply` understands."""
        return tuple(topic for topic, _ in self._table())

    def apply(self, received: Received, now_s: float) -> None:
        """Take in a message; one of another topic is left out, one that makes no sense counts as `rejected`."""
        take = self._takers.get(received.topic.name)
        if take is None:
            return
        try:
            take(received, now_s)
        except ValueError:
            self.rejected += 1
            if received.topic is ROBOT_MAP:
                self.map_refused_s = now_s

    def apply_presence(self, change: Change) -> bool:
        """Take in a robot's token that came or went; returns whether a robot has come."""
        self._robot(change.names["robot"]).present = change.present
        return change.present

    def count_messages(self, total: int, now_s: float) -> None:
        """Take in how many messages have arrived since the start."""
        self._traffic.add(now_s, total)

    # -- what is known --------------------------------------------------------------------------------------

    @property
    def explored_fraction(self) -> float | None:
        """Share of the reachable floor that is known, 0 to 1, where an arena tells it."""
        return None if self.truth is None else self.truth.explored_fraction

    @property
    def known_area_m2(self) -> float:
        """Area known to the coordinator, or to the dashboard where there is none."""
        if self.team is not None and self.coordinator_up:
            return self.team.known_area_m2
        return self.map.known_area_m2

    @property
    def speed(self) -> float | None:
        """Seconds of the arena per second of the wall; None where no arena tells its time."""
        return self._speed.per_s

    @property
    def messages_per_s(self) -> float | None:
        """Messages that arrive in a second, or None in the first moments."""
        return self._traffic.per_s

    @property
    def tasks(self) -> dict[str, TaskEvent]:
        """The last event of every task that has not ended."""
        return self.board.open

    @property
    def halted(self) -> bool:
        """Whether the last word on the team is a halt, or, where none was heard, any robot stands halted."""
        if self.halt is not None:
            return self.halt.halted
        return any(robot.halted for robot in self.robots.values())

    def robots_in_order(self) -> list[RobotView]:
        """By the order in which they appeared."""
        return list(self.robots.values())

    def goal_of(self, robot: RobotView) -> Point2D | None:
        """Where it is sent by a task, else where its path ends; arena frame."""
        status = robot.state.task if robot.state is not None else None
        event = self.tasks.get(status.id) if status is not None and not status.state.ended else None
        if event is not None:
            return event.task.place
        return robot.path[-1] if robot.path else None

    # -- one topic each -------------------------------------------------------------------------------------

    def _table(self) -> tuple[tuple[Topic[Any], Callable[[Received, float], None]], ...]:
        return (
            (ROBOT_STATE, self._take_state),
            (ROBOT_MAP, self._take_patch),
            (ROBOT_PATH, self._take_path),
            (ROBOT_LINKS, self._take_links),
            (ROBOT_EVENT, self._take_event),
            (ROBOT_LOG, self._take_log),
            (MOTE_READING, self._take_reading),
            (TASK_EVENT, self._take_task),
            (TASK_DECISION, self._take_decision),
            (COORDINATOR_STATE, self._take_team),
            (COORDINATOR_CHARGES, self._take_charges),
            (RECORDER_STATE, self._take_recorder),
            (HALT, self._take_halt),
            (ARENA_SCAN, self._take_scan),
            (ARENA_CLOCK, self._take_clock),
            (ARENA_TRUTH, self._take_truth),
        )

    def _take_state(self, received: Received, now_s: float) -> None:
        state: RobotState = received.message
        _check_place(state.pose)
        robot = self._robot(received.names["robot"])
        robot.take_state(state, now_s)

    def _take_patch(self, received: Received, now_s: float) -> None:
        patch: MapPatch = received.message
        self.map.merge(patch)

    def _take_path(self, received: Received, now_s: float) -> None:
        path: PlannedPath = received.message
        for point in path.points:
            _check_place(point)
        self._robot(received.names["robot"]).path = path.points

    def _take_links(self, received: Received, now_s: float) -> None:
        heard: RobotLinks = received.message
        self._robot(received.names["robot"]).links = heard.links[:LINKS]

    def _take_scan(self, received: Received, now_s: float) -> None:
        scan: Scan = received.message
        if not (abs(scan.angle_min_rad) <= FULL_TURN_RAD and abs(scan.angle_increment_rad) <= FULL_TURN_RAD):
            raise ValueError(f"expected angles of a turn, got {scan.angle_min_rad} and {scan.angle_increment_rad}")
        if scan.ranges_mm and not (min(scan.ranges_mm) >= 0 and max(scan.ranges_mm) <= FAR_MM):
            raise ValueError(f"expected ranges from 0 to {FAR_MM} mm")
        self._robot(received.names["robot"]).scan = scan

    def _take_reading(self, received: Received, now_s: float) -> None:
        reading: MoteReading = received.message
        _check_place(reading.place)
        mote = self._mote(received.names["mote"])
        mote.heard(reading)
        if not self._sieve.is_new(reading):
            return
        before = mote.readings.get(reading.quantity)
        if before is None or taken_at_ns(before) <= taken_at_ns(reading):  # else it comes out of the mote's log
            mote.readings[reading.quantity] = reading

    def _take_task(self, received: Received, now_s: float) -> None:
        event: TaskEvent = received.message
        _check_place(event.task.place)
        self.board.take(event)

    def _take_decision(self, received: Received, now_s: float) -> None:
        self.board.decide(received.message)

    def _take_event(self, received: Received, now_s: float) -> None:
        event: Event = received.message
        self._robot(received.names["robot"]).events.append(event)

    def _take_log(self, received: Received, now_s: float) -> None:
        self.log.append(received.message)

    def _take_team(self, received: Received, now_s: float) -> None:
        team: TeamState = received.message
        for frontier in team.frontiers:
            _check_place(frontier.place)
        self.team, self.team_heard_s = team, now_s
        for summary in team.robots:
            self._robot(summary.name).summary = summary

    def _take_charges(self, received: Received, now_s: float) -> None:
        schedule: ChargeSchedule = received.message
        for charge in schedule.charges:
            _check_place(charge.charger)
        self.charges = schedule.charges

    def _take_recorder(self, received: Received, now_s: float) -> None:
        state: RecorderState = received.message
        name = received.names["recorder"]
        if name in self.recorders or len(self.recorders) < RECORDERS:
            self.recorders.setdefault(name, RecorderView(name)).take(state, now_s)

    def _take_halt(self, received: Received, now_s: float) -> None:
        self.halt = received.message

    def _take_clock(self, received: Received, now_s: float) -> None:
        clock: ArenaClock = received.message
        self._set_time(clock.sim_time_s, now_s)

    def _take_truth(self, received: Received, now_s: float) -> None:
        truth: ArenaTruth = received.message
        for robot in truth.robots:
            _check_place(robot.pose)
        for mote in truth.motes:
            _check_place(mote.place)
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

    def _set_time(self, sim_time_s: float, now_s: float) -> None:
        if self.sim_time_s is not None and sim_time_s < self.sim_time_s - RESTART_S:
            self._forget_run()
        self.sim_time_s = max(sim_time_s, self.sim_time_s or 0.0)
        self._speed.add(now_s, self.sim_time_s)

    def _forget_run(self) -> None:
        """Another run has begun: keep who is there, forget what was."""
        self.runs += 1
        self.map = MapView()
        self.motes.clear()
        self.board.clear()
        self.log.clear()
        self.explored.clear()
        self._explored_step_s = HISTORY_STEP_S
        self._sieve = ReadingSieve()
        self.truth = self.team = self.halt = self.sim_time_s = None
        self.charges = ()
        for robot in self.robots.values():
            robot.forget_run()

    def _robot(self, name: str) -> RobotView:
        robot = self.robots.get(name)
        if robot is None:
            robot = self.robots[name] = RobotView(name, self.look_order.get(name, len(self.robots)))
        return robot

    def _mote(self, name: str) -> MoteView:
        mote = self.motes.get(name)
        if mote is None:
            mote = self.motes[name] = MoteView(name)
        return mote


def _check_place(place: Point2D | Pose2D | None) -> None:
    if place is not None and not (abs(place.x_m) <= FAR_M and abs(place.y_m) <= FAR_M):
        raise ValueError(f"expected a place within {FAR_M:g} m, got {place}")
