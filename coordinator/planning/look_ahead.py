"""The next task is there before the wheels stop: which robots are about to end the one that they are at."""

import math

from robrain.coordinator.team.roster import Robot
from robrain.protocol.model.tasks.stock_kinds import EXPLORE
from robrain.protocol.wire.messages.robot_messages import RobotState
from robrain.protocol.wire.messages.task_messages import TaskRecord

AHEAD_S = 3.0
"""A robot that ends its task within this is offered the next one. Chosen: enough for a new plan and an offer on a slow
link, and short, for what is offered stays where it is though a plan may know better meanwhile."""
LATEST_S = 1.0
"""If there is no new plan by then, the next task is offered by the old one (chosen)."""


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
