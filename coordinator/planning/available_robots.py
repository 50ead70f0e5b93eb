"""Which robots plans can count on."""

from robrain.coordinator.team.roster import Robot
from robrain.protocol.model.tasks.stock_kinds import RECHARGE
from robrain.protocol.wire.messages.task_messages import TaskRecord
from robrain.protocol.wire.reasons.robots import Charging, Halted, HeadsHome, PositionUnknown, RobotReason, SentToCharge

HOMEWARD = frozenset({"recharge", "go home"})
"""Behaviors, as a robot tells them, that it does not leave for any task when it began them of its own accord."""


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
