"""The messages of the wire: frozen structs, JSON on the wire.

Unknown fields are ignored and new fields have defaults, so that older and newer peers talk. `stamp_ns` (the
run's clock) and `seq` are filled in by the publisher that sends the message.
"""

from typing import Any

import msgspec

from robrain.protocol.model.claim import Claim
from robrain.protocol.model.energy_model import EnergyModel
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.task import Task, TaskState


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """What every published message carries."""

    stamp_ns: int = 0
    seq: int = 0


class BatteryState(msgspec.Struct, frozen=True, kw_only=True):
    """A battery as its robot believes it to be."""

    voltage_v: float
    current_a: float
    temperature_c: float
    soc: float
    """State of charge, 0 to 1."""
    remaining_j: float
    """At the terminals, above the cut-off; the next two are its 95 % interval."""
    remaining_low_j: float = 0.0
    remaining_high_j: float = 0.0
    soc_sd: float = 0.0
    health: float = 1.0
    """Capacity as a share of the rated one."""
    charging: bool = False
    implausible: str = ""
    """Why the measurements are not believed; the estimate then goes on without them."""


class TaskStatus(msgspec.Struct, frozen=True, kw_only=True):
    """How a robot stands to the last task it accepted."""

    id: str
    epoch: int
    state: TaskState
    why: str = ""
    result: dict[str, Any] = {}
    """What it was for, once it has ended: a few numbers, the key of an image; `energy_j` is what it took."""
    left_s: float | None = None
    """In how long it ends, as well as the robot knows; None if it does not, and once the task has ended."""


class PluginFault(msgspec.Struct, frozen=True, kw_only=True):
    """A plugin that does not run."""

    plugin: str
    why: str


class RobotState(Message, frozen=True, kw_only=True):
    """A robot in one message: 10 Hz, only the latest counts."""

    robot: str
    pose: Pose2D | None = None
    pose_covariance: tuple[float, ...] = ()
    """Row-major 3 × 3 of x, y, yaw: m², m·rad, rad²; empty when unknown."""
    velocity: Twist2D = Twist2D()
    radius_m: float = 0.0
    """Radius of the round footprint."""
    battery: BatteryState | None = None
    energy: EnergyModel | None = None
    """What the robot knows of its own consumption."""
    behavior: str = ""
    task: TaskStatus | None = None
    next_task: TaskStatus | None = None
    """A task that it holds and begins in the step in which `task` ends; `offered` until then."""
    task_before: TaskStatus | None = None
    """How the one before `task` ended, so that its end is told also where the next began in the same step."""
    halted: bool = False
    """Emergency halt: all plugins refuse calls and have been told to stop."""
    halted_by: list[str] = []
    """Who holds the halt."""
    team_halt_ns: int = 0
    """Stamp of the team's halt, if the halt is the team's."""
    not_halted: list[str] = []
    """Plugins that failed to stop, or did not say in time that they have."""
    faulted: list[PluginFault] = []
    """Plugins that do not run."""
    lost: str = ""
    """Why the robot does not know any more where it is; empty as long as it does."""
    loaded: int = 0
    """Another number whenever other plugins are loaded than before, so that nobody has to ask; 0 says nothing."""

    @property
    def has_stopped(self) -> bool:
        """Whether the robot is halted and every plugin of it has stopped."""
        return self.halted and not self.not_halted


class MapPatch(Message, frozen=True, kw_only=True):
    """Cells whose class changed by this robot's own sensing since its last patch.

    The grid's geometry comes with each patch; `row`, `column`, `rows`, `columns` say which box of it the cells
    fill. Cells are int8, row-major, row 0 at the lowest y: 0 free, 100 occupied, −1 no statement; deflated
    (zlib), base64 in JSON. `robrain.protocol.wire.map_patch` makes and merges them.
    """

    robot: str
    resolution_m: float
    origin_x_m: float
    origin_y_m: float
    width: int
    height: int
    row: int
    column: int
    rows: int
    columns: int
    observed_ms: int
    """When the cells were seen, by `map_stamp_ms`: of two statements on a cell the later one counts."""
    cells: bytes


class PlannedPath(Message, frozen=True, kw_only=True):
    """The path a robot means to follow, arena frame, from where it is; empty when it stands."""

    robot: str
    points: list[Point2D]
    claim: Claim = Claim()
    """What its right of way is decided by."""
    speed_m_s: float = 0.0
    """How fast it goes where nothing hinders it; 0 if it does not say."""
    held_at_m: float | None = None
    """It goes this far along the path for now, and waits for others there; None if it waits for nobody."""


class Event(Message, frozen=True, kw_only=True):
    """A notification that left its robot."""

    robot: str
    plugin: str
    event: str
    value: Any = None


class LogRecord(Message, frozen=True, kw_only=True):
    """One line of a component's log."""

    robot: str
    level: str
    source: str
    text: str


class FunctionInfo(msgspec.Struct, frozen=True, kw_only=True):
    """One external function of a plugin."""

    name: str
    signature: str
    doc: str
    parameters: dict[str, Any]
    """JSON Schema of an object with one property for each parameter."""
    returns: dict[str, Any]
    """JSON Schema of the result."""


class PluginInfo(msgspec.Struct, frozen=True, kw_only=True):
    """One plugin of a robot, as its host tells it."""

    name: str
    level: str
    state: str
    why: str = ""
    visibility: list[str] = []
    requires: list[str] = []
    holder: str = ""
    period_s: float | None = None
    overruns: int = 0
    restarts: int = 0
    """How often it was started again after a fault."""
    distribution: str = ""
    """The installed distribution that a third-party plugin came with."""
    doc: str = ""
    functions: list[FunctionInfo] = []


class HostRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A query to a robot's host; which fields count depends on the verb in the key."""

    plugin: str = ""
    """load: a name, or the path of a folder or manifest on the robot's machine; otherwise a name."""
    cascade: bool = False
    """unload: those that require it as well."""
    text: str = ""
    """command: the text form, such as `call driver stop()`; halt: the reason."""
    by: str = ""
    """Who asks; halt and resume log it, hold and release are meant for that one."""
    lease_s: float = 5.0
    """hold: for how long, at most 60 s; who needs it longer asks again in time."""


class TaskOffer(msgspec.Struct, frozen=True, kw_only=True):
    """The coordinator's query to a robot: take this on."""

    task: Task
    epoch: int
    lease_s: float
    after: str = ""
    """Id of the task that the robot is at: this one is begun when that one has ended. Empty: now, in its place."""


class TaskWithdrawal(msgspec.Struct, frozen=True, kw_only=True):
    """The coordinator's query to a robot: let go of this."""

    id: str
    epoch: int
    why: str = ""


class TaskAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's answer to an offer or a withdrawal."""

    accepted: bool
    why: str = ""


class TaskEvent(Message, frozen=True, kw_only=True):
    """One change of a task."""

    task: Task
    state: TaskState
    robot: str = ""
    epoch: int = 0
    why: str = ""
    result: dict[str, Any] = {}
    """As the robot told it in its `TaskStatus`."""
    change: int = 0
    """Number of the change in the coordinator's journal; the same number again is the same change, told again."""


class RobotSummary(msgspec.Struct, frozen=True, kw_only=True):
    """A robot as the coordinator sees it."""

    name: str
    up: bool
    age_s: float
    halted: bool = False
    soc: float | None = None
    behavior: str = ""
    task: str = ""
    why: str = ""
    faulted: list[PluginFault] = []
    """Its plugins that do not run."""


class FrontierSummary(msgspec.Struct, frozen=True, kw_only=True):
    """One border of the known, arena frame."""

    place: Point2D
    length_m: float


class HaltStatus(msgspec.Struct, frozen=True, kw_only=True):
    """How the team stands to an emergency halt of all."""

    halted: bool
    by: list[str]
    """Who holds the halt; once it is over, who ended it."""
    reason: str = ""
    since_ns: int = 0
    """When it began, or ended."""
    stamp_ns: int = 0
    """Of the last halt or resume that was heard; grows from one to the next."""
    stopped: list[str] = []
    not_stopped: list[str] = []
    """All others that were ever heard of, those that are lost included."""


class TeamState(Message, frozen=True, kw_only=True):
    """The coordinator's summary: 2 Hz, only the latest counts."""

    robots: list[RobotSummary]
    known_area_m2: float = 0.0
    frontiers: list[FrontierSummary] = []
    all_explored: bool = False
    """Nothing unknown is left that a robot could reach."""
    tasks_open: int = 0
    tasks_done: int = 0
    messages: int = 0
    """Messages that the coordinator has received."""
    halt: HaltStatus | None = None
    """None as long as nobody has halted the team."""


class RadioLink(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Somebody whom a robot's base station hears."""

    peer: str
    """The mote's or the robot's name."""
    is_robot: bool = False
    rssi_dbm: float
    """Strength of the last packet heard."""
    heard_ns: int
    """When that was."""


class RobotLinks(Message, frozen=True, kw_only=True):
    """Whom a robot's base station hears on the motes' radio: each 2 s while it hears anybody, and a last time."""

    robot: str
    links: list[RadioLink] = []


class MoteReading(Message, frozen=True, kw_only=True):
    """A mote's reading, brought in by a robot or a gateway."""

    mote: str
    place: Point2D | None
    quantity: str
    value: float
    voltage_v: float
    rssi_dbm: float
    via: str
    """The robot or gateway that heard it."""
    sequence: int | None = None
    """Number of the reading, counted by the mote and wrapping at 65536: mote and number name a reading."""
    taken_ns: int = 0
    """When it was sensed, as well as the mote's clock can tell; 0 if that is not known."""
    period_s: float = 0.0
    """How often the mote senses; 0 if that is not known."""
    stored: int = 0
    """Readings before the mote's latest that it still keeps, because nobody has acknowledged them."""


class MoteDuty(Message, frozen=True, kw_only=True):
    """How often a mote is to sense; whoever meets it tells it."""

    mote: str
    period_s: float
    by: str = ""
    """Who wants it so."""


class LostMessages(msgspec.Struct, frozen=True):
    """Messages of one topic that are not in a recording."""

    topic: str
    """Its name in the table."""
    messages: int


class RecorderState(Message, frozen=True, kw_only=True):
    """How a recorder does: each second in live, and when something was lost."""

    recorder: str
    file: str = ""
    """Name of the file that it writes to."""
    messages: int = 0
    """Messages heard."""
    bytes: int = 0
    """Written so far."""
    lost: list[LostMessages] = []
    """What is not in the recording."""
    waiting: int = 0
    """Messages heard that are not written yet."""
    why: str = ""
    """What is wrong with it; empty as long as nothing is."""
    closed: bool = False
    """It has finished its file."""


class ReplayRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A query to a replay; what is None stays as it is. Without anything it only asks where the replay is."""

    playing: bool | None = None
    """False pauses it."""
    seek_s: float | None = None
    """Go there, in seconds since the first message; all that was the case then is said."""
    speed: float | None = None
    """Recorded seconds a second, above 0."""


class ReplayStatus(msgspec.Struct, frozen=True, kw_only=True):
    """Where a replay is."""

    position_s: float
    duration_s: float
    speed: float
    playing: bool


class Halt(Message, frozen=True, kw_only=True):
    """Team-wide emergency halt, or its end."""

    halted: bool
    by: str
    """Who halts: that one may resume, and whoever's name starts with `operator`."""
    reason: str = ""


class HaltAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's answer to the host's verbs halt and resume."""

    robot: str
    halted: bool
    by: list[str] = []
    """Who holds the halt."""
    not_halted: list[str] = []
    """Plugins that failed to stop, or did not say in time that they have."""


class Scan(Message, frozen=True, kw_only=True):
    """One turn of a lidar. The sensor sits at the robot's centre."""

    robot: str
    angle_min_rad: float
    angle_increment_rad: float
    range_max_m: float
    ranges_mm: list[int]
    """Millimetres; 0 is no return within `range_max_m`."""


class ArenaClock(Message, frozen=True, kw_only=True):
    """The arena's time."""

    sim_time_s: float


class RobotTruth(msgspec.Struct, frozen=True, kw_only=True):
    """Where a simulated robot really is."""

    robot: str
    pose: Pose2D
    collisions: int
    distance_m: float
    energy_j: float


class MoteTruth(msgspec.Struct, frozen=True, kw_only=True):
    """Where a simulated mote really is."""

    mote: str
    place: Point2D


class ArenaTruth(Message, frozen=True, kw_only=True):
    """The simulated world as it is; nobody but referees and viewers listens."""

    sim_time_s: float
    robots: list[RobotTruth]
    motes: list[MoteTruth] = []
    explored_fraction: float = 0.0
    """Share of the reachable floor that the team's maps know."""


class OutsideInput(Message, frozen=True, kw_only=True):
    """What reached a lockstep run from another process and may have changed it."""

    key: str
    payload: bytes
