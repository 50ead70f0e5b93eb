"""Parameters of the stock kinds of tasks."""

from collections.abc import Sequence
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Final

import msgspec
from msgspec import Meta

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Duration, Name, PositiveDuration, Quantity, Radians
from robrain.protocol.model.tasks.task import BadParameters, Task, parameters_of

EXPLORE: Final = "explore"
VISIT: Final = "visit"
INSPECT: Final = "inspect"
COLLECT: Final = "collect"
RELAY: Final = "relay"
MONITOR: Final = "monitor"
SENSE: Final = "sense"
SEEK: Final = "seek"
REPLACE: Final = "replace"
RECHARGE: Final = "recharge"
PATROL: Final = "patrol"
DELIVER: Final = "deliver"
SWEEP: Final = "sweep"
FOLLOW: Final = "follow"
GUARD: Final = "guard"
Area = Annotated[list[Point2D], Meta(min_length=3, max_length=64)]
Kilograms = Annotated[float, Meta(ge=0.0, le=1e5)]


class TaskParameters(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """Parameters of a kind of task besides the common fields; derive from it. By itself: nothing."""

    @property
    def json(self) -> dict[str, Any]:
        """As a task carries them."""
        content: dict[str, Any] = msgspec.to_builtins(self)
        return content

    @property
    def further_places(self) -> Sequence[Point2D]:
        """Places after the task's own, arena frame. A robot that cannot reach them refuses the task."""
        return ()


class Inspect(TaskParameters, frozen=True, kw_only=True):
    """Go to a place and take a picture. Result: `image`, the key under which it was published."""

    look_at: Point2D | None = None
    """Point to photograph, arena frame; None for the view in front of the robot."""


class Collect(TaskParameters, frozen=True, kw_only=True):
    """Go near a mote and take the readings that it has stored along. Result: `readings`, how many came."""

    mote: Name
    timeout_s: PositiveDuration = 60.0
    """Longest wait at the mote."""


class Relay(TaskParameters, frozen=True, kw_only=True):
    """Be the link to a mote, to another robot, or between the two, for a time.

    Result: `share_linked`, and `rssi_dbm` (the mean) of the mote or, without one, of the robot.
    """

    mote: Name = ""
    duration_s: PositiveDuration
    rssi_min_dbm: Quantity = -85.0
    """If a link is weaker than this, the robot moves nearer."""
    robot: Name = ""
    """The next robot of a chain; a link to it is held as well."""
    SCHEMA_RULES: ClassVar[dict[str, Any]] = {
        "$comment": "expected a mote or a robot to be the link to, got neither",
        "anyOf": [{"required": [name], "properties": {name: {"minLength": 1}}} for name in ("mote", "robot")],
    }

    def __post_init__(self) -> None:
        if not (self.mote or self.robot):
            raise ValueError("expected a mote or a robot to be the link to, got neither")


class Monitor(TaskParameters, frozen=True, kw_only=True):
    """Watch a room: turn around at intervals and report changes. Result: `rounds`, `changes`, `images`.

    With a `quantity` a mote that is there may do it instead. Result then: `rounds`, `least`, `greatest`, `mote`.
    """

    duration_s: PositiveDuration
    interval_s: PositiveDuration = 30.0
    """From the start of one round to the start of the next."""
    views: Annotated[int, Meta(ge=1, le=16)] = 4
    """Directions per round, spread evenly over the circle."""
    quantity: Name = ""
    """Quantity that a mote may watch instead of pictures; empty for pictures only."""


class Sense(TaskParameters, frozen=True, kw_only=True):
    """Bring one reading from a place. Result: `value`, `quantity`, `mote`."""

    quantity: Name = "temperature_c"
    mote: Name = ""
    """The mote to read; if empty, the one with the strongest signal at the place."""
    timeout_s: PositiveDuration = 30.0
    """Time limit for a reading."""


class Seek(TaskParameters, frozen=True, kw_only=True):
    """Find where a quantity is greatest: climb its field from the place on, by readings along the path.

    Result: `x_m`, `y_m`, and the `value` there, as fitted to the readings; `sd_m`, the uncertainty of the place.
    `at_wall` is true if the value rises further behind an obstacle to the robot. `samples` were recorded, and
    `received` readings of motes have arrived.
    """

    quantity: Name = "temperature_c"
    duration_s: PositiveDuration = 180.0
    """Time limit at the place."""
    reach_m: Annotated[float, Meta(gt=0.0, le=1000.0)] = 15.0
    """Range of the search around the place."""


class Replace(TaskParameters, frozen=True, kw_only=True):
    """Stand in for a mote: sense at its place, as often as it did. Result: `readings`."""

    mote: Name
    duration_s: PositiveDuration
    period_s: PositiveDuration = 4.0


class Recharge(TaskParameters, frozen=True, kw_only=True):
    """Dock at a charger, which is the place, and stay until the battery is full enough.

    Result: `soc`, `docked_m`, and `charged_j`; `energy_j` is the energy to get there.
    """

    yaw_rad: Radians | None = None
    """Heading of the docked robot; None leaves it to the robot."""
    until_soc: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.95
    """State of charge."""


class Patrol(TaskParameters, frozen=True, kw_only=True):
    """Visit places in turn, beginning at the task's place, and come back to it. Result: `rounds`, `longest_round_s`."""

    stops: Annotated[list[Point2D], Meta(min_length=1, max_length=64)]
    """Places to visit after the task's own, arena frame."""
    rounds: Annotated[int, Meta(ge=1, le=1000)] = 1
    """How often it visits all of them."""
    pause_s: Duration = 0.0
    """Time at each place."""

    @property
    def further_places(self) -> Sequence[Point2D]:
        """All stops."""
        return self.stops


class Item(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A further item of a delivery."""

    pick_up: Point2D
    """Arena frame."""
    to: Point2D
    payload_kg: Kilograms = 0.0


class Deliver(TaskParameters, frozen=True, kw_only=True):
    """Pick up an item at the task's place and bring it somewhere; further items on the same trip.

    The robot stops for `service_s` at each place. If it is interrupted with items on board, only this robot can do the
    rest. Result: `delivered` items.
    """

    to: Point2D
    """Where the item goes, arena frame."""
    payload_kg: Kilograms = 0.0
    """Mass of the item."""
    items: Annotated[list[Item], Meta(max_length=15)] = []
    """Further items. The robot chooses the order of its stops within its capacity."""

    @property
    def further_places(self) -> Sequence[Point2D]:
        """Where items are picked up and go."""
        return [self.to, *(place for item in self.items for place in (item.pick_up, item.to))]


class Sweep(TaskParameters, frozen=True, kw_only=True):
    """Drive over an area in lanes. Result: `covered_share` of the floor that the robot can reach there, `lanes`."""

    area: Area
    """Corners in order, arena frame, or the name of a zone."""
    width_m: Annotated[float, Meta(ge=0.1, le=100.0)]
    """Working width: greatest distance between two lanes."""


class Follow(TaskParameters, frozen=True, kw_only=True):
    """Follow a robot, or a point that moves. Result: `near_share` of the time, `moved_m`."""

    duration_s: PositiveDuration
    robot: Name = ""
    """The robot; without it the point, first the task's place, which the plugin's call `point` moves."""
    distance_m: Annotated[float, Meta(ge=0.5, le=100.0)] = 1.5
    """Distance at which the robot stops."""


class Guard(Monitor, frozen=True, kw_only=True):
    """Stand where most of an area is seen, and report changes there. Result: as of monitor, and `seen_share`."""

    area: Area
    """Corners in order, arena frame, or the name of a zone."""
    views: Annotated[int, Meta(ge=1, le=16)] = 1
    """Directions per round, spread evenly over the area."""


STOCK_KINDS: MappingProxyType[str, type[TaskParameters]] = MappingProxyType(
    {
        VISIT: TaskParameters,
        INSPECT: Inspect,
        COLLECT: Collect,
        RELAY: Relay,
        MONITOR: Monitor,
        EXPLORE: TaskParameters,
        REPLACE: Replace,
        SENSE: Sense,
        SEEK: Seek,
        RECHARGE: Recharge,
        PATROL: Patrol,
        DELIVER: Deliver,
        SWEEP: Sweep,
        FOLLOW: Follow,
        GUARD: Guard,
    }
)
"""The type of the parameters of each kind."""


def places_of(task: Task) -> list[Point2D]:
    """The places to which a task leads, in the arena frame; of a kind with other parameters only its own place."""
    try:
        return [task.place, *parameters_of(task, STOCK_KINDS.get(task.kind, TaskParameters)).further_places]
    except BadParameters:
        return [task.place]


def check_parameters(task: Task) -> None:
    """Raise BadParameters if a task of a stock kind has parameters that do not fit; of other kinds nothing is known."""
    if task.kind in STOCK_KINDS:
        parameters_of(task, STOCK_KINDS[task.kind])
