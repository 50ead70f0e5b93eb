"""The known state of one robot, one mote and one recorder."""

from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum

from msgspec import UNSET

from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.messages.robots.plugin_messages import PluginEvent
from robrain.protocol.messages.robots.robot_messages import RadioLink, RobotState
from robrain.protocol.messages.team.arena_messages import RobotTruth, Scan
from robrain.protocol.messages.team.recorder_messages import RecorderState
from robrain.protocol.messages.team.team_messages import RobotSummary
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.reasons import Gone, OutOfService
from robrain.recording.drawing.robot_history import RobotHistory

SILENT_AFTER_S = 3.0
"""A robot that is present but whose state is older than this may hang: its token would last 10 s more."""
TRAIL_STEP_M = 0.1
TRAIL_POINTS = 600
POSES = 12
EVENTS = 40
LINK_S = 20.0
"""A radio link without a message for this long is not drawn any more, run's clock."""
RECORDER_PERIOD_S = 2.0
"""A recorder whose states are no farther apart than this sends one each second, as a live one does."""
RECORDER_SILENT_S = 6.0


class RobotContact(StrEnum):
    """Contact with a robot."""

    UP = "up"
    SILENT = "silent"
    """It is present, but its state is old."""
    LOST = "lost"


class RobotHealth(StrEnum):
    """A robot in one word, worst first."""

    LOST = "lost"
    SILENT = "silent"
    HALTED = "halted"
    FAULTED = "faulted"
    """A plugin of it does not run."""
    ASTRAY = "astray"
    """It does not know its pose."""
    OUT_OF_SERVICE = "out_of_service"
    READY = "ready"
    """It waits at its start for the run to begin."""
    UP = "up"


@dataclass
class ShownRobot:
    """The known state of one robot."""

    name: str
    index: int
    """Number of robots that appeared before it; chooses its colour."""
    present: bool | None = None
    """Whether its liveliness token is present; None if it never had one."""
    last_seen_s: float | None = None
    """Arrival time of its last state, on the caller's clock."""
    first_s: float | None = None
    """Arrival time of its first state."""
    state: RobotState | None = None
    summary: RobotSummary | None = None
    truth: RobotTruth | None = None
    start: Pose2D | None = None
    """Its place before the run begins; None once the run has begun."""
    scan: Scan | None = None
    path: list[Point2D] = field(default_factory=list)
    links: list[RadioLink] = field(default_factory=list)
    """The links of its base station."""
    trail: deque[Point2D] = field(default_factory=lambda: deque(maxlen=TRAIL_POINTS))
    poses: deque[tuple[int, Pose2D]] = field(default_factory=lambda: deque(maxlen=POSES))
    """The last poses with their stamps."""
    history: RobotHistory = field(default_factory=RobotHistory)
    events: deque[PluginEvent] = field(default_factory=lambda: deque(maxlen=EVENTS))
    """Its last events, oldest first."""

    def pose_at(self, stamp_ns: int) -> Pose2D | None:
        """Its pose nearest to a time of its clock, such as that of a lidar scan."""
        if not self.poses or not stamp_ns:
            return self.pose
        return min(self.poses, key=lambda known: abs(known[0] - stamp_ns))[1]

    @property
    def title(self) -> str:
        """Its label and its name, for people."""
        return self.name if self.summary is None else self.summary.title

    @property
    def has_gone(self) -> bool:
        """Whether it has left the network, by the coordinator's report."""
        return not self.present and self.summary is not None and isinstance(self.summary.out, Gone)

    @property
    def pose(self) -> Pose2D | None:
        """Its last pose, arena frame; before the run begins, its start."""
        return self.start if self.state is None else self.state.pose

    @property
    def halted(self) -> bool:
        """Whether its last state is halted."""
        return self.state is not None and self.state.halted

    @property
    def endurance_s(self) -> float | None:
        """Remaining battery time at the power of the last minutes; None if it does not report it."""
        energy = self.state.energy if self.state is not None else None
        if energy is None or not energy.usual_power_w > 0:
            return None
        return max(0.0, energy.usable_j) / energy.usual_power_w

    def contact(self, now_s: float) -> RobotContact:
        """Its contact at `now_s`."""
        if self.present is False:
            return RobotContact.LOST
        if self.start is not None:
            return RobotContact.UP
        if self.last_seen_s is not None and now_s - self.last_seen_s <= SILENT_AFTER_S:
            return RobotContact.UP
        return RobotContact.SILENT if self.present else RobotContact.LOST

    def condition(self, now_s: float) -> RobotHealth:
        """Its condition at `now_s`: the worst that applies."""
        contact = self.contact(now_s)
        if contact is not RobotContact.UP:
            return RobotHealth(contact.value)
        if self.start is not None:
            return RobotHealth.READY
        if self.halted:
            return RobotHealth.HALTED
        if self.state is not None and self.state.faulted:
            return RobotHealth.FAULTED
        if self.state is not None and self.state.lost:
            return RobotHealth.ASTRAY
        is_held = self.summary is not None and isinstance(self.summary.out, OutOfService)
        return RobotHealth.OUT_OF_SERVICE if is_held else RobotHealth.UP

    def handle_state(self, state: RobotState, now_s: float) -> None:
        """Process its state."""
        self.state, self.last_seen_s = state, now_s
        if self.first_s is None:
            self.first_s = now_s
        pose = state.pose
        if pose is not None:
            self.poses.append((state.stamp_ns, pose))
        if pose is not None and (not self.trail or pose.distance_m(self.trail[-1]) >= TRAIL_STEP_M):
            self.trail.append(Point2D(pose.x_m, pose.y_m))
        self.history.handle(state, self.truth)

    def forget_run(self) -> None:
        """Clear the data of a run, as another one has begun."""
        self.trail.clear()
        self.poses.clear()
        self.events.clear()
        self.history = RobotHistory()
        self.path, self.links = [], []
        self.scan = self.truth = self.summary = self.start = None


@dataclass
class ShownMote:
    """The known state of one mote."""

    name: str
    place: Point2D | None = None
    readings: dict[str, MoteReading] = field(default_factory=dict)
    """The latest reading of each quantity."""
    links: dict[str, MoteReading] = field(default_factory=dict)
    """The latest reading that each robot or gateway has received from it."""
    next_hop: str = ""
    """The mote that forwards its readings, or the gateway that receives it; empty if a robot receives it."""

    @property
    def latest(self) -> MoteReading | None:
        """The last reading of any quantity."""
        return max(self.readings.values(), key=lambda reading: reading.stamp_ns, default=None)

    def receive(self, reading: MoteReading) -> None:
        """Process a relayed reading, which may be old: it shows that there is a link."""
        self.place = reading.place or self.place
        self.next_hop = reading.forwarder or (reading.via if reading.waiting is not UNSET else "")
        if reading.hops:  # the forwarder has not received it from the mote itself
            return
        self.links[reading.via] = reading
        newest_ns = max(link.stamp_ns for link in self.links.values())
        for via in [via for via, link in self.links.items() if newest_ns - link.stamp_ns > LINK_S * 1e9]:
            del self.links[via]


@dataclass
class ShownRecorder:
    """The known state of one recorder; times are of the caller's monotonic clock."""

    name: str
    state: RecorderState | None = None
    last_seen_s: float = 0.0
    is_periodic: bool = False

    def handle(self, state: RecorderState, now_s: float) -> None:
        """Process its state."""
        if self.state is not None:
            self.is_periodic = now_s - self.last_seen_s <= RECORDER_PERIOD_S or self.is_periodic
        self.state, self.last_seen_s = state, now_s

    def is_silent(self, now_s: float) -> bool:
        """Whether its states have stopped although it has not closed its file."""
        if self.state is None or self.state.closed or not self.is_periodic:
            return False
        return now_s - self.last_seen_s > RECORDER_SILENT_S

    @property
    def lost_text(self) -> str:
        """Lost messages in words; empty if there are none."""
        lost = self.state.lost if self.state is not None else []
        total = sum(entry.messages for entry in lost)
        if not total:
            return ""
        most = max(lost, key=lambda entry: entry.messages)
        return f"{total} messages are not in it, {most.messages} of them {most.topic}"
