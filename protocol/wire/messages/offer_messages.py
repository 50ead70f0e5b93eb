"""Offer and withdrawal of a task between coordinator and robot, and the robot's answer."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import (
    Epoch,
    Name,
    Text,
)
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.reasons import OfferRefusal, told

Lease = Annotated[float, Meta(ge=0.0, le=86_400.0)]
"""Lease of a task, seconds."""


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
