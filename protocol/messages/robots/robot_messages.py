"""Messages that a robot publishes about itself: its state, its path and its radio links."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.messages.message import COVARIANCE_LENGTHS, Covariance, Message, Result, SharedMessage
from robrain.protocol.messages.robots.witness_messages import Led
from robrain.protocol.model.claim import Claim, Reservation
from robrain.protocol.model.energy_model import EnergyModel
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.map_frame import ARENA, MapFrame
from robrain.protocol.model.ranges import (
    Charge,
    Count,
    Epoch,
    Joules,
    Length,
    Metres,
    Name,
    Names,
    Quantity,
    Seconds,
    Share,
    Speed,
    Stamp,
    Text,
)
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.reasons import OfferRefusal
from robrain.protocol.refusals import Refused
from robrain.protocol.topic import PNG, Delivery, Token, Topic, Urgency


class BatteryState(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's estimate of its battery."""

    voltage_v: Quantity
    current_a: Quantity
    """Current out of the battery; negative while it charges."""
    temperature_c: Quantity
    """Temperature of the cells."""
    soc: Charge
    """State of charge, 0 to 1."""
    remaining_j: Joules
    """Energy at the terminals above the cut-off; the next two are its 95 % interval."""
    remaining_low_j: Joules = 0.0
    """Lower end of the 95 % interval of `remaining_j`."""
    remaining_high_j: Joules = 0.0
    """Upper end of the 95 % interval of `remaining_j`."""
    soc_sd: Quantity = 0.0
    """Standard deviation of `soc`."""
    health: Quantity = 1.0
    """Capacity as a share of the rated one."""
    charging: bool = False
    """Whether it is being charged."""
    implausible: Text = ""
    """Why the measurements are rejected; the estimate then continues without them. Empty if they are not."""


class TaskStatus(msgspec.Struct, frozen=True, kw_only=True):
    """State of the last task that a robot accepted."""

    id: Name
    epoch: Epoch
    state: TaskState
    why: Text = ""
    result: Result = {}
    """Result of a task that has ended: a few numbers, the key of an image; `energy_j` is the energy it took."""
    remaining_s: Seconds | None = None
    """Estimated time until it ends; None if unknown, and once the task has ended."""
    carries: bool = False
    """Whether the robot has taken an item of it on board, so that no other robot can do the rest."""
    reason: OfferRefusal | None = None
    """The reason that `why` puts in words, of a task that was held and then refused, or that a door prevents. None if
    there are only words."""


class PluginFault(msgspec.Struct, frozen=True, kw_only=True):
    """A plugin that does not run, and those that do not run because of it."""

    plugin: Name
    why: Text
    """Reason, from the code that raised it on; may have several lines."""
    dependants: Names = []
    """Plugins that require it, also through others, and do not run."""

    @property
    def words(self) -> str:
        """The fault in one line."""
        why = self.why.strip().rpartition("\n")[2].strip()
        without = f"; without it: {', '.join(self.dependants)}" if self.dependants else ""
        return f"{self.plugin} does not run{f': {why}' if why else ''}{without}"


Faults = Annotated[list[PluginFault], Meta(max_length=1000)]


RESERVATIONS_MAX = 256
"""Further requests for zones are not reported, so they are not granted either."""


class RobotState(Message, frozen=True, kw_only=True):
    """A robot in one message: 10 Hz, only the latest counts."""

    robot: Name
    pose: Pose2D | None = None
    pose_covariance: Covariance = ()
    """Row-major 3 × 3 of x, y, yaw: m², m·rad, rad²; empty when unknown."""
    velocity: Twist2D = Twist2D()
    """Measured velocity, body frame."""
    radius_m: Length = 0.0
    """Radius of the round footprint."""
    battery: BatteryState | None = None
    """The battery's estimate; null if the robot has none."""
    energy: EnergyModel | None = None
    """The robot's knowledge of its consumption."""
    behavior: Name = ""
    waits_for: Name = ""
    """The robot for which it waits; empty if none."""
    waits_at: Name | msgspec.UnsetType = msgspec.UNSET
    """The zone or door before which it waits; absent if none."""
    reservations: Annotated[tuple[Reservation, ...], Meta(max_length=RESERVATIONS_MAX)] | msgspec.UnsetType = (
        msgspec.UNSET
    )
    """Its requests for zones, and the latest ones of the robots that it receives; absent if it does not obey zones."""
    task: TaskStatus | None = None
    next_task: TaskStatus | None = None
    """A task that it holds and begins in the step in which `task` ends; `offered` until then."""
    task_before: TaskStatus | None = None
    """How the task before `task` ended; its end is reported even if the next one began in the same step."""
    halted: bool = False
    """Emergency halt: all plugins refuse calls and have received the order to stop."""
    halted_by: Names = msgspec.field(default_factory=list)
    """Names of the holders of the halt."""
    team_halt_ns: Stamp = 0
    """Stamp of the team's halt, if the halt is the team's."""
    not_halted: Names = msgspec.field(default_factory=list)
    """Plugins that failed to stop, or did not confirm in time that they have."""
    faulted: Faults = msgspec.field(default_factory=list)
    """Plugins that do not run."""
    lost: Text = ""
    """Why the robot has lost its position; empty while it has one."""
    frame: MapFrame = ARENA
    """The map frame of `pose`: the arena frame, or one of a robot that does not know its place in the arena."""
    map_agreement: Share | None = None
    """Share of the beams of recent scans that end at walls of the robot's map; None before the first comparison."""
    loaded: Count = 0
    """Number that changes with the set of loaded plugins, so that others need not poll it; 0 if not reported."""
    continues_for_s: Seconds | msgspec.UnsetType = msgspec.UNSET
    """Time for which it continues its tasks without a coordinator, if that is longer than the lease."""
    changes_received: Count | msgspec.UnsetType = msgspec.UNSET
    """Number of the last change of tasks that it has received, if it continues without a coordinator."""
    refused: Refused = msgspec.UNSET
    """Messages and requests that the robot's host and plugins have refused."""
    led: Led | msgspec.UnsetType = msgspec.UNSET
    """The coordinator that the robot follows, if it was elected; absent otherwise."""
    skipped: Count | msgspec.UnsetType = msgspec.UNSET
    """Messages of its telemetry that it has not sent, as its link is thin; absent if none."""

    def __post_init__(self) -> None:
        if len(self.pose_covariance) not in COVARIANCE_LENGTHS:
            raise ValueError(f"expected no pose_covariance or 9 numbers of it, got {len(self.pose_covariance)}")

    @property
    def wait_words(self) -> str:
        """For whom and where it waits, such as `waits for r2 at gate`; empty if it does not."""
        words = (f" for {self.waits_for}" if self.waits_for else "") + (f" at {self.waits_at}" if self.waits_at else "")
        return f"waits{words}" if words else ""

    @property
    def has_stopped(self) -> bool:
        """Whether the robot is halted and every plugin of it has stopped."""
        return self.halted and not self.not_halted


class PlannedPath(SharedMessage, frozen=True, kw_only=True):
    """The path a robot means to follow, arena frame, from where it is; empty when it stands."""

    robot: Name
    points: Annotated[list[Point2D], Meta(max_length=100_000)]
    """From the robot to the end of the path."""
    claim: Claim = Claim()
    """Decides its right of way."""
    speed_m_s: Speed = 0.0
    """Speed where nothing slows it down; 0 if not reported."""
    held_at_m: Metres | None = None
    """Distance along the path at which it waits for others; None if it need not wait."""


class RadioLink(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A mote or robot that a robot's base station receives."""

    peer: Name
    """The mote's or the robot's name."""
    is_robot: bool = False
    """Whether the peer is a robot; otherwise it is a mote."""
    rssi_dbm: Quantity
    """Strength of the last packet received."""
    last_seen_ns: Stamp
    """When that was."""


class RobotLinks(Message, frozen=True, kw_only=True):
    """Traffic on the motes' radio at a robot's base station: every 2 s while there is any, and once after."""

    robot: Name
    links: Annotated[list[RadioLink], Meta(max_length=10_000)] = msgspec.field(default_factory=list)
    """One entry for each mote and robot that is received."""


ROBOT_ALIVE = Token("robot/{robot}/alive", "Liveliness token of the agent")
ROBOT_CLAIM = Token(
    "robot/{robot}/claim/{stage}/{process}",
    "Liveliness token of a starting agent: `asks` while it claims the robot's name, then `has` until it is alive",
)
ROBOT_STATE = Topic(
    "robot/{robot}/state", "Pose, velocity, battery, current behavior and task", RobotState, rate_hz=10, periods_max=3,
    delivery=Delivery.LATEST, urgency=Urgency.DATA_HIGH, recorded=True, max_bytes=65_536)  # fmt: skip
ROBOT_PATH = Topic(
    "robot/{robot}/path", "The robot's planned path, on change", PlannedPath, delivery=Delivery.LATEST, recorded=True,
    max_bytes=4_194_304)  # fmt: skip
ROBOT_LINKS = Topic(
    "robot/{robot}/links", "Motes and robots received on the motes' radio, with RSSI", RobotLinks, rate_hz=0.5,
    delivery=Delivery.LATEST, urgency=Urgency.DATA_LOW, recorded=True)  # fmt: skip
ROBOT_IMAGE: Topic[bytes] = Topic(
    "robot/{robot}/image/{image}", "A picture for a task; the task's result names its key", delivery=Delivery.LOSSLESS,
    cache=1, urgency=Urgency.BACKGROUND, recorded=True, encoding=PNG, max_bytes=16_777_216)  # fmt: skip
