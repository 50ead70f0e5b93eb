"""Situations to plan from, for tests of what makes the plans."""

from robrain.coordinator.planning.snapshot import PlanningRobot, Snapshot
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState


def open_floor_snapshot(number: int, tasks: int, robots: int = 2) -> Snapshot:
    """Tasks all over a floor without walls, and robots with all the energy that they want."""
    records = tuple(
        TaskRecord(
            task=Task(id=f"t{k}", kind="visit", place=Point2D((7 * k) % 11 + 0.5, (5 * k) % 13 + 0.5)),
            state=TaskState.QUEUED,
        )
        for k in range(tasks)
    )
    members = {
        f"r{k}": PlanningRobot(
            RobotState(robot=f"r{k}", pose=Pose2D(3.0 * k, 2.0, 0.0)), None, (), Point2D(3.0 * k, 2.0)
        )
        for k in range(robots)
    }
    return Snapshot(
        number=number, now_ns=0, cause="test", records=records, ended=frozenset(), members=members, pauses={},
        served_s={}, floor=None, orders={},
    )  # fmt: skip
