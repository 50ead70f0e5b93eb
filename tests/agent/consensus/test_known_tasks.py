"""What a robot may begin by itself: tasks whose predecessors were done, as far as it has heard."""

import pytest

from robrain.agent.consensus.known_tasks import KnownTasks
from robrain.agent.consensus.task_intake import TaskIntake
from robrain.agent.robot_tasks import RobotTasks
from robrain.protocol.messages.tasks.consensus_messages import TaskDone, TaskDropped
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.task_messages import TaskRequest
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState

FIRST = Task(id="t1", kind="visit", place=Point2D(1.0, 1.0))
NEXT = Task(id="t2", kind="visit", place=Point2D(1.0, 1.0), after=("t1",))


@pytest.fixture
def known() -> KnownTasks:
    one = KnownTasks()
    for task in (FIRST, NEXT):
        one.receive(TaskEvent(task=task, state=TaskState.QUEUED))
    return one


def ready(known: KnownTasks) -> list[str]:
    return [task.id for task in known.ready(0)]


def test_a_task_waits_for_the_one_before_it(known: KnownTasks) -> None:
    assert ready(known) == ["t1"]


@pytest.mark.parametrize("told_again", [False, True])
@pytest.mark.parametrize("state", [TaskState.CANCELLED, TaskState.FAILED])
def test_it_is_not_begun_after_one_that_was_not_done_although_its_own_end_was_not_heard(
    known: KnownTasks, state: TaskState, told_again: bool
) -> None:
    known.receive(TaskEvent(task=FIRST, state=state))
    if told_again:  # a teammate has told that it has ended, without how
        known.record_ended(["t1"])
    assert ready(known) == []


def test_it_may_begin_once_that_was_done_or_has_ended_somehow_as_mates_say(known: KnownTasks) -> None:
    known.record_done([TaskDone(id="t1", robot="r2", epoch=1)])
    assert ready(known) == ["t2"]
    known.receive(TaskEvent(task=FIRST, state=TaskState.DONE))
    assert ready(known) == ["t2"]
    other = KnownTasks()
    other.receive(TaskEvent(task=NEXT, state=TaskState.QUEUED))
    other.record_ended(["t1"])
    assert ready(other) == ["t2"]


def test_a_cancellation_counts_only_until_the_task_is_done_and_the_first_one_counts(known: KnownTasks) -> None:
    ann, ben = TaskDropped(id="t1", by="ann", why=""), TaskDropped(id="t1", by="ben", why="")
    known.drop([ann, ben])
    assert known.dropped == {"t1": ann}
    known.record_done([TaskDone(id="t2", robot="r2", epoch=1)])
    known.drop([TaskDropped(id="t2", by="ann", why="")])
    assert "t2" not in known.dropped
    assert known.is_done("t2")


# -- cancellations that are certain ---------------------------------------------------------------------------------

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
