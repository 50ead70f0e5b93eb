"""Messages between robots, and with a coordinator that returns, about tasks while no coordinator is reachable."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.errors import ErrorCode
from robrain.protocol.messages.message import Message
from robrain.protocol.messages.tasks.offer_messages import robot_task_query
from robrain.protocol.messages.tasks.task_messages import TaskRequest, TaskSubmission
from robrain.protocol.model.ballot import Ballot, SeenBallots
from robrain.protocol.model.ranges import Duration, Epoch, Name, Names, Stamp
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.topic import Delivery, Topic, Urgency

ENDS_MAX = 256
"""Tasks done without a coordinator that a robot remembers; at this number it begins no other (chosen)."""

ASKED_MAX = 64
"""Most tasks that a robot remembers as accepted without a coordinator; it then accepts no other (chosen)."""
ASKED_REPORTED = 8
"""Of these in one ballot in full."""
ASKED_BYTES_MAX = 8192
"""Longest submission among them, as JSON: ballots must not grow beyond the limit of their receivers (chosen)."""


ENDED_REPORTED = 64
"""Most ended tasks that a robot reports in one ballot."""

ABSENT_MAX = 64
"""Most tasks in one ballot that unreachable robots may be at."""

CANCELLED_MAX = 64
"""Most cancellations that a robot remembers until a coordinator has recorded them; it then accepts no other
(chosen)."""
CANCELLED_TEXT_MAX = 200
"""Longest name and reason of a cancellation: every ballot has all cancellations."""
CancelledText = Annotated[str, Meta(max_length=CANCELLED_TEXT_MAX)]


class TaskHeld(msgspec.Struct, frozen=True, kw_only=True):
    """A task that a robot does, or holds for later."""

    id: Name
    """Id of the task."""
    epoch: Epoch
    """With which the robot began or accepted it."""


class TaskHeldBy(msgspec.Struct, frozen=True, kw_only=True):
    """A task that a robot that is unreachable now may be at."""

    id: Name
    """Id of the task."""
    robot: Name
    """Robot that reports that it does or holds the task, or wants to begin it."""
    remaining_s: Duration
    """Time until that robot has let it go at the latest."""


class TaskDone(msgspec.Struct, frozen=True, kw_only=True):
    """A task that was done and that no coordinator is known to have recorded."""

    id: Name
    """Id of the task."""
    robot: Name
    """Robot that did it."""
    epoch: Epoch
    """With which that robot began it."""


class TaskAsked(msgspec.Struct, frozen=True, kw_only=True):
    """A task that a robot has accepted while it received no coordinator."""

    submission: TaskSubmission
    """The task as it was submitted."""
    at_ns: Stamp
    """When, by that robot's clock: the submission's times count from then."""


class TaskKnown(msgspec.Struct, frozen=True, kw_only=True):
    """Names a `TaskAsked` that a robot has."""

    id: Name
    """Id of the task."""
    at_ns: Stamp
    """When it was accepted."""


class TaskAcceptance(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's answer to a client that submits a task to it. The same submission again has a newer answer."""

    task: Task
    """As it was accepted."""
    known_to: Names
    """The robots that have it, sorted."""
    is_kept: bool
    """Whether more than half of the team has it: it is not lost with this robot."""


class TaskDropped(msgspec.Struct, frozen=True, kw_only=True):
    """A task that was cancelled at a robot that received no coordinator. No robot begins it."""

    id: Name
    """Id of the task."""
    by: CancelledText = ""
    """Name of the client that cancelled it."""
    why: CancelledText = ""
    """In their own words."""


class CancelAcceptance(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's answer to a client that cancels a task at it. The same request again has a newer answer."""

    task: Task
    """As the robot knows it."""
    known_to: Names
    """The robots that know that it is cancelled, sorted."""
    is_kept: bool
    """Whether more than half of the team knows it: no group of robots that allocates tasks begins it."""


class TeamBallot(Message, frozen=True, kw_only=True):
    """A robot's part in the allocation of tasks without a coordinator: 5 Hz while it receives none."""

    robot: Name
    """Name of the sender."""
    ballot: Ballot
    """Its bids."""
    receives_coordinator: bool = False
    """Whether the robot itself receives a coordinator; then no robot begins tasks that it has queued."""
    is_new: bool = False
    """Whether no coordinator has listed the robot as up since its start; it does not count for a majority then."""
    allocates: bool = False
    """Whether it belongs to a majority that allocates tasks."""
    held: Annotated[list[TaskHeld], Meta(max_length=8)] = msgspec.field(default_factory=list)
    """Tasks that the robot does or holds."""
    done: Annotated[list[TaskDone], Meta(max_length=ENDS_MAX)] = msgspec.field(default_factory=list)
    """All that the robot knows, also those that others did."""
    known: Annotated[list[TaskKnown], Meta(max_length=ASKED_MAX)] = msgspec.field(default_factory=list)
    """Tasks accepted without a coordinator, by any robot, that this robot has and that no coordinator is known to have
    recorded."""
    asked: Annotated[list[TaskAsked], Meta(max_length=ASKED_REPORTED)] = msgspec.field(default_factory=list)
    """Those among them that other robots may not have yet."""

    dropped: Annotated[list[TaskDropped], Meta(max_length=CANCELLED_MAX)] = msgspec.field(default_factory=list)
    """Tasks cancelled without a coordinator that none is known to have recorded, also those cancelled at other
    robots."""
    ended: Annotated[list[Name], Meta(max_length=ENDED_REPORTED)] = msgspec.field(default_factory=list)
    """Tasks that others bid for, or do, although a coordinator has reported to this robot that they have ended."""

    wants: Name = ""
    """Id of the task that the robot begins once more than half of the team has received this; empty for none."""
    receives: SeenBallots = ()
    """Of each robot that this one receives directly, the number of its last ballot."""
    absent: Annotated[list[TaskHeldBy], Meta(max_length=ABSENT_MAX)] = msgspec.field(default_factory=list)
    """Tasks that may be at robots that this one does not receive any more."""

    def __post_init__(self) -> None:
        if self.ballot.robot != self.robot:
            raise ValueError(f"expected the ballot of {self.robot}, got that of {self.ballot.robot}")


ROBOT_SUBMIT = robot_task_query(
    "submit", TaskSubmission, TaskAcceptance, "Submit a task to the robot: replies its holder",
    errors=(ErrorCode.REFUSED,))  # fmt: skip
ROBOT_CANCEL = robot_task_query(
    "cancel", TaskRequest, CancelAcceptance, "Cancel a task of the robot", errors=(ErrorCode.REFUSED,))  # fmt: skip
ROBOT_BALLOT = Topic(
    "robot/{robot}/ballot", "Bids without a coordinator", TeamBallot, rate_hz=5, delivery=Delivery.LATEST,
    urgency=Urgency.DATA_HIGH, recorded=True, max_bytes=2**18)  # fmt: skip
