"""What is said about tasks by those who ask for them: the requests `task/…` to the coordinator, and its replies.

As in `messages`: JSON, unknown fields ignored, new fields with defaults. Stamps are those of the run's clock.
"""

from typing import Any

import msgspec

from robrain.protocol.model.task import Task, TaskState
from robrain.protocol.wire.messages import TaskEvent


class TaskSubmission(msgspec.Struct, frozen=True, kw_only=True):
    """Do this. The task's id makes it idempotent: the same submission again has the same answer."""

    task: Task
    by: str = ""
    """Who asks."""
    earliest_in_s: float | None = None
    """Counted from when the coordinator accepts it, in place of the task's `earliest_ns`."""
    deadline_in_s: float | None = None
    """Counted from when the coordinator accepts it, in place of the task's `deadline_ns`."""


class TaskRecord(msgspec.Struct, frozen=True, kw_only=True):
    """A task as it stands in the coordinator's book."""

    task: Task
    state: TaskState
    robot: str = ""
    """Whose it is, or was when it ended."""
    epoch: int = 0
    """Of the last offer."""
    why: str = ""
    result: dict[str, Any] = {}
    """What its robot told of it at the end."""
    changed_ns: int = 0
    """When it last changed, by the coordinator's clock."""
    change: int = 0
    """Number of its last change in the journal; grows over all tasks."""
    submitted_ns: int = 0
    by: str = ""
    """Who asked for it."""
    own: bool = False
    """Whether the coordinator made it for itself: such a task is not tried again."""
    attempts: int = 0
    """How many robots have failed at it."""

    @property
    def event(self) -> TaskEvent:
        """Its last change, as it is told; whoever sends it puts his own stamp on it."""
        return TaskEvent(
            stamp_ns=self.changed_ns,
            task=self.task,
            state=self.state,
            robot=self.robot,
            epoch=self.epoch,
            why=self.why,
            result=self.result,
            change=self.change,
        )


class TaskRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A query about one task: cancel, get, why."""

    id: str
    by: str = ""
    why: str = ""
    """cancel: the reason."""


class TaskFilter(msgspec.Struct, frozen=True, kw_only=True):
    """Which tasks are asked for; what is empty matches all."""

    states: list[TaskState] = []
    kinds: list[str] = []
    """As the tag says them: `visit`."""
    robot: str = ""
    by: str = ""
    own: bool = False
    """Those, too, that the coordinator made for itself."""
    limit: int = 1000
    """The last so many, in the order in which they were accepted."""


class TaskChange(msgspec.Struct, frozen=True, kw_only=True):
    """One line of a task's history."""

    number: int
    stamp_ns: int
    state: TaskState
    robot: str = ""
    epoch: int = 0
    why: str = ""


class RobotVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """What a robot would need for a task, or why it is ruled out."""

    robot: str
    chosen: bool = False
    why_not: str = ""
    distance_m: float | None = None
    energy_j: float | None = None
    time_s: float | None = None


class TaskWhy(msgspec.Struct, frozen=True, kw_only=True):
    """Why a task stands as it does."""

    record: TaskRecord
    now: str
    """In one sentence."""
    robots: list[RobotVerdict] = []
    """As they were judged last, by name."""
    decided_ns: int = 0
    """When they were; 0 if never."""
    changes: list[TaskChange] = []
    """The last ones, oldest first."""
