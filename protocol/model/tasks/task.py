"""Tasks: work that a robot can be asked to do, and its states.

A task of any kind is one struct. Fields that only one kind has are in `parameters`, plain JSON. The behavior that does
this kind reads it as the kind's type (`parameters_of`). A field that has its default does not travel.
"""

import math
from enum import StrEnum
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import NAME_MAX, STAMP_MAX, Duration, Name, Priority, Stamp

NEEDS_MAX = 64
Needs = Annotated[tuple[Name, ...], Meta(max_length=NEEDS_MAX)]
After = Annotated[tuple[Name, ...], Meta(max_length=1000)]
Team = Annotated[int, Meta(ge=1, le=1000)]
Parameters = Annotated[dict[str, Any], Meta(max_length=64)]
"""A JSON object."""
P = TypeVar("P", bound=msgspec.Struct)
LOST_AFTER_S = 0.8
"""A robot that is silent for this long has lost contact, whatever its token reports: eight states (chosen). With the
time that its last state was in flight, every participant knows within a second."""
LEASE_S = 1.5
"""Silence of the coordinator after which a robot releases its task (chosen: three summaries)."""
FREE_AFTER_S = 2.0
"""Silence after which a robot's task is free. The difference to the lease is the guard time (chosen). The robot's host
steps every 20 ms, its last state may be 100 ms old, and a summary may be in flight."""
MEMBER_PREFIX = "mote:"
"""Begins the `robot` of a task that a mote does; no robot's name can begin so."""


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
        return self in ENDED


ENDED = frozenset((TaskState.DONE, TaskState.FAILED, TaskState.CANCELLED))
"""The states that nothing follows."""


class Task(Checked, frozen=True, kw_only=True, omit_defaults=True):
    """Something to do at one place. Raises ValueError if built with values that make no sense."""

    id: Annotated[str, Meta(min_length=1, max_length=NAME_MAX)]
    kind: Annotated[str, Meta(min_length=1, max_length=NAME_MAX)]
    """Kind of task, as its behavior declares it, such as `visit`."""
    place: Point2D
    """Arena frame."""
    priority: Priority = 1.0
    """Reward for doing it: a task of priority 2 is worth two of priority 1."""
    earliest_ns: Annotated[int, Meta(ge=0, le=STAMP_MAX)] = 0
    """It must not begin before this stamp of the run's clock."""
    deadline_ns: Stamp | None = None
    """It must be done by this stamp; None for no deadline."""
    service_s: Duration = 0.0
    """Expected time at its place; a visit stays this long."""
    needs: Needs = ()
    """Names of plugins that a robot must have for it, besides the behavior; the name of a robot means that robot."""
    excluded: Needs = ()
    """Names of robots that must not do it."""
    paused: bool = False
    """Whether it is not offered until it is resumed."""
    after: After = ()
    """Ids of the tasks that must be done before."""
    same_robot_as: Name = ""
    """Id of the task whose robot must do this one too; empty for any robot."""
    robots: Team = 1
    """Number of robots that must work on it at the same time."""
    parameters: Parameters = msgspec.field(default_factory=dict)
    """Parameters of its kind, as JSON."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.deadline_ns is not None and self.deadline_ns <= self.earliest_ns:
            raise ValueError(f"expected deadline_ns after earliest_ns {self.earliest_ns}, got {self.deadline_ns}")
        if not (math.isfinite(self.place.x_m) and math.isfinite(self.place.y_m)):
            raise ValueError(f"expected a finite place, got {self.place}")
        if self.same_robot_as and self.robots > 1:
            raise ValueError(f"expected one robot with same_robot_as, got robots {self.robots}")

    @property
    def others(self) -> tuple[str, ...]:
        """Ids of the tasks that it depends on."""
        return (*self.after, self.same_robot_as) if self.same_robot_as else self.after

    def moved_in_time(self, by_ns: int) -> "Task":
        """The task with its times moved, from one clock to another."""
        deadline_ns = None if self.deadline_ns is None else max(1, self.deadline_ns + by_ns)
        return msgspec.structs.replace(self, earliest_ns=max(0, self.earliest_ns + by_ns), deadline_ns=deadline_ns)


class BadParameters(ValueError):
    """Parameters that do not fit the kind of a task.

    Args:
        kind: the kind of task.
        field: the parameter, with dots where it is nested; empty if the mistake is in none alone.
        why: text of the problem; empty if it is missing.

    """

    def __init__(self, kind: str, field: str, why: str) -> None:
        self.kind = kind
        self.field = field
        self.why = why
        super().__init__(self.words(field))

    def words(self, name: str) -> str:
        """Text of the problem, with another name for the field, such as an option's."""
        if not self.why:
            return f"a task to {self.kind} needs {name}"
        return f"{name}: {self.why}" if name else self.why


def parameters_of(task: Task, type_: type[P]) -> P:
    """The parameters of a task as the type that its kind has for them.

    Raises:
        BadParameters: they do not fit.

    >>> from robrain.protocol.model.tasks.stock_kinds import Relay
    >>> task = Task(id="t", kind="relay", place=Point2D(0.0, 0.0), parameters={"mote": "m1"})
    >>> parameters_of(task, Relay)
    Traceback (most recent call last):
    robrain.protocol.model.tasks.task.BadParameters: a task to relay needs duration_s
    """
    try:
        return msgspec.convert(task.parameters, type_)
    except msgspec.ValidationError as error:
        why, _, path = str(error).partition(" - at `$")
        field = path.rstrip("`").removeprefix(".")
        missing = why.removeprefix("Object missing required field ")
        if missing != why:
            name = ".".join(part for part in (field, missing.strip("`")) if part)
            raise BadParameters(task.kind, name, "") from error
        unknown = why.removeprefix("Object contains unknown field ")
        if unknown != why:
            names = ", ".join(sorted(one.name for one in msgspec.structs.fields(type_))) or "none"
            why = f"a task to {task.kind} has no such parameter, but {names}"
            raise BadParameters(task.kind, unknown.strip("`"), why) from error
        raise BadParameters(task.kind, field, why) from error
