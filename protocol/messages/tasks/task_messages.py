"""Messages of clients about tasks: the requests `task/…` to the coordinator, and its replies.

As in `message`: JSON, unknown fields ignored, new fields with defaults. Stamps are those of the run's clock.
"""

from enum import StrEnum
from types import NoneType
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from robrain.protocol.clock import to_ns
from robrain.protocol.errors import ErrorCode
from robrain.protocol.messages.message import JsonSchema, Prose, Result
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Charge, Count, Epoch, Name, Names, Priority, Quantity, Seconds, Stamp, Text
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import RobotReason, TaskReason, sentence_of
from robrain.protocol.topic import Q, Query, R, Urgency

Limit = Annotated[int, Meta(ge=-1_000_000, le=1_000_000)]


class TaskSubmission(msgspec.Struct, frozen=True, kw_only=True):
    """Do this. The task's id makes it idempotent: the same submission again has the same answer."""

    task: Task
    by: Text = ""
    """Name of the requester."""
    earliest_in_s: Seconds | None = None
    """Seconds after the coordinator accepts it, in place of the task's `earliest_ns`."""
    deadline_in_s: Seconds | None = None
    """Seconds after the coordinator accepts it, in place of the task's `deadline_ns`."""

    def task_at(self, now_ns: int) -> Task:
        """The task with stamps instead of times that count from its acceptance (ValueError if that is impossible)."""
        times: dict[str, int] = {}
        for name, in_s in (("earliest_ns", self.earliest_in_s), ("deadline_ns", self.deadline_in_s)):
            if in_s is None:
                continue
            if not 0 <= in_s < 1e9:
                raise ValueError(f"expected {name.replace('_ns', '_in_s')} from 0 to 1e9, got {in_s}")
            times[name] = now_ns + to_ns(in_s)
        # Rebuilt, because a task checks itself when it is built, not when it is replaced.
        return msgspec.convert({**msgspec.to_builtins(self.task), **times}, Task) if times else self.task

    def differs_from(self, before: bytes) -> str:
        """Where this submission differs from one of the same id, in words; empty if they are the same.

        Args:
            before: that one, as `word` gives it.

        """
        new, old = (_flat(msgspec.json.decode(text or b"{}")) for text in (self.word, before))
        names = [name for name in sorted({**new, **old}) if new.get(name) != old.get(name)]
        return ", ".join(f"{name} is {_shown(old.get(name))}, not {_shown(new.get(name))}" for name in names)

    @property
    def word(self) -> bytes:
        """The request without the name of the requester, as JSON."""
        return msgspec.json.encode(msgspec.structs.replace(self, by=""))


class TaskEstimate(msgspec.Struct, frozen=True, kw_only=True):
    """When a task is expected to begin and end, in seconds from now, and at what cost."""

    task: Name
    """Its id."""
    robot: Name
    """The robot that does it, or is to do it."""
    starts_in_s: Quantity
    """Until its robot sets out; negative once it has."""
    arrives_in_s: Quantity
    """Until its robot is at the place; 0 once it is."""
    ends_in_s: Quantity
    """Until it ends."""
    ends_low_s: Quantity
    """Lower end of the 90 % interval of `ends_in_s`."""
    ends_high_s: Quantity
    """Upper end of the 90 % interval of `ends_in_s`."""
    energy_j: Quantity
    """Of the path to its place and the work there: without the path to a charger, and without the reserve."""
    is_late: bool = False
    """Whether it will probably miss its deadline."""


class TaskRecord(msgspec.Struct, frozen=True, kw_only=True):
    """A task as it stands in the coordinator's book."""

    task: Task
    state: TaskState
    robot: Name = ""
    """The robot that has it, or had it when it ended."""
    epoch: Epoch = 0
    """Of the last offer."""
    why: Text = ""
    """Why it stands so, in words."""
    result: Result = {}
    """As its robot reported it at the end."""
    changed_ns: Stamp = 0
    """When it last changed, by the coordinator's clock."""
    change: Count = 0
    """Number of its last change in the journal; grows over all tasks."""
    submitted_ns: Stamp = 0
    """When it was accepted."""
    by: Text = ""
    """Name of the requester."""
    own: bool = False
    """Whether the coordinator created it: such a task is not retried."""
    attempts: Count = 0
    """Number of robots that have failed at it."""
    reason: TaskReason | None = None
    """Why it stands so; None if there is no reason, or only its words are known, as from an older journal."""
    recalled: bool = False
    """Whether its robot is to give it back, because the task was changed; it is queued once the robot has."""
    estimate: TaskEstimate | None = None
    """Of an open task that a plan includes, as of the answer."""

    @property
    def event(self) -> TaskEvent:
        """Its last change as an event; the publisher sets the stamp."""
        return TaskEvent(
            stamp_ns=self.changed_ns,
            task=self.task,
            state=self.state,
            robot=self.robot,
            epoch=self.epoch,
            why=self.why,
            result=self.result,
            change=self.change,
            reason=self.reason,
        )


class TaskRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A query about one task: cancel, get, why; or one mission: cancel."""

    id: Name
    by: Text = ""
    why: Text = ""
    """cancel: the reason."""


class TaskFilter(msgspec.Struct, frozen=True, kw_only=True):
    """Selects tasks; an empty field matches all."""

    states: Annotated[list[TaskState], Meta(max_length=64)] = []
    """Only tasks in these states; any if empty."""
    kinds: Annotated[list[Name], Meta(max_length=64)] = []
    """Tags of the task types, such as `visit`."""
    robot: Name = ""
    by: Text = ""
    """Name of the requester, or of the rule."""
    prefix: Name = ""
    """Only tasks whose ids begin so."""
    own: bool = False
    """Include tasks that the coordinator created."""
    limit: Limit = 1000
    """At most this many tasks, the most recently accepted ones."""


class TaskUpdate(msgspec.Struct, frozen=True, kw_only=True):
    """Changes or cancels tasks that were submitted and have not ended. It is refused if it is wrong for one of them.

    A robot gives back a task whose robot or times change, or that is paused; then the task is queued. The same update
    again changes nothing, but times count from then.
    """

    ids: Names = []
    """The tasks, unless `which` is given."""
    which: TaskFilter | None = None
    """Selects open tasks instead; its `limit` and `own` do not count."""
    by: Text = ""
    why: Text = ""
    """Reason of the change."""
    priority: Priority | None = None
    """None, as of the fields below: it stays as it is."""
    earliest_in_s: Seconds | None = None
    """Earliest start, seconds after the coordinator accepts the update."""
    deadline_in_s: Seconds | None = None
    """Latest end, seconds after the coordinator accepts the update."""
    robot: Name = ""
    """The robot that must do them from now on."""
    excluded: Name = ""
    """A robot that must not do them from now on."""
    paused: bool | None = None
    """True pauses them, False resumes them."""
    cancels: bool = False
    """Whether they are cancelled."""


class KnownKind(msgspec.Struct, frozen=True, kw_only=True):
    """A kind of task that robots of the team do."""

    kind: Name
    """As it stands in `Task.kind`."""
    doc: Prose = ""
    parameters: JsonSchema = {}
    """JSON Schema of `Task.parameters`, as its robots announce it."""
    robots: Names = []
    """Robots that do it."""


class TaskChange(msgspec.Struct, frozen=True, kw_only=True):
    """One line of a task's history."""

    number: Count
    """Number of the change in the journal."""
    stamp_ns: Stamp
    state: TaskState
    robot: Name = ""
    epoch: Epoch = 0
    why: Text = ""
    """The reason in words."""
    reason: TaskReason | None = None


class RobotVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """Resources that a robot would need for a task, or the reason of its exclusion."""

    robot: Name
    chosen: bool = False
    """Whether it has the task."""
    refusal: Text = ""
    """Why it does not get the task, in words; empty if it could."""
    reason: RobotReason | None = None
    """The same as a value."""
    distance_m: Quantity | None = None
    """Straight-line distance to the task; null if unknown."""
    path_m: Quantity | None = None
    """Length of the path to it, from where the robot is before."""
    arrives_in_s: Quantity | None = None
    """Time until it is at the place."""
    energy_j: Quantity | None = None
    """Of the path and the work at the place."""
    left_soc: Charge | None = None
    """State of charge when it is at a charger afterwards."""

    @classmethod
    def judged(
        cls,
        robot: str,
        reason: RobotReason | None = None,
        *,
        chosen: bool = False,
        energy_j: float | None = None,
    ) -> "RobotVerdict":
        """A verdict whose text is that of its reason."""
        return cls(robot=robot, chosen=chosen, refusal=sentence_of(reason), reason=reason, energy_j=energy_j)


class RemedyKind(StrEnum):
    """Kind of a change with which a task could be done."""

    BATTERY = "battery"
    """A robot had a full battery."""
    ROBOT = "robot"
    """A robot that plans exclude now could be used."""
    TASK = "task"
    """Another task was not there."""
    PATH = "path"
    """An obstacle was not there, such as a closed door."""


class Remedy(msgspec.Struct, frozen=True, kw_only=True):
    """A change of the present with which a plan would include a task that it leaves out."""

    kind: RemedyKind
    name: Name = ""
    """Of the robot or the task."""
    place: Point2D | None = None
    """Of the obstacle, arena frame."""
    ends_in_s: Quantity | None = None
    """When the task would end then."""

    @property
    def words(self) -> str:
        """The change as a condition: `if r2 had a full battery`."""
        match self.kind:
            case RemedyKind.BATTERY:
                return f"if {self.name} had a full battery"
            case RemedyKind.ROBOT:
                return f"if {self.name} could be used"
            case RemedyKind.TASK:
                return f"without {self.name}"
            case RemedyKind.PATH:
                place = "" if self.place is None else f" at ({self.place.x_m:g}, {self.place.y_m:g})"
                return f"if the path{place} were open"


Remedies = Annotated[list[Remedy], Meta(max_length=1000)]


class TaskExplanation(msgspec.Struct, frozen=True, kw_only=True):
    """Why a task stands as it does."""

    record: TaskRecord
    """The task and how it stands."""
    now: Text
    """In one sentence."""
    reason: TaskReason | None = None
    """Reason in that sentence, beside the task's state."""
    robots: Annotated[list[RobotVerdict], Meta(max_length=100_000)] = []
    """As judged last, sorted by name."""
    decided_ns: Stamp = 0
    """When they were judged; 0 if never."""
    changes: Annotated[list[TaskChange], Meta(max_length=100_000)] = []
    """The last ones, oldest first."""
    remedies: Remedies = []
    """Of a task that the plan leaves out: single changes with which it could be done, the soonest end first."""


class TaskDelay(msgspec.Struct, frozen=True, kw_only=True):
    """The effect of a new task on another open task."""

    task: Name
    later_s: Quantity | None = None
    """How much later it would end; None if no plan would include it any more."""
    misses_deadline: bool = False
    """Whether it would miss its deadline for this."""


class TaskDryRun(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a submission if it came now. Nothing follows from asking."""

    task: Task
    """As it would enter the book; if the book has it already, as it stands there."""
    refused: Text = ""
    """Why it would be refused, in words; empty if it would be accepted."""
    known: TaskState | None = None
    """State of the same task in the book: submitting it again would change nothing. None if it is new."""
    waits: Text = ""
    """Conditions before any robot can begin it, as text; empty if there are none."""
    reason: TaskReason | None = None
    """The same as a value."""
    robots: Annotated[list[RobotVerdict], Meta(max_length=100_000)] = []
    """By robot name: the reason of its exclusion now, or the cost by a plan with the task."""
    ahead: Count = 0
    """Open tasks of at least its priority that no robot has begun."""
    estimate: TaskEstimate | None = None
    """By a plan with the task; None if no robot would do it."""
    delays: Annotated[list[TaskDelay], Meta(max_length=100_000)] = []
    """Other open tasks that would end later, or not be done."""
    remedies: Remedies = []
    """As in `TaskExplanation`."""
    blocks: Annotated[list[Text], Meta(max_length=100_000)] = []
    """Tasks, robots and chargers that no other robot gets to while one is at the task."""


def _flat(value: object, name: str = "") -> dict[str, object]:
    if not isinstance(value, dict):
        return {name: value}
    found: dict[str, object] = {}
    for key, part in value.items():
        found |= _flat(part, key if name in ("", "task", "parameters") else f"{name}.{key}")
    return found


def _shown(value: object) -> str:
    return "unset" if value is None else msgspec.json.encode(value).decode()


PLAN_S = 10.0
"""Timeout of queries for whose answer a plan is made."""


def _task_query(verb: str, request: type[Q], reply: type[R], doc: str, **more: Any) -> Query[Q, R]:
    return Query(f"task/{verb}", doc, request, reply, urgency=Urgency.INTERACTIVE_HIGH, errors=(ErrorCode.REFUSED,),
                 **more)  # fmt: skip


TASK_SUBMIT = _task_query("submit", TaskSubmission, TaskRecord, "Submit a task: replies its record, or refuses it")
TASK_DRY_RUN = _task_query(
    "dry_run", TaskSubmission, TaskDryRun, "Expected result if the task were submitted now",
    reads_only=True, timeout_s=PLAN_S)  # fmt: skip
TASK_CANCEL = _task_query("cancel", TaskRequest, TaskRecord, "Cancel a task: replies its record")
TASK_CHANGE = _task_query(
    "change", TaskUpdate, list[TaskRecord], "Change, pause, resume or cancel tasks: replies their records")  # fmt: skip
TASK_LIST = _task_query("list", TaskFilter, list[TaskRecord], "Records of tasks", reads_only=True)
TASK_GET = _task_query("get", TaskRequest, TaskRecord, "Record of one task", reads_only=True)
TASK_KINDS = _task_query("kinds", NoneType, list[KnownKind], "Kinds of tasks that the robots offer", reads_only=True)
TASK_EXPLAIN = _task_query(
    "explain", TaskRequest, TaskExplanation, "Reason of a task's state", reads_only=True, timeout_s=PLAN_S)  # fmt: skip
