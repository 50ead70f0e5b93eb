"""What robots tell each other, and a coordinator that returns, about tasks while no coordinator is heard."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.consensus.ballot import Ballot
from robrain.protocol.model.ranges import Epoch, Name
from robrain.protocol.wire.messages.message import Message

ENDS_MAX = 256
"""Tasks done without a coordinator that a robot remembers; with so many it begins no other (chosen)."""


class TaskHeld(msgspec.Struct, frozen=True, kw_only=True):
    """A task that a robot does, or holds for later."""

    id: Name
    """Id of the task."""
    epoch: Epoch
    """With which the robot began or accepted it."""


class TaskDone(msgspec.Struct, frozen=True, kw_only=True):
    """A task that was done and that no coordinator is known to have noted."""

    id: Name
    """Id of the task."""
    robot: Name
    """Who did it."""
    epoch: Epoch
    """With which that robot began it."""


class TeamBallot(Message, frozen=True, kw_only=True):
    """A robot's part in the allocation of tasks without a coordinator: 5 Hz while it hears none."""

    robot: Name
    """Who says it."""
    ballot: Ballot
    """Its bids."""
    hears_coordinator: bool = False
    """Whether the robot itself hears a coordinator; then nobody takes tasks that it has queued."""
    held: Annotated[list[TaskHeld], Meta(max_length=8)] = msgspec.field(default_factory=list)
    """Tasks that the robot does or holds."""
    done: Annotated[list[TaskDone], Meta(max_length=ENDS_MAX)] = msgspec.field(default_factory=list)
    """All that the robot knows of, also those that others did."""

    def __post_init__(self) -> None:
        if self.ballot.robot != self.robot:
            raise ValueError(f"expected the ballot of {self.robot}, got that of {self.ballot.robot}")
