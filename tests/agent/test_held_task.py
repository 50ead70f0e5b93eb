"""The task that a robot holds: begun in the step in which the one before has ended, and forgotten when it must be."""

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from robrain.agent.robot_tasks import DONE_REPORTED_S, RobotTasks
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TaskWithdrawal
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.reasons import DoneJustNow, NeedsEnergy, PlainReason
from tests.agent.explorer import NO, YES, Explorer, offer
from tests.plain_reason import Plain


@pytest.fixture
def desk():
    return RobotTasks()


@pytest.fixture
def explorer(desk):
    one = Explorer(desk)
    desk.offer(offer("t1", 1), 0)
    return one


def hold(desk, task_id="t2", epoch=2, after="t1", now_ns=0):
    return desk.offer(offer(task_id, epoch, after), now_ns)


@pytest.mark.parametrize("how", [TaskState.DONE, TaskState.FAILED])
def test_it_is_begun_when_the_one_before_has_ended_by_itself_and_both_are_told(desk, explorer, how):
    hold(desk)
    desk.end("t1", how, "so it went", {"energy_j": 3.0})
    assert desk.go_on(0)
    assert explorer.started == ["t1", "t2"]
    task, held, before = desk.facts
    assert (task.id, task.epoch, task.state) == ("t2", 2, TaskState.RUNNING)
    assert held is None
    assert before == TaskStatus(id="t1", epoch=1, state=how, why="so it went", result={"energy_j": 3.0})
    assert desk.may_begin("t2")
    assert not desk.go_on(0)


@pytest.mark.parametrize("answer", [NO, RuntimeError("no way there")])
def test_a_held_task_that_is_refused_when_its_turn_comes_is_cancelled_with_why(desk, explorer, answer):
    hold(desk)
    desk.end("t1", TaskState.DONE)
    explorer.answer = answer
    assert not desk.go_on(0)
    task, held, before = desk.facts
    assert task == TaskStatus(
        id="t2", epoch=2, state=TaskState.CANCELLED, why="no way there", reason=PlainReason("no way there")
    )
    assert (held, before.id, before.state) == (None, "t1", TaskState.DONE)
    explorer.answer = YES
    assert desk.offer(offer("t3", 2), 0) == YES  # an epoch that was never begun is none that was accepted


IDS, EPOCHS = st.sampled_from(["t1", "t2", "t3"]), st.integers(0, 6)


class DeskWithNext(RuleBasedStateMachine):
    """Offers for now and for later, withdrawals, silence, halts and ends in any order, against a plain model."""

    def __init__(self):
        super().__init__()
        self.desk = RobotTasks()
        self.now_ns = 0
        self.heard_ns = None
        self.answer = YES
        self.task = None
        """Id, epoch, state of the last that was begun."""
        self.held = None
        self.before = None
        self.epoch = 0
        self.done_ns = {}
        """When each task was done last, by the last check of the lease."""
        self.checked_ns = 0
        self.started = []
        """Each with its epoch, as the model has it; the behavior's own list must be the same."""
        self.begun = []
        self.desk.register("explore", self.accept, lambda why: None)

    def accept(self, task):
        if self.answer.accepted:
            self.begun.append(task.id)
        return self.answer

    @property
    def runs(self):
        return self.task is not None and self.task[2] is TaskState.RUNNING

    def begins(self, task_id, epoch):
        self.before = self.task if self.task is not None and self.task[2].ended else None
        self.task, self.held, self.epoch = (task_id, epoch, TaskState.RUNNING), None, epoch
        self.started.append(task_id)

    @rule(
        task_id=IDS, epoch=EPOCHS, after=st.sampled_from(["", "", "t1", "t2", "t3"]), answer=st.sampled_from([YES, NO])
    )
    def offer(self, task_id, epoch, after, answer):
        self.answer = answer
        answered = self.desk.offer(offer(task_id, epoch, after), self.now_ns)
        known = [one[:2] for one in (self.task, self.held) if one is not None]
        if epoch < max(self.epoch, self.held[1] if self.held is not None else 0):
            assert not answered.accepted
        elif (task_id, epoch) in known:
            assert answered.accepted
        elif task_id in self.done_ns and self.now_ns - self.done_ns[task_id] <= to_ns(DONE_REPORTED_S):
            assert answered.reason == DoneJustNow()
        elif after and (self.task is None or self.task[0] != after or self.task[2] is TaskState.CANCELLED):
            assert answered.reason == Plain("not_at_task", task=after)
        elif after and self.runs:
            assert answered.accepted
            self.held, self.heard_ns = (task_id, epoch), self.now_ns
        else:
            assert answered == answer
            if answer.accepted:
                self.begins(task_id, epoch)
                self.heard_ns = self.now_ns

    @rule(task_id=IDS, epoch=EPOCHS)
    def withdraw(self, task_id, epoch):
        answered = self.desk.withdraw(TaskWithdrawal(id=task_id, epoch=epoch))
        is_held = self.held is not None and self.held[0] == task_id
        assert answered.accepted == (epoch >= (self.held[1] if is_held else self.epoch))
        if answered.accepted and is_held:
            self.held = None
        elif answered.accepted and self.runs and self.task[0] == task_id:
            self.task = (*self.task[:2], TaskState.CANCELLED)

    @rule(task_id=IDS, state=st.sampled_from([TaskState.DONE, TaskState.FAILED]))
    def end(self, task_id, state):
        self.desk.end(task_id, state, "said so")
        if self.runs and self.task[0] == task_id:
            self.task = (*self.task[:2], state)
            if state is TaskState.DONE:
                self.done_ns[task_id] = self.checked_ns

    @rule(answer=st.sampled_from([YES, NO]))
    def go_on(self, answer):
        self.answer = answer
        begun = self.desk.go_on(self.now_ns)
        assert begun == (self.held is not None and not self.runs and answer.accepted)
        if begun:
            self.begins(*self.held)
        elif self.held is not None and not self.runs:
            self.before, self.task, self.held = self.task, (*self.held, TaskState.CANCELLED), None

    @rule()
    def halt(self):
        self.desk.halted()
        self.held = None
        if self.runs:
            self.task = (*self.task[:2], TaskState.CANCELLED)

    @rule()
    def recall(self):
        self.desk.recall(NeedsEnergy(80.0, 60.0))
        self.desk.check_lease(self.now_ns)
        self.checked_ns = self.now_ns
        self.held = None
        if self.runs:
            self.task = (*self.task[:2], TaskState.CANCELLED)

    @rule(steps=st.integers(1, 8))
    def wait(self, steps):
        for _ in range(steps):
            self.now_ns += to_ns(1.0)
            self.desk.check_lease(self.now_ns)
        self.checked_ns = self.now_ns
        if self.heard_ns is not None and self.now_ns - self.heard_ns > to_ns(5.0):
            self.held = None
            if self.runs:
                self.task = (*self.task[:2], TaskState.CANCELLED)

    @precondition(lambda self: self.heard_ns is not None)
    @rule()
    def hear_the_coordinator(self):
        self.heard_ns = self.desk.coordinator_seen_ns = self.now_ns

    @invariant()
    def the_desk_says_what_the_model_says(self):
        task, held, before = self.desk.facts
        assert (None if task is None else (task.id, task.epoch, task.state)) == self.task
        assert (None if held is None else (held.id, held.epoch)) == self.held
        assert (None if before is None else (before.id, before.epoch, before.state)) == self.before

    @invariant()
    def everything_that_is_begun_is_begun_once(self):
        assert self.begun == self.started


DeskWithNext.TestCase.settings = settings(max_examples=40, stateful_step_count=30, deadline=None)
TestDeskWithNext = pytest.mark.slow(DeskWithNext.TestCase)
