"""What a robot is asked about the cost of tasks, and its answers."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import Count, Duration, Length, Name, Text
from robrain.protocol.model.tasks.task import Task


class CostsRequest(msgspec.Struct, frozen=True, kw_only=True):
    """The coordinator's query to a robot: tell what these tasks would take at their places."""

    tasks: Annotated[list[Task], Meta(max_length=256)]
    """They need not be meant for this robot."""


class TaskCost(msgspec.Struct, frozen=True, kw_only=True):
    """What a task takes at its place, by the plugin of the robot that does its kind; the way there is not counted."""

    id: Name
    path_m: Length = 0.0
    """Length of the paths driven there."""
    turn_rad: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0
    """Sum of the turns on the spot."""
    wait_s: Duration = 0.0
    """Time standing."""
    radio_packets: Count = 0
    """Packets sent to motes."""
    why: Text = ""
    """Why the robot cannot tell; empty if it can."""
