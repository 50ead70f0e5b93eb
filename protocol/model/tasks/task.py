"""Tasks: what a robot can be asked to do, and the states that it goes through.

`Task` is a tagged union; the tag is the field `type` on the wire. What all kinds have in common has a default, and a
field that has its default does not travel: a task of an older peer decodes, and an `Explore` still is what it was.
"""

import math
from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Duration, Name, Priority, Quantity, Radians, Share, Stamp

Needs = Annotated[tuple[Name, ...], Meta(max_length=64)]
After = Annotated[tuple[Name, ...], Meta(max_length=1000)]
Team = Annotated[int, Meta(ge=1, le=1000)]


class TaskState(StrEnum):
    """`queued → offered → running → done | failed | cancelled`; `lost_contact` is apart from failed."""

    QUEUED = "queued"
    OFFERED = "offered"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"
    LOST_CONTACT = "lost_contact"

    @property
    def ended(self) -> bool:
        """Nothing follows this state."""
        return self in (TaskState.DONE, TaskState.FAILED, TaskState.CANCELLED)


class TaskBase(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Fields of every task. Raises ValueError if built with values that make no sense."""

    id: Name
    priority: Priority = 1.0
    """Reward for doing it: a task of priority 2 is worth two of priority 1."""
    earliest_ns: Stamp = 0
    """It must not begin before this stamp of the run's clock."""
    deadline_ns: Stamp | None = None
    """It must be done by this stamp; None for no deadline."""
    service_s: Duration = 0.0
    """Expected time at its place; a visit stays this long."""
    needs: Needs = ()
    """Names of plugins that a robot must have for it, besides the behavior."""
    after: After = ()
    """Ids of the tasks that must be done before."""
    robots: Team = 1
    """Number of robots that must work on it at the same time."""

    def __post_init__(self) -> None:
        if not self.id:
            raise ValueError("expected a task to have an id, got an empty one")
        check_numbers(self, above=("priority",), not_below=("earliest_ns", "service_s"))
        if self.deadline_ns is not None and self.deadline_ns <= self.earliest_ns:
            raise ValueError(f"expected deadline_ns after earliest_ns {self.earliest_ns}, got {self.deadline_ns}")
        if self.robots < 1:
            raise ValueError(f"expected robots >= 1, got {self.robots}")


class Explore(TaskBase, frozen=True, kw_only=True, tag="explore", omit_defaults=True):
    """Go to a border of the known and see what lies behind it."""

    goal: Point2D
    """Arena frame."""


class PlacedTask(TaskBase, frozen=True, kw_only=True, omit_defaults=True):
    """A task that is done at one place."""

    place: Point2D
    """Arena frame."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.place.x_m) and math.isfinite(self.place.y_m)):
            raise ValueError(f"expected a finite place, got {self.place}")


class Visit(PlacedTask, frozen=True, kw_only=True, tag="visit", omit_defaults=True):
    """Go to a place, and stay there for `service_s`."""


class Inspect(PlacedTask, frozen=True, kw_only=True, tag="inspect", omit_defaults=True):
    """Go to a place and take a picture. Result: `image`, the key under which it was published."""

    look_at: Point2D | None = None
    """What is to be in the picture, arena frame; None takes what is in front."""


class Collect(PlacedTask, frozen=True, kw_only=True, tag="collect", omit_defaults=True):
    """Go near a mote and take the readings that it has stored along. Result: `readings`, how many came."""

    mote: Name
    timeout_s: Duration = 60.0
    """Longest wait at the mote."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, above=("timeout_s",))


class Relay(PlacedTask, frozen=True, kw_only=True, tag="relay", omit_defaults=True):
    """Be the link to a mote, to another robot, or between the two, for a time.

    Result: `share_linked`, and `rssi_dbm` (the mean) of the mote or, without one, of the robot.
    """

    mote: Name = ""
    duration_s: Duration
    rssi_min_dbm: Quantity = -85.0
    """If a link is weaker than this, the robot moves nearer."""
    robot: Name = ""
    """The next robot of a chain; a link to it is held as well."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, above=("duration_s",), finite=("rssi_min_dbm",))
        if not (self.mote or self.robot):
            raise ValueError("expected a mote or a robot to be the link to, got neither")


class Monitor(PlacedTask, frozen=True, kw_only=True, tag="monitor", omit_defaults=True):
    """Watch a room: look around at intervals and tell what has changed. Result: `rounds`, `changes`, `images`.

    With a `quantity` a mote that is there may do it instead. Result then: `rounds`, `least`, `greatest`, `mote`.
    """

    duration_s: Duration
    interval_s: Duration = 30.0
    """From the start of one round to the start of the next."""
    views: Annotated[int, Meta(ge=1, le=16)] = 4
    """Directions per round, spread evenly over the circle."""
    quantity: Name = ""
    """Quantity that a mote may watch instead of pictures; empty for pictures only."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, above=("duration_s", "interval_s"))
        if not 1 <= self.views <= 16:
            raise ValueError(f"expected views from 1 to 16, got {self.views}")


class Sense(PlacedTask, frozen=True, kw_only=True, tag="sense", omit_defaults=True):
    """Bring one reading from a place. Result: `value`, `quantity`, `mote`."""

    quantity: Name = "temperature_c"
    mote: Name = ""
    """The mote to read; if empty, the one heard best at the place."""
    timeout_s: Duration = 30.0
    """Time limit for a reading."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, above=("timeout_s",))


class Replace(PlacedTask, frozen=True, kw_only=True, tag="replace", omit_defaults=True):
    """Stand in for a mote: sense at its place, as often as it did. Result: `readings`."""

    mote: Name
    duration_s: Duration
    period_s: Duration = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(self, above=("duration_s", "period_s"))


class Recharge(PlacedTask, frozen=True, kw_only=True, tag="recharge", omit_defaults=True):
    """Dock at a charger, which is the place, and stay until the battery is full enough.

    Result: `soc`, `docked_m`, and `charged_j`; `energy_j` is what it took to get there.
    """

    yaw_rad: Radians | None = None
    """Heading of the docked robot; None leaves it to the robot."""
    until_soc: Share = 0.95
    """State of charge, above 0 to 1."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.until_soc <= 1:
            raise ValueError(f"expected until_soc above 0 and at most 1, got {self.until_soc}")
        if self.yaw_rad is not None and not math.isfinite(self.yaw_rad):
            raise ValueError(f"expected a finite yaw_rad, got {self.yaw_rad}")


Task = Visit | Inspect | Collect | Relay | Monitor | Explore | Replace | Sense | Recharge
"""The tagged union of everything a robot can be asked to do."""


def place_of(task: Task) -> Point2D:
    """Where a task is done, arena frame; of an `Explore` its goal."""
    return task.goal if isinstance(task, Explore) else task.place


def kind_of(task: Task) -> str:
    """The task's kind as its tag says it.

    >>> kind_of(Visit(id="t", place=Point2D(0.0, 0.0)))
    'visit'
    """
    return str(type(task).__struct_config__.tag)


def check_numbers(
    task: msgspec.Struct, *, above: tuple[str, ...] = (), not_below: tuple[str, ...] = (), finite: tuple[str, ...] = ()
) -> None:
    """Raise ValueError, naming the field, unless these are finite and above 0, not below 0, or just finite."""
    for name in (*above, *not_below, *finite):
        value = getattr(task, name)
        if not math.isfinite(value):
            raise ValueError(f"expected a finite {name}, got {value}")
        if name in above and not value > 0:
            raise ValueError(f"expected {name} > 0, got {value}")
        if name in not_below and not value >= 0:
            raise ValueError(f"expected {name} >= 0, got {value}")
