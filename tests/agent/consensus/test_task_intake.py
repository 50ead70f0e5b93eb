"""When a cancellation that a robot accepts may be told to the client as certain."""

import pytest

from robrain.agent.consensus.known_tasks import KnownTasks
from robrain.agent.consensus.task_intake import TaskIntake
from robrain.agent.robot_tasks import RobotTasks
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.task_messages import TaskRequest
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState

KNOWS, KNOWS_NOT = {"t1"}, {"t2"}


def is_kept(teammates: dict[str, set[str]], holder: str, team: int = 3) -> bool:
    """Whether a cancellation at r1 is, if the teammates know of these."""
    known = KnownTasks()
    known.receive(TaskEvent(task=Task(id="t1", kind="visit", place=Point2D(1.0, 1.0)), state=TaskState.RUNNING))
    return TaskIntake("r1", known, RobotTasks()).drop(TaskRequest(id="t1"), teammates, team, holder).is_kept


@pytest.mark.parametrize(
    ("teammates", "holder", "kept"),
    [
        ({"r2": KNOWS, "r3": KNOWS_NOT}, "r3", False),  # more than half know, but it may just have done the task
        ({"r2": KNOWS, "r3": KNOWS}, "r3", True),
        ({"r2": KNOWS, "r3": KNOWS_NOT}, "r2", True),
        ({"r2": KNOWS, "r3": KNOWS_NOT}, "r1", True),  # the robot that is asked has the task itself
        ({"r2": KNOWS, "r3": KNOWS_NOT}, "", True),
        ({"r2": KNOWS}, "r3", True),  # the holder is not heard: more than half is all that can be had
        ({"r2": KNOWS_NOT, "r3": KNOWS_NOT}, "", False),
    ],
)
def test_a_cancellation_is_kept_once_more_than_half_and_the_holder_of_the_task_know(
    teammates: dict[str, set[str]], holder: str, kept: bool
) -> None:
    assert is_kept(teammates, holder) == kept


def test_half_of_the_team_is_not_more_than_half() -> None:
    assert not is_kept({"r2": KNOWS, "r3": KNOWS_NOT, "r4": KNOWS_NOT}, "", team=4)
