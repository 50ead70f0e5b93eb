"""The messages of the wire: frozen structs, JSON on the wire.

Unknown fields are ignored and new fields have defaults, so that older and newer peers talk. `stamp_ns` (the
run's clock) and `seq` are filled in by the publisher that sends the message.
"""

from typing import Annotated, Any

import msgspec
from msgspec import Meta

from robrain.protocol.model.energy.energy_model import EnergyModel
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.mapping.map_frame import ARENA, MapFrame
from robrain.protocol.model.navigation.claim import Claim
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
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.reasons import IdleReason, OfferRefusal, TaskReason, Unavailable, told
from robrain.protocol.wire.refusals import Refused

Result = Annotated[dict[str, Any], Meta(max_length=64)]
COVARIANCE_LENGTHS = (0, 9)
Covariance = Annotated[tuple[Quantity, ...], Meta(max_length=9)]
JsonSchema = Annotated[dict[str, Any], Meta(max_length=1000)]
Prose = Annotated[str, Meta(max_length=100_000)]
"""Text by the author of a plugin."""
Lease = Annotated[float, Meta(ge=0.0, le=86_400.0)]
"""Lease of a task, seconds."""


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """What every published message carries."""

    stamp_ns: Stamp = 0
    seq: Count = 0


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
    """Why the measurements are rejected; the estimate then goes on without them. Empty if they are not."""


class TaskStatus(msgspec.Struct, frozen=True, kw_only=True):
    """State of the last task that a robot accepted."""

    id: Name
    epoch: Epoch
    state: TaskState
    why: Text = ""
    result: Result = {}
    """Result of a task that has ended: a few numbers, the key of an image; `energy_j` is the energy it took."""
    left_s: Seconds | None = None
    """Estimated time until it ends; None if unknown, and once the task has ended."""
    reason: OfferRefusal | None = None
    """Of a task that was held and then refused: the reason that `why` puts in words; None if there are only words."""


class PluginFault(msgspec.Struct, frozen=True, kw_only=True):
    """A plugin that does not run."""

    plugin: Name
    why: Text


Faults = Annotated[list[PluginFault], Meta(max_length=1000)]


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
    """What the robot knows of its own consumption."""
    behavior: Name = ""
    task: TaskStatus | None = None
    next_task: TaskStatus | None = None
    """A task that it holds and begins in the step in which `task` ends; `offered` until then."""
    task_before: TaskStatus | None = None
    """How the one before `task` ended, so that its end is told also where the next began in the same step."""
    halted: bool = False
    """Emergency halt: all plugins refuse calls and have received the order to stop."""
    halted_by: Names = []
    """Who holds the halt."""
    team_halt_ns: Stamp = 0
    """Stamp of the team's halt, if the halt is the team's."""
    not_halted: Names = []
    """Plugins that failed to stop, or did not say in time that they have."""
    faulted: Faults = []
    """Plugins that do not run."""
    lost: Text = ""
    """Why the robot has lost its position; empty while it has one."""
    frame: MapFrame = ARENA
    """The map frame of `pose`: the arena frame, or one of a robot that does not know its place in the arena."""
    map_agreement: Share | None = None
    """Share of the beams of recent scans that end at walls of the robot's map; None before the first comparison."""
    loaded: Count = 0
    """Number that changes with the set of loaded plugins, so that others need not poll it; 0 if not reported."""
    refused: Refused = msgspec.UNSET
    """Messages and requests that the robot's host and plugins have refused."""

    def __post_init__(self) -> None:
        if len(self.pose_covariance) not in COVARIANCE_LENGTHS:
            raise ValueError(f"expected no pose_covariance or 9 numbers of it, got {len(self.pose_covariance)}")

    @property
    def has_stopped(self) -> bool:
        """Whether the robot is halted and every plugin of it has stopped."""
        return self.halted and not self.not_halted


class PlannedPath(Message, frozen=True, kw_only=True):
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


class Event(Message, frozen=True, kw_only=True):
    """A notification that left its robot."""

    robot: Name
    plugin: Name
    event: Name
    value: Any = None
    """What the plugin notifies of, any JSON."""


class LogRecord(Message, frozen=True, kw_only=True):
    """One line of a component's log."""

    robot: Name
    level: Name
    """Level as in Python: debug, info, warning, error."""
    source: Name
    """Name of the plugin or part that logs."""
    text: Text
    """The line."""


class FunctionInfo(msgspec.Struct, frozen=True, kw_only=True):
    """One external function of a plugin."""

    name: Name
    signature: Prose
    """Its signature in Python."""
    doc: Prose
    parameters: JsonSchema
    """JSON Schema of an object with one property for each parameter."""
    returns: JsonSchema
    """JSON Schema of the result."""


class ProcessInfo(msgspec.Struct, frozen=True):
    """Which process has a name."""

    host: Text
    """Name of its machine."""
    pid: Count
    """Its process id there."""
    zid: Text
    """Id of its Zenoh session."""

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}, Zenoh id {self.zid[:8]}"


class TaskKind(msgspec.Struct, frozen=True, kw_only=True):
    """A kind of task that a behavior does, as its robot announces it."""

    kind: Name
    doc: Prose = ""
    parameters: JsonSchema = {}
    """JSON Schema of `Task.parameters`: of an object; no references but to its own `$defs`, no regular expressions."""
    settings: Count = 0
    """Differs between robots whose behavior has other parameters, so that tasks may cost them something else."""


class PluginInfo(msgspec.Struct, frozen=True, kw_only=True):
    """One plugin of a robot, as its host reports it."""

    name: Name
    level: Name
    """Device, unit, skill or behavior."""
    state: Name
    why: Text = ""
    where: Text = ""
    """The line of plugin code that raised the fault, such as `lamp/lamp.py:12 in step`; empty if none did."""
    detail: Text = ""
    """The traceback of the fault, from the plugin's first frame."""
    visibility: Names = []
    """Plugins that may call it; `*` for all, `command` for callers outside."""
    requires: Names = []
    """Plugins that it calls."""
    holder: Name = ""
    period_s: Seconds | None = None
    overruns: Count = 0
    """Steps that took longer than the period."""
    restarts: Count = 0
    """How often it was started again after a fault."""
    distribution: Name = ""
    """The installed distribution that a third-party plugin came with."""
    doc: Prose = ""
    functions: Annotated[list[FunctionInfo], Meta(max_length=1000)] = []
    task_kind: TaskKind | None = None
    """The kind of task that it does; None if it does none."""


class TaskOffer(msgspec.Struct, frozen=True, kw_only=True):
    """The coordinator's query to a robot: take this on."""

    task: Task
    epoch: Epoch
    lease_s: Lease
    """The robot drops the task when it has not heard the coordinator for this long."""
    after: Name = ""
    """Id of the robot's current task: this one begins when that one has ended. Empty: it replaces the current one."""


class TaskWithdrawal(msgspec.Struct, frozen=True, kw_only=True):
    """The coordinator's query to a robot: drop this task."""

    id: Name
    epoch: Epoch
    why: Text = ""


class TaskAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's answer to an offer or a withdrawal."""

    accepted: bool
    why: Text = ""
    reason: OfferRefusal | None = None
    """`why` as a value; None if there are only words."""
    epoch: Epoch | msgspec.UnsetType = msgspec.UNSET
    """The latest epoch the robot has accepted; only set when it refuses an older one."""

    @classmethod
    def refused(cls, reason: OfferRefusal, epoch: int | msgspec.UnsetType = msgspec.UNSET) -> "TaskAnswer":
        """The answer no."""
        return cls(accepted=False, why=told(reason), reason=reason, epoch=epoch)


class TaskEvent(Message, frozen=True, kw_only=True):
    """One change of a task."""

    task: Task
    state: TaskState
    robot: Name = ""
    epoch: Epoch = 0
    why: Text = ""
    result: Result = {}
    """As in the robot's `TaskStatus`."""
    change: Count = 0
    """Number of the change in the coordinator's journal; a repeated number is the same change, sent again."""
    reason: TaskReason | None = None
    """`why` as a value; None if there was no reason, or only its words are known."""


class RobotSummary(msgspec.Struct, frozen=True, kw_only=True):
    """A robot as the coordinator sees it."""

    name: Name
    up: bool
    """Whether it is present and publishes its state."""
    age_s: Quantity
    """Age of its last state."""
    halted: bool = False
    soc: Charge | None = None
    """State of charge, 0 to 1; null if unknown."""
    behavior: Name = ""
    task: Name = ""
    why: Text = ""
    """Why it is not available for tasks, or has nothing to do, in words."""
    faulted: Faults = []
    """Its plugins that do not run."""
    idle: IdleReason | None = None
    """Why it has nothing to do; None if it has a task or is not available."""
    out: Unavailable | None = None
    """Why it is not available; None if it is."""


class FrontierSummary(msgspec.Struct, frozen=True, kw_only=True):
    """One border of the known, arena frame."""

    place: Point2D
    length_m: Metres
    """Length of the border."""


class HaltStatus(msgspec.Struct, frozen=True, kw_only=True):
    """How the team stands to an emergency halt of all."""

    halted: bool
    by: Names
    """Who holds the halt; once it is over, who ended it."""
    reason: Text = ""
    since_ns: Stamp = 0
    """When it began, or ended."""
    stamp_ns: Stamp = 0
    """Of the last halt or resume received; increases from one to the next."""
    stopped: Names = []
    """Robots that have stopped."""
    not_stopped: Names = []
    """All other robots ever known, including lost ones."""


class TeamState(Message, frozen=True, kw_only=True):
    """The coordinator's summary: 2 Hz, only the latest counts."""

    robots: Annotated[list[RobotSummary], Meta(max_length=100_000)]
    known_area_m2: Quantity = 0.0
    """Area of the floor that is known."""
    frontiers: Annotated[list[FrontierSummary], Meta(max_length=1000)] = []
    all_explored: bool = False
    """Whether nothing unknown is left that a robot could reach."""
    tasks_open: Count = 0
    """Tasks that have not ended."""
    tasks_done: Count = 0
    """Tasks that were done."""
    messages: Count = 0
    """Messages that the coordinator has received."""
    halt: HaltStatus | None = None
    """None until somebody halts the team."""
    refused: Refused = msgspec.UNSET
    """Messages that the coordinator has refused."""


class RadioLink(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A mote or robot that a robot's base station hears."""

    peer: Name
    """The mote's or the robot's name."""
    is_robot: bool = False
    """Whether the peer is a robot; otherwise it is a mote."""
    rssi_dbm: Quantity
    """Strength of the last packet heard."""
    heard_ns: Stamp
    """When that was."""


class RobotLinks(Message, frozen=True, kw_only=True):
    """What a robot's base station hears on the motes' radio: every 2 s while it hears any, and once after the last."""

    robot: Name
    links: Annotated[list[RadioLink], Meta(max_length=10_000)] = []
    """One entry for each mote and robot that is heard."""


class MoteReading(Message, frozen=True, kw_only=True):
    """A mote's reading, brought in by a robot or a gateway."""

    mote: Name
    place: Point2D | None
    quantity: Name
    value: Quantity
    """The measured value, in the unit of the quantity."""
    voltage_v: Quantity
    rssi_dbm: Quantity
    """Strength of the packet at the receiver."""
    via: Name
    """The robot or gateway that heard it."""
    sequence: Count | None = None
    """Number of the reading, counted by the mote and wrapping at 65536: mote and number name a reading."""
    taken_ns: Stamp = 0
    """When it was sensed, as well as the mote's clock can tell; 0 if that is not known."""
    period_s: Seconds = 0.0
    """How often the mote senses; 0 if that is not known."""
    stored: Count = 0
    """Readings before the mote's latest that it still keeps, because nobody has acknowledged them."""


class MoteDuty(Message, frozen=True, kw_only=True):
    """How often a mote is to sense; any robot that meets it passes this on."""

    mote: Name
    period_s: Seconds
    by: Name = ""
    """Who requested it."""


class LostMessages(msgspec.Struct, frozen=True):
    """Messages of one topic that are not in a recording."""

    topic: Name
    """Its name in the table."""
    messages: Count
    """How many."""


class RecorderState(Message, frozen=True, kw_only=True):
    """Status of a recorder: every second in live, and when something was lost."""

    recorder: Name
    """Name of the recorder."""
    file: Text = ""
    """Name of the file that it writes to."""
    messages: Count = 0
    """Messages heard."""
    bytes: Count = 0
    """Written so far."""
    lost: Annotated[list[LostMessages], Meta(max_length=1000)] = []
    """Messages that are not in the recording."""
    refused: Refused = msgspec.UNSET
    """Messages that are not in the recording because they break the contract of their topic."""
    waiting: Count = 0
    """Messages heard that are not written yet."""
    why: Text = ""
    """What is wrong with it; empty if nothing is."""
    closed: bool = False
    """It has finished its file."""


class Halt(Message, frozen=True, kw_only=True):
    """Team-wide emergency halt, or its end."""

    halted: bool
    by: Text
    """Who halts. The same name, or one that starts with `operator`, may resume."""
    reason: Text = ""
