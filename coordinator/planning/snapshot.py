"""The team at one moment, as far as a plan depends on it. Nothing in it changes: others may read it."""

import math
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.energy.energy_model import Work
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.messages.robot_messages import RobotState
from robrain.protocol.wire.messages.task_messages import TaskRecord
from robrain.protocol.wire.reasons.robots import RobotReason

if TYPE_CHECKING:  # brings the map's kernels, which a coordinator loads when it is up (coordinator/live.py)
    from robrain.protocol.model.mapping.occupancy_grid import GridGeometry

HANDLING_S = 1.0
"""Every task takes so long besides: to be offered, to come to a stop. So nothing ends when it begins, either."""
Orders = dict[str, tuple[str, ...]]
"""Tasks of robots, in the order in which they are to be done."""


class Floor(NamedTuple):
    """What is known of the floor at one moment."""

    classes: NDArray[np.int8]
    geometry: "GridGeometry"
    version: int


class AfterCharge(NamedTuple):
    """How a robot will be that charges, or is on its way to."""

    free_ns: int
    charger: Point2D
    soc: float


class ChargerWays(NamedTuple):
    """How far it was for a robot to the chargers that it knows, from where it was."""

    start: Point2D
    ways_m: tuple[tuple[Point2D, float], ...]


class Member(NamedTuple):
    """A robot that can be counted on."""

    state: RobotState
    offers: frozenset[str] | None
    """Its plugins; None if it has not told them: it may have any."""
    chargers: tuple[Point2D, ...]
    home: Point2D
    """Where it ends if it knows no charger: where it started."""
    free_ns: int = 0
    """A robot that charges is free then, and `state` says how it will be; 0 if it is free now."""


class Ending(NamedTuple):
    """The end of the task that a robot is at, where it is near."""

    task: str
    place: Point2D
    in_s: float


class Snapshot(msgspec.Struct, frozen=True, kw_only=True):
    """All that a plan is made from."""

    number: int
    """Of the plan that is made from it."""
    now_ns: int
    cause: str
    records: tuple[TaskRecord, ...]
    """Open tasks that somebody asked for."""
    ended: frozenset[str]
    """Those of the tasks that they wait for which are done."""
    held: frozenset[str] = frozenset()
    """Those that a robot is to begin after the one that it is at."""
    ending: dict[str, Ending] = {}
    """Of robots that are about to end a task; what they do next is planned from there."""
    members: dict[str, Member]
    pauses: dict[tuple[str, str], RobotReason]
    """Which task is not to be offered to which robot now, and why."""
    works: dict[str, tuple[Work, ...]] = {}
    """What each task takes at its place, by the robots that were asked; standing for its service time if none told."""
    served_s: dict[str, float]
    """How long its robot has been at the place of a running task."""
    floor: Floor | None
    orders: Orders
    """As they are planned so far."""
    told: dict[str, tuple[str, ...]]
    """Of each task the robots that the last decision named."""


def urgency(record: TaskRecord) -> tuple[float, float, int, str]:
    """Orders tasks: by priority, then by deadline, then by age."""
    deadline_ns = record.task.deadline_ns
    return (
        -record.task.priority,
        math.inf if deadline_ns is None else deadline_ns,
        record.submitted_ns,
        record.task.id,
    )
