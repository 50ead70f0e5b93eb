"""Who does which task: nearest first. For a team without a planner; pure.

The most urgent task takes the nearest idle robot that can do it: by priority, then by deadline, then in the order in
which they were asked for. Distances are straight lines.
"""

import math
from collections.abc import Callable, Sequence

from robrain.coordinator.team.roster import Robot
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.messages.task_messages import RobotVerdict, TaskRecord
from robrain.protocol.wire.reasons.robots import AnotherNearer, PositionUnknown, RobotReason

WhyNot = Callable[[TaskRecord, Robot], RobotReason | None]
"""Why a task cannot go to a robot now; None if it can."""


def dispatch(ready: Sequence[TaskRecord], idle: Sequence[Robot], why_not: WhyNot) -> list[tuple[str, str]]:
    """Give each ready task to the nearest idle robot that is left, as long as there is one.

    Args:
        ready: queued tasks that could begin.
        idle: robots that could take one each.
        why_not: what rules a robot out for a task.

    Returns:
        Task and robot of each offer to be made, the most urgent first.

    """
    left = {robot.name: robot for robot in idle}
    offers = []
    for record in sorted(ready, key=_urgency):
        if not left:
            break
        able = [
            (distance_m, name)
            for name, robot in left.items()
            if (distance_m := _distance_m(record.task, robot)) is not None and why_not(record, robot) is None
        ]
        if able:
            chosen = min(able)[1]
            del left[chosen]
            offers.append((record.task.id, chosen))
    return offers


def verdicts(record: TaskRecord, robots: Sequence[Robot], why_not: WhyNot, chosen: str = "") -> list[RobotVerdict]:
    """How each robot stands to a task: how far it is, whether it was chosen, or what rules it out."""
    found = []
    for robot in robots:
        distance_m = _distance_m(record.task, robot)
        is_chosen = robot.name == chosen
        reason = None if is_chosen else why_not(record, robot)
        if reason is None and distance_m is None:
            reason = PositionUnknown()
        if reason is None and chosen and not is_chosen:
            reason = AnotherNearer(chosen)
        rounded_m = None if distance_m is None else round(distance_m, 2)
        found.append(RobotVerdict.judged(robot.name, reason, chosen=is_chosen, distance_m=rounded_m))
    return found


def _urgency(record: TaskRecord) -> tuple[float, float, int]:
    deadline_ns = record.task.deadline_ns
    return (-record.task.priority, math.inf if deadline_ns is None else deadline_ns, record.submitted_ns)


def _distance_m(task: Task, robot: Robot) -> float | None:
    pose = robot.state.pose if robot.state is not None else None
    place = task.place
    return None if pose is None else math.hypot(pose.x_m - place.x_m, pose.y_m - place.y_m)
