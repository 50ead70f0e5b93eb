"""Robots that are taken out of service, put back, and renamed."""

from types import NoneType
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.errors import ErrorCode
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Name, Text
from robrain.protocol.topic import Query, Urgency


class ServiceHold(msgspec.Struct, frozen=True, kw_only=True):
    """Take a robot out of service: it gets no tasks until it is released, also by a coordinator that is restarted."""

    robot: Name
    reason: Text = ""
    gives_back: bool = False
    """Whether it gives its task back at once, for other robots; otherwise it finishes the task."""
    pauses: bool = False
    """Whether it stops where it is, keeps its task, and continues once it is released."""
    place: Point2D | None = None
    """Where it drives then, arena frame; None if it stays."""
    retires: bool = False
    """Whether the team forgets the robot once it has left the network."""
    by: Text = ""
    """Name of the requester."""


class ServiceRelease(msgspec.Struct, frozen=True, kw_only=True):
    """Put a robot back into service."""

    robot: Name
    by: Text = ""
    """Name of the requester."""


Label = Annotated[str, Meta(max_length=63, pattern=r"^(\S(.*\S)?)?$(?!\n)")]


class RobotRename(msgspec.Struct, frozen=True, kw_only=True):
    """Give a robot a label, by which people know it; keys and files keep its name."""

    robot: Name
    label: Label
    """Not the name or label of another robot; empty to remove it."""
    by: Text = ""
    """Name of the requester."""


class RobotLabel(msgspec.Struct, frozen=True):
    """Label of a robot."""

    text: Label
    """The label; empty if it was removed."""
    by: Text = ""
    """Name of the operator."""


COORDINATOR_HOLD_ROBOT = Query(
    "coordinator/hold_robot", "Take a robot out of service: it gets no tasks", ServiceHold, NoneType,
    urgency=Urgency.DATA_HIGH, errors=(ErrorCode.REFUSED, ))  # fmt: skip
COORDINATOR_RELEASE_ROBOT = Query(
    "coordinator/release_robot", "Put a robot back into service", ServiceRelease, NoneType,
    urgency=Urgency.DATA_HIGH, errors=(ErrorCode.REFUSED, ))  # fmt: skip
COORDINATOR_RENAME_ROBOT = Query(
    "coordinator/rename_robot", "Give a robot a label for people", RobotRename, NoneType,
    errors=(ErrorCode.REFUSED, ))  # fmt: skip
