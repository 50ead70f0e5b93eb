"""Offer and withdrawal of a task between coordinator and robot, the robot's answer, and the events of a task."""

from typing import Annotated, Any, Self

import msgspec
from msgspec import Meta

from robrain.protocol.messages.message import Message, Result
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Count, Duration, Epoch, Length, Name, Text
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import OfferRefusal, TaskReason, sentence_of
from robrain.protocol.topic import Delivery, Q, Query, R, Topic, Urgency

Lease = Annotated[float, Meta(ge=0.0, le=86_400.0)]
"""Lease of a task, seconds."""


class TaskOffer(msgspec.Struct, frozen=True, kw_only=True):
    """The coordinator's query to a robot: take this on."""

    task: Task
    epoch: Epoch
    lease_s: Lease
    """The robot drops the task when it has received nothing from the coordinator for this time."""
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
        return cls(accepted=False, why=sentence_of(reason), reason=reason, epoch=epoch)


class TaskEvent(Message, frozen=True, kw_only=True):
    """One change of a task."""

    task: Task
    state: TaskState
    robot: Name = ""
    epoch: Epoch = 0
    why: Text = ""
    result: Result = msgspec.field(default_factory=dict)
    """As in the robot's `TaskStatus`."""
    change: Count = 0
    """Number of the change in the coordinator's journal; a repeated number is the same change, sent again."""
    reason: TaskReason | None = None
    """`why` as a value; None if there was no reason, or only its words are known."""

    def moved_in_time(self, by_ns: int) -> Self:
        """The event with its times moved, from its sender's clock to the receiver's."""
        return msgspec.structs.replace(self, stamp_ns=self.stamp_ns + by_ns, task=self.task.moved_in_time(by_ns))


class CostsRequest(msgspec.Struct, frozen=True, kw_only=True):
    """The coordinator's query to a robot: the work of these tasks at their places."""

    tasks: Annotated[list[Task], Meta(max_length=256)]
    """They need not be meant for this robot."""


class TaskCost(msgspec.Struct, frozen=True, kw_only=True):
    """Time and energy of a task at its place, by the robot's plugin for its kind; without the path there."""

    id: Name
    path_m: Length = 0.0
    """Length of the paths driven there."""
    turn_rad: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0
    """Sum of the turns on the spot."""
    wait_s: Duration = 0.0
    """Time standing."""
    radio_packets: Count = 0
    """Packets sent to motes."""
    carried_kg_m: Annotated[float, Meta(ge=0.0, le=1e12)] = 0.0
    """Payload times the length of the path on which it is carried, summed."""
    ends_at: Point2D | None = None
    """Where the robot is after it, arena frame; None for the task's place."""
    why: Text = ""
    """Why the robot cannot estimate it; empty if it can."""


def robot_task_query(verb: str, request: type[Q], reply: type[R], doc: str, **more: Any) -> Query[Q, R]:
    """The row of a query about a robot's tasks, `robot/{robot}/task/VERB`."""
    return Query(f"robot/{{robot}}/task/{verb}", doc, request, reply, alias=f"robot_{verb}",
                 urgency=Urgency.INTERACTIVE_HIGH, **more)  # fmt: skip


ROBOT_OFFER = robot_task_query(
    "offer", TaskOffer, TaskAnswer, "The coordinator offers a task with its fencing epoch and lease")  # fmt: skip
ROBOT_WITHDRAW = robot_task_query("withdraw", TaskWithdrawal, TaskAnswer, "The coordinator withdraws a task")
ROBOT_COSTS = robot_task_query(
    "costs", CostsRequest, list[TaskCost], "Costs of tasks at their places, by the robot's own estimate",
    reads_only=True)  # fmt: skip
TASK_EVENT = Topic(
    "task/event", "Every change of every task, with its reason", TaskEvent, delivery=Delivery.LOSSLESS, cache=1024,
    urgency=Urgency.DATA_HIGH, recorded=True, max_bytes=262_144, earlier="task/event/{task}")  # fmt: skip
