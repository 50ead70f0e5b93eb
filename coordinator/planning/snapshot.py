"""The state of the team at one moment, with all data that plans depend on. Immutable, so threads can share it."""

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.energy_model import Work
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.model.zone import Zone
from robrain.protocol.reasons import RobotReason, TaskReason

if TYPE_CHECKING:  # brings the map's kernels, which a coordinator loads when it is up (coordinator/live.py)
    from robrain.protocol.model.grid_geometry import GridGeometry

HANDLING_S = 1.0
"""Overhead of every task: to be offered, and to come to a stop. So no task ends when it begins."""
Orders = dict[str, tuple[str, ...]]
"""Tasks of robots, in order."""


class Floor(NamedTuple):
    """The known map at one moment."""

    classes: NDArray[np.int8]
    geometry: "GridGeometry"
    version: int
    zones: tuple[Zone, ...] = ()
    """All that hold; keep-out zones for all robots are occupied in `classes` already."""


class AfterCharge(NamedTuple):
    """Predicted state of a robot after its charge."""

    free_ns: int
    charger: Point2D
    soc: float


class ChargerDistances(NamedTuple):
    """Path lengths from a robot's place to the chargers that it knows."""

    start: Point2D
    lengths_m: tuple[tuple[Point2D, float], ...]


class PlanningRobot(NamedTuple):
    """A robot that plans can use."""

    state: RobotState
    offers: frozenset[str] | None
    """Its plugins; None if it has not announced them and may have any."""
    chargers: tuple[Point2D, ...]
    home: Point2D
    """End place of a robot that knows no charger: where it started."""
    free_ns: int = 0
    """When a charging robot will be free, in the state `state`; 0 if the robot is free now."""
    charge_w: float = 0.0
    """Power of the slowest of its chargers; 0 if it knows none."""


class PredictedEnd(NamedTuple):
    """The predicted end of a robot's task, if it is near."""

    task: str
    place: Point2D
    in_s: float


class Snapshot(msgspec.Struct, frozen=True, kw_only=True):
    """The input of a plan."""

    number: int
    """Number of the plan."""
    now_ns: int
    cause: str
    records: tuple[TaskRecord, ...]
    """Open tasks that were submitted."""
    ended: frozenset[str]
    """Tasks that open tasks depend on and that are done."""
    held: frozenset[str] = frozenset()
    """Tasks that a robot will begin after its running one."""
    ending: dict[str, PredictedEnd] = {}
    """Of robots that are about to end a task; their next tasks are planned from there."""
    members: dict[str, PlanningRobot]
    pauses: dict[tuple[str, str], RobotReason]
    """Which task must not be offered to which robot now, and why."""
    waiting: dict[str, TaskReason] = {}
    """Queued tasks that no plan may include yet, and why."""
    works: dict[str, tuple[Work, ...]] = {}
    """Cost of each task at its place, by the robots that were asked; waiting for its service time if none answered."""
    served_s: dict[str, float]
    """How long the robot of a running task has been at its place."""
    floor: Floor | None
    orders: Orders
    """Of the previous plan."""


def urgency(record: TaskRecord) -> tuple[float, float, int, str]:
    """Sort key of tasks: by priority, then deadline, then age."""
    deadline_ns = record.task.deadline_ns
    return (
        -record.task.priority,
        math.inf if deadline_ns is None else deadline_ns,
        record.submitted_ns,
        record.task.id,
    )


def end_of(task: Task, works: Mapping[str, Iterable[Work]]) -> Point2D:
    """Where a robot is at the end of a task, by the works of all tasks."""
    return next((work.ends_at for work in works.get(task.id, ()) if work.ends_at is not None), task.place)
