"""A robot that has not heard of all changes of tasks asks for the open ones."""

from collections.abc import Iterator

import pytest

from robrain.agent.consensus.known_tasks import ASK_AGAIN_NS, GRACE_NS, OPEN, TASKS_MAX, KnownTasks, TaskSync
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.consensus_messages import TaskAsked, TaskDone
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.task_messages import TASK_LIST, TaskFilter, TaskRecord, TaskSubmission
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint, Request


class Looking:
    """A robot's look at the tasks, and a coordinator with some that are open."""

    def __init__(self, session) -> None:
        self.clock = VirtualClock()
        self.wire = Endpoint(session, "team", self.clock, Drive.LOCKSTEP)
        self.coordinator = Endpoint(session, "team", self.clock, Drive.LOCKSTEP)
        self.known = KnownTasks()
        self.look = TaskSync(self.wire, self.known)
        self.open: list[TaskRecord] = []
        self.asked: list[TaskFilter] = []
        self.refuses = False
        self.coordinator.answer(TASK_LIST, self._list)

    def _list(self, request: Request[TaskFilter]) -> list[TaskRecord]:
        self.asked.append(request.asked)
        if self.refuses:
            raise CallError(ErrorCode.FAILED, "the journal cannot be read")
        return self.open

    def receive(self, name: str, change: int, state: TaskState = TaskState.QUEUED) -> None:
        event = TaskEvent(task=visit(name), state=state, change=change)
        self.known.receive(event, self.clock.now_ns())
        self.look.receive(event, self.clock.now_ns())

    def summary(self, last_change: int) -> None:
        self.look.receive_summary(last_change, self.clock.now_ns())

    def wait(self, duration_ns: int) -> None:
        self.clock.advance_to(self.clock.now_ns() + duration_ns)

    def run(self, duration_ns: int) -> None:
        for _ in range(duration_ns // to_ns(0.1) + 1):
            self.look.step(self.clock.now_ns())
            self.wait(to_ns(0.1))


def visit(name: str) -> Task:
    return Task(id=name, kind="visit", place=Point2D(1.0, 2.0))


def record(name: str, change: int = 0) -> TaskRecord:
    return TaskRecord(task=visit(name), state=TaskState.QUEUED, change=change)


@pytest.fixture
def looking(lockstep_session) -> Iterator[Looking]:
    looking = Looking(lockstep_session)
    yield looking
    looking.wire.close()
    looking.coordinator.close()


def test_who_has_heard_of_all_changes_in_whatever_order_asks_nothing(looking: Looking) -> None:
    for change in (2, 1, 3, 3):
        looking.receive(f"t{change}", change)
    looking.summary(3)
    looking.run(5 * ASK_AGAIN_NS)
    assert looking.asked == []
    assert looking.look.behind_since_ns is None


def test_an_event_that_comes_after_the_summary_that_counts_it_is_waited_for(looking: Looking) -> None:
    looking.summary(1)
    assert looking.look.behind_since_ns == 0
    looking.run(GRACE_NS // 2)
    looking.receive("t1", 1)
    looking.run(5 * ASK_AGAIN_NS)
    assert looking.asked == []


def test_who_began_later_is_told_of_the_open_tasks(looking: Looking) -> None:
    looking.open = [record("t4", 4), record("t7", 9)]
    looking.summary(9)
    looking.run(GRACE_NS)
    assert looking.asked == [TaskFilter(states=OPEN, limit=TASKS_MAX)]
    assert sorted(looking.known.open) == ["t4", "t7"]
    assert looking.look.behind_since_ns is None
    looking.run(5 * ASK_AGAIN_NS)
    assert len(looking.asked) == 1


@pytest.mark.parametrize("heard_after", [True, False], ids=["a later event", "the summary alone"])
def test_a_lost_end_of_a_task_is_noticed(looking: Looking, heard_after: bool) -> None:
    looking.receive("t1", 1)
    looking.wait(to_ns(1.0))
    if heard_after:
        looking.receive("t2", 3)
        looking.open = [record("t2", 3)]
    else:
        looking.summary(2)
    looking.run(GRACE_NS)
    assert looking.known.has_ended("t1")
    assert sorted(looking.known.open) == (["t2"] if heard_after else [])
    assert looking.look.behind_since_ns is None


def test_what_was_heard_since_the_question_is_not_taken_back(looking: Looking) -> None:
    looking.known.receive(TaskEvent(task=visit("t5"), state=TaskState.QUEUED), now_ns=10)
    looking.known.adopt_open_tasks([], asked_ns=5, now_ns=20)
    assert "t5" in looking.known.open
    looking.known.adopt_open_tasks([], asked_ns=11, now_ns=20)
    assert looking.known.has_ended("t5")


def test_as_many_open_tasks_as_a_robot_remembers_say_nothing_of_others(looking: Looking) -> None:
    looking.receive("old", 1)
    looking.wait(to_ns(1.0))
    looking.open = [record(f"t{number}") for number in range(TASKS_MAX)]
    looking.summary(400)
    looking.run(GRACE_NS)
    assert not looking.known.has_ended("old")


def test_a_task_that_robots_have_accepted_stays_though_the_coordinator_does_not_know_it(looking: Looking) -> None:
    looking.known.ask(TaskAsked(submission=TaskSubmission(task=visit("ours")), at_ns=0))
    looking.known.record_done([TaskDone(id="ours", robot="r1", epoch=1)])
    looking.wait(to_ns(1.0))
    looking.summary(4)
    looking.run(GRACE_NS)
    assert not looking.known.has_ended("ours")
    assert looking.known.is_done("ours")


def test_a_refused_question_is_asked_again_after_a_second(looking: Looking) -> None:
    looking.refuses = True
    looking.summary(1)
    looking.run(GRACE_NS + 2 * ASK_AGAIN_NS)
    assert len(looking.asked) == 3
    assert looking.look.behind_since_ns == 0
    looking.refuses = False
    looking.run(ASK_AGAIN_NS)
    assert looking.look.behind_since_ns is None


def test_a_coordinator_with_another_journal_is_asked(looking: Looking) -> None:
    for change in (1, 2, 3):
        looking.receive("t1", change)
    looking.summary(3)
    looking.wait(to_ns(1.0))
    looking.summary(1)
    looking.run(GRACE_NS)
    assert len(looking.asked) == 1
    assert looking.known.has_ended("t1")
