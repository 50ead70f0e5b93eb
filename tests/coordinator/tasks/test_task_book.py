import sqlite3

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, consumes, invariant, precondition, rule

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.tasks.task_book import ATTEMPTS, LEGAL, TaskBook
from robrain.protocol.clock import VirtualClock
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import LeaseRanOut, PlainReason, cancelled, plain

GOAL = Point2D(1.0, 2.0)
ROBOTS = st.sampled_from(["r1", "r2"])


def book(journal=None):
    told = []
    return TaskBook(VirtualClock(), 100, told.append, journal), told


def running(one, task_id="t1", robot="r1", **fields):
    one.add(Task(id=task_id, kind="visit", place=GOAL), **fields)
    record = one.offered(task_id, robot)
    one.move(task_id, TaskState.RUNNING)
    return record


class BookMachine(RuleBasedStateMachine):
    """A coordinator that does what it may, and robots that say anything."""

    tasks = Bundle("tasks")

    def __init__(self):
        super().__init__()
        self.clock = VirtualClock()
        self.told = []
        self.book = TaskBook(self.clock, 7, self.told.append)
        self.granted = set()
        self.count = 0

    def state_of(self, task_id):
        return next((record for record in self.book.open if record.task.id == task_id), None)

    @rule(target=tasks, own=st.booleans())
    def add(self, own):
        self.count += 1
        self.book.add(Task(id=f"t{self.count}", kind="explore", place=GOAL), own=own)
        return f"t{self.count}"

    @rule(task_id=tasks, robot=ROBOTS)
    def offer(self, task_id, robot):
        record = self.state_of(task_id)
        if record is None or record.state is not TaskState.QUEUED:
            return
        before = max((event.epoch for event in self.told), default=7)
        epoch = self.book.offered(task_id, robot).epoch
        assert epoch > before
        self.granted.add((task_id, robot, epoch))

    @rule(task_id=tasks, lost=st.booleans())
    def contact(self, task_id, lost):
        record = self.state_of(task_id)
        if record is not None and record.state in (TaskState.OFFERED, TaskState.LOST_CONTACT):
            self.book.move(task_id, TaskState.RUNNING)
        elif record is not None and record.state is TaskState.RUNNING and lost:
            self.book.move(task_id, TaskState.LOST_CONTACT, plain("lost_contact", "words"))

    @rule(task_id=tasks)
    def lease_runs_out(self, task_id):
        record = self.state_of(task_id)
        if record is not None and record.robot:
            self.book.give_back(task_id, LeaseRanOut("r1"))

    @rule(task_id=consumes(tasks))
    def cancel(self, task_id):
        if self.state_of(task_id) is not None:
            self.book.move(task_id, TaskState.CANCELLED, cancelled("ann", ""))

    @precondition(lambda self: self.count)
    @rule(number=st.integers(1, 20), robot=ROBOTS, state=st.sampled_from(list(TaskState)), late=st.integers(0, 2))
    def robot_speaks(self, number, robot, state, late):
        task_id = f"t{1 + number % self.count}"
        record = self.state_of(task_id)
        told = len(self.told)
        epoch = (record.epoch if record is not None else 8) - late
        changed = self.book.record_status(robot, TaskStatus(id=task_id, epoch=epoch, state=state, why="so it is"))
        its_own = record is not None and record.robot == robot and late == 0 and state.ended
        done_before = record is not None and state is TaskState.DONE and (task_id, robot, epoch) in self.granted
        counts = its_own or done_before
        assert (changed == record) if counts else (changed is None)
        assert len(self.told) - told == counts

    @rule(duration_ns=st.integers(1, 10**9))
    def time_passes(self, duration_ns):
        self.clock.advance_to(self.clock.now_ns() + duration_ns)

    @invariant()
    def every_change_is_told_in_legal_order(self):
        states = {}
        for event in self.told:
            assert event.state in LEGAL[states.get(event.task.id)]
            states[event.task.id] = event.state
        still_open = {task_id: state for task_id, state in states.items() if not state.ended}
        assert {record.task.id: record.state for record in self.book.open} == still_open

    @invariant()
    def what_is_told_is_in_the_journal(self):
        for event in self.told[-3:]:
            lines = {line.number: line for line in self.book.journal.history(event.task.id)}
            assert (lines[event.change].state, lines[event.change].why) == (event.state, event.why)
            assert lines[event.change].reason == event.reason

    @invariant()
    def epochs_only_grow(self):
        offers = [event.epoch for event in self.told if event.state is TaskState.OFFERED]
        assert offers == sorted(set(offers))

    @invariant()
    def no_robot_has_a_task_that_is_queued(self):
        assert all(bool(record.robot) == (record.state is not TaskState.QUEUED) for record in self.book.open)

    @invariant()
    def a_robot_is_at_the_task_that_it_was_offered_first(self):
        """Whatever becomes of them: silence, and a robot that is back, change nothing about the order."""
        for robot in ("r1", "r2"):
            bound = sorted((one for one in self.book.open if one.robot == robot), key=lambda one: one.epoch)
            assert self.book.bound_to(robot) == bound
            assert self.book.of_robot(robot) == next(iter(bound), None)
            assert self.book.next_of(robot) == next(iter(bound[1:]), None)

    @invariant()
    def a_book_that_is_opened_anew_says_the_same(self):
        again = TaskBook(self.clock, 7, lambda event: None, self.book.journal)
        assert [again.bound_to(robot) for robot in ("r1", "r2")] == [
            self.book.bound_to(robot) for robot in ("r1", "r2")
        ]

    @invariant()
    def done_is_counted(self):
        assert self.book.done_count == sum(event.state is TaskState.DONE for event in self.told)


TestBookMachine = pytest.mark.slow(BookMachine.TestCase)
TestBookMachine.settings = settings(max_examples=15, stateful_step_count=30, deadline=None)


def test_each_change_is_told_with_robot_epoch_and_why():
    one, told = book()
    running(one, own=True)
    one.move("t1", TaskState.FAILED, PlainReason("the way is blocked"))
    assert [(event.state, event.robot, event.epoch, event.why, event.change) for event in told] == [
        (TaskState.QUEUED, "", 0, "", 1),
        (TaskState.OFFERED, "r1", 101, "", 2),
        (TaskState.RUNNING, "r1", 101, "", 3),
        (TaskState.FAILED, "r1", 101, "the way is blocked", 4),
    ]
    assert one.open == []


def test_what_the_journal_does_not_take_is_neither_in_the_book_nor_told(monkeypatch):
    one, told = book()
    running(one)

    def full(_record):
        raise JournalUnwritable(None, "cannot be written: the disk is full")

    monkeypatch.setattr(one.journal, "change", full)
    before = len(told)
    with pytest.raises(JournalUnwritable):
        one.record_status("r1", TaskStatus(id="t1", epoch=101, state=TaskState.DONE))
    assert (len(told), one.open[0].state, one.done_count) == (before, TaskState.RUNNING, 0)


@pytest.mark.parametrize("taken", [False, True])
def test_what_a_robot_has_done_counts_though_its_task_was_given_back(taken):
    one, told = book()
    epoch = running(one).epoch
    one.give_back("t1", LeaseRanOut("r1"))
    if taken:
        one.offered("t1", "r2")
        one.move("t1", TaskState.RUNNING)
    for state in (TaskState.FAILED, TaskState.CANCELLED):  # only what is done is done
        assert one.record_status("r1", TaskStatus(id="t1", epoch=epoch, state=state)) is None
    assert one.record_status("r1", TaskStatus(id="t1", epoch=epoch, state=TaskState.DONE, why="there")) is not None
    assert (told[-1].state, told[-1].robot, told[-1].epoch) == (TaskState.DONE, "r1", epoch)
    assert told[-1].why == ("r1 had done it before it was given to another" if taken else "there")
    assert one.open == []


def test_a_robot_that_lets_go_gives_the_task_back():
    one, told = book()
    record = running(one)
    one.record_status(
        "r1", TaskStatus(id="t1", epoch=record.epoch, state=TaskState.CANCELLED, why="the robot is halted")
    )
    assert (told[-1].state, told[-1].robot, told[-1].why) == (TaskState.QUEUED, "", "the robot is halted")
    assert one.open[0].attempts == 0


def test_a_task_of_the_coordinators_own_is_not_tried_again():
    for state in (TaskState.FAILED, TaskState.CANCELLED):
        one, told = book()
        record = running(one, own=True)
        one.record_status("r1", TaskStatus(id="t1", epoch=record.epoch, state=state, why="no way there"))
        assert (told[-1].state, told[-1].why) == (state, "no way there")
        assert one.open == []


def test_a_task_fails_when_so_many_robots_have_failed_at_it():
    one, told = book()
    running(one)
    for attempt in range(1, ATTEMPTS):
        one.record_status("r1", TaskStatus(id="t1", epoch=one.open[0].epoch, state=TaskState.FAILED, why="blocked"))
        assert told[-1].state is TaskState.QUEUED
        assert told[-1].why == f"r1 failed: blocked; attempt {attempt} of {ATTEMPTS}"
        one.offered("t1", "r1")
    one.record_status("r1", TaskStatus(id="t1", epoch=one.open[0].epoch, state=TaskState.FAILED, why="blocked"))
    assert (told[-1].state, told[-1].why) == (TaskState.FAILED, "blocked")


def test_a_change_that_cannot_follow_is_a_mistake():
    one, _ = book()
    one.add(Task(id="t1", kind="visit", place=GOAL))
    with pytest.raises(ValueError, match="task t1: running cannot follow queued"):
        one.move("t1", TaskState.RUNNING)
    one.move("t1", TaskState.CANCELLED)
    with pytest.raises(KeyError):
        one.move("t1", TaskState.QUEUED)
    with pytest.raises(sqlite3.IntegrityError):
        one.add(Task(id="t1", kind="visit", place=GOAL))


def test_a_book_goes_on_where_its_journal_ends():
    journal = Journal()
    one, _ = book(journal)
    epoch = running(one).epoch
    running(one, "t2", "r2")
    one.record_status("r2", TaskStatus(id="t2", epoch=epoch + 1, state=TaskState.DONE))
    other, told = book(journal)
    assert [(record.task.id, record.state, record.epoch) for record in other.open] == [("t1", TaskState.RUNNING, epoch)]
    assert other.done_count == 1
    other.republish(10)
    assert [(event.task.id, event.state, event.change) for event in told] == [
        ("t1", TaskState.RUNNING, 3),
        ("t2", TaskState.DONE, 7),
    ]


def test_the_task_that_a_robot_is_at_comes_before_its_next_one_after_a_loss_of_contact_and_after_a_restart():
    journal = Journal()
    one, _ = book(journal)
    one.add(Task(id="next", kind="visit", place=GOAL))
    running(one)
    one.offered("next", "r1")
    one.move("t1", TaskState.LOST_CONTACT)
    for each in (one, book(journal)[0]):
        assert [record.task.id for record in each.bound_to("r1")] == ["t1", "next"]
