"""What the dashboard knows of one robot and of one mote."""

from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum

from robrain.coordinator.drawing.robot_history import RobotHistory
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.wire.messages.arena_messages import RobotTruth, Scan
from robrain.protocol.wire.messages.mote_messages import MoteReading
from robrain.protocol.wire.messages.plugin_messages import Event
from robrain.protocol.wire.messages.robot_messages import RadioLink, RobotState
from robrain.protocol.wire.messages.team_messages import RobotSummary

SILENT_AFTER_S = 3.0
"""A robot whose token stands but whose state is older than this may hang: its liveliness would last 10 s more."""
TRAIL_STEP_M = 0.1
TRAIL_POINTS = 600
POSES = 12
EVENTS = 40
LINK_S = 20.0
"""A radio link that has brought nothing for so long is not drawn any more, run's clock."""


class Contact(StrEnum):
    """How well a robot is heard."""

    UP = "up"
    SILENT = "silent"
    """Its token stands, its state is old."""
    LOST = "lost"


class Condition(StrEnum):
    """A robot in one word, worst first."""

    LOST = "lost"
    SILENT = "silent"
    HALTED = "halted"
    FAULTED = "faulted"
    """A plugin of it does not run."""
    ASTRAY = "astray"
    """It does not know where it is."""
    UP = "up"


@dataclass
class RobotView:
    """All that is known of one robot."""

    name: str
    index: int
    """How many robots appeared before it; chooses its colour."""
    present: bool | None = None
    """Whether its liveliness token stands; None when it never had one."""
    heard_s: float | None = None
    """When its state last came, on the caller's clock."""
    first_s: float | None = None
    """When its first state arrived."""
    state: RobotState | None = None
    summary: RobotSummary | None = None
    truth: RobotTruth | None = None
    scan: Scan | None = None
    path: list[Point2D] = field(default_factory=list)
    links: list[RadioLink] = field(default_factory=list)
    """Whom its base station hears."""
    trail: deque[Point2D] = field(default_factory=lambda: deque(maxlen=TRAIL_POINTS))
    poses: deque[tuple[int, Pose2D]] = field(default_factory=lambda: deque(maxlen=POSES))
    """The last ones with their stamps."""
    history: RobotHistory = field(default_factory=RobotHistory)
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=EVENTS))
    """The last that left it, oldest first."""

    def pose_at(self, stamp_ns: int) -> Pose2D | None:
        """Where it said to be nearest to a time of its clock: what a lidar saw belongs to where the robot was then."""
        if not self.poses or not stamp_ns:
            return self.pose
        return min(self.poses, key=lambda known: abs(known[0] - stamp_ns))[1]

    @property
    def pose(self) -> Pose2D | None:
        """Where it last said to be, arena frame."""
        return None if self.state is None else self.state.pose

    @property
    def halted(self) -> bool:
        """Whether it last said to be halted."""
        return self.state is not None and self.state.halted

    @property
    def endurance_s(self) -> float | None:
        """How long its battery lasts at the power of the last minutes; None where it does not tell."""
        energy = self.state.energy if self.state is not None else None
        if energy is None or not energy.usual_power_w > 0:
            return None
        return max(0.0, energy.usable_j) / energy.usual_power_w

    def contact(self, now_s: float) -> Contact:
        """How well it is heard at `now_s`."""
        if self.present is False:
            return Contact.LOST
        if self.heard_s is not None and now_s - self.heard_s <= SILENT_AFTER_S:
            return Contact.UP
        return Contact.SILENT if self.present else Contact.LOST

    def condition(self, now_s: float) -> Condition:
        """The worst that is to be said of it."""
        contact = self.contact(now_s)
        if contact is not Contact.UP:
            return Condition(contact.value)
        if self.halted:
            return Condition.HALTED
        if self.state is not None and self.state.faulted:
            return Condition.FAULTED
        return Condition.ASTRAY if self.state is not None and self.state.lost else Condition.UP

    def take_state(self, state: RobotState, now_s: float) -> None:
        """Take in its state."""
        self.state, self.heard_s = state, now_s
        if self.first_s is None:
            self.first_s = now_s
        pose = state.pose
        if pose is not None:
            self.poses.append((state.stamp_ns, pose))
        if pose is not None and (not self.trail or pose.distance_m(self.trail[-1]) >= TRAIL_STEP_M):
            self.trail.append(Point2D(pose.x_m, pose.y_m))
        self.history.take(state, self.truth)

    def forget_run(self) -> None:
        """Another run has begun."""
        self.trail.clear()
        self.poses.clear()
        self.events.clear()
        self.history = RobotHistory()
        self.path, self.links = [], []
        self.scan = self.truth = self.summary = None


@dataclass
class MoteView:
    """All that is known of one mote."""

    name: str
    place: Point2D | None = None
    readings: dict[str, MoteReading] = field(default_factory=dict)
    """The latest of each quantity."""
    links: dict[str, MoteReading] = field(default_factory=dict)
    """The latest that each robot or gateway brought in."""

    @property
    def latest(self) -> MoteReading | None:
        """The last reading of any quantity."""
        return max(self.readings.values(), key=lambda reading: reading.stamp_ns, default=None)

    def heard(self, reading: MoteReading) -> None:
        """Somebody brought in a reading, an old one maybe: there is a link."""
        self.place = reading.place or self.place
        self.links[reading.via] = reading
        newest_ns = max(link.stamp_ns for link in self.links.values())
        for via in [via for via, link in self.links.items() if newest_ns - link.stamp_ns > LINK_S * 1e9]:
            del self.links[via]
