"""Which robots plans can count on: those that are out, and why; and those that are about to end their task."""

import math

from robrain.coordinator.team.roster import Robot
from robrain.protocol.model.tasks.stock_kinds import EXPLORE, RECHARGE
from robrain.protocol.wire.messages.robot_messages import RobotState
from robrain.protocol.wire.messages.task_messages import TaskRecord
from robrain.protocol.wire.reasons.robots import Charging, Halted, HeadsHome, PositionUnknown, RobotReason, SentToCharge

HOMEWARD = frozenset({"recharge", "go home"})
"""Behaviors, as a robot tells them, that it does not leave for any task when it began them of its own accord."""

AHEAD_S = 3.0
"""A robot that ends its task within this is offered the next one. Chosen: enough for a new plan and an offer on a slow
link, and short, for what is offered stays where it is though a plan may know better meanwhile."""
LATEST_S = 1.0
"""If there is no new plan by then, the next task is offered by the old one (chosen)."""


def why_out(robot: Robot, at: TaskRecord | None, now_ns: int) -> RobotReason | None:
    """Why a robot is no part of plans now; None if it is.

    Args:
        robot: as the roster knows it.
        at: the task that it is at.
        now_ns: the time.

    """
    if (unavailable := robot.why_not_up(now_ns)) is not None:
        return unavailable
    state = robot.state
    if state is None or state.pose is None:
        return PositionUnknown()
    if state.halted:
        return Halted()
    if at is not None and at.task.kind == RECHARGE:
        return SentToCharge(at.task.id)
    is_busy = state.task is not None and not state.task.state.ended
    if state.behavior in HOMEWARD and not is_busy:
        return Charging() if state.battery is not None and state.battery.charging else HeadsHome()
    if at is None and state.lost:
        return PositionUnknown(state.lost)
    return None


def is_charging(robot: Robot, at: TaskRecord | None) -> bool:
    """Whether a robot is out because it charges or goes to charge, and will be free when it has."""
    state = robot.state
    if state is None or state.halted or state.lost:
        return False
    if at is not None:
        return at.task.kind == RECHARGE
    is_busy = state.task is not None and not state.task.state.ended
    return state.behavior in HOMEWARD and not is_busy


def free_in_s(robot: Robot, records: list[TaskRecord]) -> float:
    """In how long a robot can begin something else; infinite if it is not to be offered anything for then yet.

    Args:
        robot: as the roster knows it.
        records: the open tasks that it has by the book, the one that it is at first.

    """
    if not records:
        return 0.0
    at, state = records[0], robot.state
    if at.own:
        return 0.0 if at.task.kind == EXPLORE else math.inf
    if len(records) > 1 or state is None or state.next_task is not None:
        return math.inf
    left_s = left_of(at, state)
    return left_s if left_s <= AHEAD_S else math.inf


def left_of(at: TaskRecord, state: RobotState) -> float:
    """In how long a robot ends the task that it is at by the book, as it says; infinite if it does not."""
    status = state.task
    is_at_it = status is not None and (status.id, status.epoch) == (at.task.id, at.epoch) and not status.state.ended
    return status.left_s if is_at_it and status is not None and status.left_s is not None else math.inf


def is_ending(state: RobotState | None) -> bool:
    """Whether a robot says that it is about to end its task."""
    left_s = state.task.left_s if state is not None and state.task is not None else None
    return left_s is not None and left_s <= AHEAD_S
