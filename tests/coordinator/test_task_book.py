import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, consumes, invariant, precondition, rule

from robrain.coordinator.task_book import KEPT_ENDED, TaskBook
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.task import Explore, TaskState
from robrain.protocol.wire.clock import VirtualClock
from robrain.protocol.wire.messages import TaskStatus

GOAL = Point2D(1.0, 2.0)
LEGAL = {
    None: {TaskState.QUEUED},
    TaskState.QUEUED: {TaskState.OFFERED, TaskState.CANCELLED},
    TaskState.OFFERED: {TaskState.RUNNING, TaskState.CANCELLED, TaskState.DONE, TaskState.FAILED},
    TaskState.RUNNING: {TaskState.DONE, TaskState.FAILED, TaskState.CANCELLED, TaskState.LOST_CONTACT},
    TaskState.LOST_CONTACT: {TaskState.RUNNING, TaskState.DONE, TaskState.FAILED, TaskState.CANCELLED},
}
ROBOTS = st.sampled_from(["r1", "r2"])


def book():
    told = []
    return TaskBook(VirtualClock(), 100, told.append), told


def running(one, task_id="t1", robot="r1"):
    one.add(Explore(id=task_id, goal=GOAL))
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
        self.count = 0

    def state_of(self, task_id):
        return next((record for record in self.book.open if record.task.id == task_id), None)

    @rule(target=tasks)
    def add(self):
        self.count += 1
        self.book.add(Explore(id=f"t{self.count}", goal=GOAL))
        return f"t{self.count}"

    @rule(task_id=tasks, robot=ROBOTS)
    def offer(self, task_id, robot):
        record = self.state_of(task_id)
        if record is None or record.state is not TaskState.QUEUED:
            return
        before = max((event.epoch for event in self.told), default=7)
        assert self.book.offered(task_id, robot).epoch > before

    @rule(task_id=tasks, lost=st.booleans())
    def contact(self, task_id, lost):
        record = self.state_of(task_id)
        if record is not None and record.state in (TaskState.OFFERED, TaskState.LOST_CONTACT):
            self.book.move(task_id, TaskState.RUNNING)
        elif record is not None and record.state is TaskState.RUNNING and lost:
            self.book.move(task_id, TaskState.LOST_CONTACT, "silent")

    @rule(task_id=consumes(tasks))
    def cancel(self, task_id):
        if self.state_of(task_id) is not None:
            self.book.move(task_id, TaskState.CANCELLED, "no longer wanted")

    @precondition(lambda self: self.count)
    @rule(
        number=st.integers(1, 20),
        robot=ROBOTS,
        state=st.sampled_from(list(TaskState)),
        late=st.integers(0, 2),
    )
    def robot_speaks(self, number, robot, state, late):
        task_id = f"t{1 + number % self.count}"
        record = self.state_of(task_id)
        told = len(self.told)
        epoch = (record.epoch if record is not None else 8) - late
        ended = self.book.note_status(robot, TaskStatus(id=task_id, epoch=epoch, state=state, why="so it is"))
        counts = record is not None and record.robot == robot and late == 0 and state.ended
        assert (ended == record) if counts else (ended is None)
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
    def epochs_only_grow(self):
        offers = [event.epoch for event in self.told if event.state is TaskState.OFFERED]
        assert offers == sorted(set(offers))

    @invariant()
    def done_is_counted(self):
        assert self.book.done_count == sum(event.state is TaskState.DONE for event in self.told)


TestBookMachine = BookMachine.TestCase
TestBookMachine.settings = settings(max_examples=40, stateful_step_count=30, deadline=None)


def test_each_change_is_told_with_robot_epoch_and_why():
    one, told = book()
    running(one)
    one.move("t1", TaskState.FAILED, "the way is blocked")
    assert [(event.state, event.robot, event.epoch, event.why) for event in told] == [
        (TaskState.QUEUED, "", 0, ""),
        (TaskState.OFFERED, "r1", 101, ""),
        (TaskState.RUNNING, "r1", 101, ""),
        (TaskState.FAILED, "r1", 101, "the way is blocked"),
    ]
    assert one.open == []


def test_a_robots_word_ends_its_own_task():
    one, told = book()
    record = running(one)
    ended = one.note_status("r1", TaskStatus(id="t1", epoch=record.epoch, state=TaskState.DONE, why="seen"))
    assert ended.task.id == "t1"
    assert (told[-1].state, told[-1].why) == (TaskState.DONE, "seen")
    assert (one.open, one.done_count) == ([], 1)


@pytest.mark.parametrize(
    ("robot", "late", "task_id"), [("r2", 0, "t1"), ("r1", 1, "t1"), ("r1", -1, "t1"), ("r1", 0, "t9")]
)
def test_another_robots_word_a_stale_epoch_and_an_unknown_task_count_for_nothing(robot, late, task_id):
    one, told = book()
    record = running(one)
    before = len(told)
    status = TaskStatus(id=task_id, epoch=record.epoch - late, state=TaskState.DONE)
    assert one.note_status(robot, status) is None
    assert len(told) == before
    assert one.open[0].state is TaskState.RUNNING


@pytest.mark.parametrize("said", [state for state in TaskState if not state.ended])
def test_a_robot_cannot_bring_its_task_into_any_other_state_than_an_end(said):
    one, told = book()
    record = running(one)
    one.move("t1", TaskState.LOST_CONTACT, "silent")
    before = len(told)
    assert one.note_status("r1", TaskStatus(id="t1", epoch=record.epoch, state=said)) is None
    assert (len(told), one.open[0].state) == (before, TaskState.LOST_CONTACT)


def test_the_same_end_told_again_is_not_told_on():
    one, told = book()
    record = running(one)
    status = TaskStatus(id="t1", epoch=record.epoch, state=TaskState.DONE)
    one.note_status("r1", status)
    before = len(told)
    assert one.note_status("r1", status) is None
    assert (len(told), one.done_count) == (before, 1)


def test_the_task_of_a_robot_is_found():
    one, _ = book()
    running(one, "t1", "r1")
    running(one, "t2", "r2")
    assert one.of_robot("r2").task.id == "t2"
    assert one.of_robot("r3") is None


def test_ended_tasks_are_forgotten_in_the_end():
    one, _ = book()
    for number in range(KEPT_ENDED + 10):
        one.add(Explore(id=f"t{number}", goal=GOAL))
        one.move(f"t{number}", TaskState.CANCELLED)
    assert len(one._ended) == KEPT_ENDED
