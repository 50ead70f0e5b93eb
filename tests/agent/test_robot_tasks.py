import math

import msgspec
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from robrain.agent.robot_tasks import DONE_REPORTED_S, RobotTasks
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskOffer, TaskWithdrawal
from robrain.protocol.model.ranges import WHY_MAX
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import DoneJustNow
from tests.agent.desk_of_one import GOAL, NO, YES, Explorer, offer
from tests.plain_reason import Plain


@pytest.fixture
def desk():
    return RobotTasks()


@pytest.fixture
def explorer(desk):
    return Explorer(desk)


def test_an_accepted_task_is_running(desk, explorer):
    assert desk.offer(offer(epoch=3), now_ns=0) == YES
    assert explorer.started == ["t1"]
    assert (desk.status.id, desk.status.epoch, desk.status.state) == ("t1", 3, TaskState.RUNNING)


def test_the_same_offer_twice_is_accepted_twice_and_started_once(desk, explorer):
    assert desk.offer(offer(), 0).accepted
    assert desk.offer(offer(), 1).accepted
    assert explorer.started == ["t1"]


def test_an_offer_of_an_older_epoch_is_refused_in_words(desk, explorer):
    desk.offer(offer(epoch=5), 0)
    answer = desk.offer(offer("t2", epoch=4), 0)
    assert (answer.reason, answer.epoch) == (Plain("epoch_old", epoch=4, newest=5), 5)
    assert explorer.started == ["t1"]
    assert desk.status.id == "t1"


DAY_MS = 24 * 3600 * 1000


@pytest.mark.parametrize("epoch", [2 * DAY_MS, 2**53 - 1])
def test_an_epoch_that_no_coordinator_gives_is_refused_and_locks_nobody_out(desk, explorer, epoch):
    answer = desk.offer(offer("forged", epoch=epoch), to_ns(5.0))
    assert not answer.accepted
    assert answer.reason.code == "epoch_ahead"
    assert desk.offer(offer("t1", epoch=1), to_ns(5.0)).accepted
    assert explorer.started == ["t1"]


@pytest.mark.parametrize("ahead_s", [20 * 86_400.0, -20 * 86_400.0])
def test_an_offer_of_a_coordinator_whose_clock_differs_counts_by_the_clock_of_the_robot(desk, explorer, ahead_s):
    now_s = 1.8e9
    desk.coordinator_ahead_ns = to_ns(ahead_s)
    asked = offer(epoch=round((now_s + ahead_s) * 1000))
    task = msgspec.structs.replace(
        asked.task, earliest_ns=to_ns(now_s + ahead_s), deadline_ns=to_ns(now_s + ahead_s + 60)
    )
    desk.register("explore", lambda task: started.append(task) or YES, lambda _: None)
    started = []
    assert desk.offer(msgspec.structs.replace(asked, task=task), to_ns(now_s)).accepted
    assert (started[0].earliest_ns, started[0].deadline_ns) == (to_ns(now_s), to_ns(now_s + 60))


def test_a_task_that_the_robot_has_just_done_is_not_begun_again_while_its_report_is_under_way(desk, explorer):
    desk.offer(offer("t1", epoch=1), 0)
    desk.check_lease(to_ns(1.0))
    desk.end("t1", TaskState.DONE)
    for held in ("", "t1"):
        assert desk.offer(offer("t1", epoch=2, after=held), to_ns(1.1)) == TaskAnswer.refused(DoneJustNow())
    assert desk.offer(offer("t2", epoch=3), to_ns(1.2)).accepted
    assert desk.offer(offer("t1", epoch=4), to_ns(1.3)) == TaskAnswer.refused(DoneJustNow())
    assert explorer.started == ["t1", "t2"]


@pytest.mark.parametrize(("ended", "again_s"), [(TaskState.DONE, 6.1), (TaskState.FAILED, 1.1)])
def test_a_task_is_done_again_where_a_coordinator_asks_for_that(desk, explorer, ended, again_s):
    desk.offer(offer("t1", epoch=1), 0)
    desk.check_lease(to_ns(1.0))
    desk.end("t1", ended)
    assert desk.offer(offer("t1", epoch=2), to_ns(again_s)).accepted


def test_a_plausible_forged_epoch_is_reported_to_the_next_coordinator(desk, explorer):
    assert desk.offer(offer("forged", epoch=DAY_MS), to_ns(5.0)).accepted
    answer = desk.offer(offer("t1", epoch=7), to_ns(6.0))
    assert (answer.accepted, answer.epoch) == (False, DAY_MS)
    assert desk.offer(offer("t1", epoch=DAY_MS + 1), to_ns(6.0)).accepted


def test_an_offer_with_an_invalid_lease_changes_nothing(desk, explorer):
    desk.offer(offer("t0", epoch=1), 0)
    before = desk.facts
    forged = msgspec.structs.replace(offer("t1", epoch=9), lease_s=math.inf)
    with pytest.raises(OverflowError):
        desk.offer(forged, 0)
    assert desk.facts == before
    assert explorer.started == ["t0"]
    assert desk.offer(offer("t2", epoch=2), 0).accepted


@pytest.mark.parametrize("lease_s", [1e300, -1.0, 1e9])
def test_an_offer_with_an_absurd_lease_does_not_decode(lease_s):
    said = msgspec.json.encode(msgspec.structs.replace(offer(), lease_s=lease_s))
    with pytest.raises(msgspec.ValidationError, match="lease_s"):
        msgspec.json.decode(said, type=TaskOffer)


def test_an_overlong_reason_is_truncated_so_that_the_robots_state_is_accepted(desk, explorer):
    desk.offer(offer(), 0)
    desk.end("t1", TaskState.FAILED, "x" * 1_000_000)
    assert len(desk.status.why) == WHY_MAX


def test_a_refused_offer_leaves_everything_as_it_was(desk, explorer):
    desk.offer(offer(epoch=1), 0)
    before = desk.status
    explorer.answer = NO
    assert desk.offer(offer("t2", epoch=9), 0) == NO
    assert desk.status == before
    explorer.answer = YES
    assert desk.offer(offer("t3", epoch=2), 0).accepted  # a refused epoch is none that was accepted


def test_a_behavior_that_raises_over_an_offer_has_not_taken_it(desk, explorer):
    explorer.answer = RuntimeError("lost the map")
    with pytest.raises(RuntimeError):
        desk.offer(offer(), 0)
    assert desk.status is None
    explorer.answer = YES
    assert desk.offer(offer(), 0).accepted
    assert explorer.started == ["t1", "t1"]


def test_a_task_that_no_behavior_does_is_refused_in_words(desk):
    assert desk.offer(offer(), 0).reason == Plain("no_behavior", kind="explore")
    assert desk.status is None


def test_how_a_task_ended_is_kept_until_the_next(desk, explorer):
    desk.offer(offer(), 0)
    desk.end("t1", TaskState.FAILED, "the way is blocked")
    assert (desk.status.state, desk.status.why) == (TaskState.FAILED, "the way is blocked")
    desk.end("t1", TaskState.DONE)
    assert desk.status.state is TaskState.FAILED
    desk.offer(offer("t2", epoch=2), 0)
    assert (desk.status.id, desk.status.state) == ("t2", TaskState.RUNNING)


def test_a_task_may_be_done_before_it_is_accepted(desk):
    def done_at_once(task):
        desk.end(task.id, TaskState.DONE, "seen already")
        return YES

    let_go = []
    desk.register("explore", done_at_once, let_go.append)
    assert desk.offer(offer(), 0).accepted
    assert desk.status.state is TaskState.DONE
    desk.check_lease(to_ns(100))
    assert let_go == []


def test_the_end_of_another_task_is_none_of_this(desk, explorer):
    desk.offer(offer(), 0)
    desk.end("t0", TaskState.FAILED)
    assert desk.status.state is TaskState.RUNNING


def test_a_withdrawn_task_is_let_go_with_the_reason(desk, explorer):
    desk.offer(offer(), 0)
    assert desk.withdraw(TaskWithdrawal(id="t1", epoch=1, why="r2 is nearer")).accepted
    assert explorer.let_go_of == ["r2 is nearer"]
    assert (desk.status.state, desk.status.why) == (TaskState.CANCELLED, "r2 is nearer")


def test_a_withdrawal_of_an_older_epoch_is_refused_in_words(desk, explorer):
    desk.offer(offer(epoch=5), 0)
    answer = desk.withdraw(TaskWithdrawal(id="t1", epoch=4))
    assert (answer.reason, answer.epoch) == (Plain("epoch_old", epoch=4, newest=5), 5)
    assert desk.status.state is TaskState.RUNNING
    assert explorer.let_go_of == []


@pytest.mark.parametrize("ended", [True, False])
def test_withdrawing_what_does_not_run_is_no_trouble(desk, explorer, ended):
    desk.offer(offer(), 0)
    if ended:
        desk.end("t1", TaskState.DONE)
    answer = desk.withdraw(TaskWithdrawal(id="t1" if ended else "t0", epoch=1))
    assert answer == TaskAnswer(accepted=True, why="not running here")
    assert explorer.let_go_of == []


def test_a_task_is_let_go_when_the_coordinator_is_silent_for_longer_than_the_lease(desk, explorer):
    desk.offer(offer(lease_s=5.0), now_ns=to_ns(10))
    desk.check_lease(to_ns(15))
    assert explorer.let_go_of == []
    desk.check_lease(to_ns(15) + 1)
    assert explorer.let_go_of == ["the coordinator is silent, the lease ran out"]
    assert desk.status.state is TaskState.CANCELLED


def test_every_word_of_the_coordinator_renews_the_lease(desk, explorer):
    desk.offer(offer(lease_s=5.0), now_ns=0)
    for second in range(1, 30):
        desk.coordinator_seen_ns = to_ns(second)
        desk.check_lease(to_ns(second + 4))
    assert explorer.let_go_of == []


def test_without_a_task_no_lease_runs_out(desk, explorer):
    desk.coordinator_seen_ns = 0
    desk.check_lease(to_ns(1000))
    assert desk.status is None
    assert explorer.let_go_of == []


def test_a_task_whose_behavior_goes_has_failed(desk, explorer):
    desk.offer(offer(), 0)
    desk.unregister("explore")
    assert (desk.status.state, desk.status.why) == (TaskState.FAILED, "the behavior that did it has gone")
    assert not desk.offer(offer("t2", epoch=2), 0).accepted
    desk.unregister("explore")


IDS, EPOCHS = st.sampled_from(["t1", "t2", "t3"]), st.integers(0, 6)
STATES = st.sampled_from([TaskState.DONE, TaskState.FAILED])


class Desk(RuleBasedStateMachine):
    """Offers, withdrawals, silence and ends in any order: one task at a time, and no epoch goes back."""

    def __init__(self):
        super().__init__()
        self.desk = RobotTasks()
        self.now_ns = 0
        self.heard_ns = None
        self.lease_ns = 0
        self.answer = YES
        self.running = None
        self.highest_epoch = 0
        self.let_go_count = 0
        self.expected_let_go_count = 0
        self.checked_ns = 0
        self.done_ns = {}
        self.desk.register("explore", lambda _: self.answer, self.let_go)

    def let_go(self, why):
        assert why
        self.let_go_count += 1

    @rule(task_id=IDS, epoch=EPOCHS, lease_s=st.floats(0.1, 5.0), answer=st.sampled_from([YES, NO]))
    def offer(self, task_id, epoch, lease_s, answer):
        self.answer = answer
        repeated = self.desk.status is not None and (self.desk.status.id, self.desk.status.epoch) == (task_id, epoch)
        answered = self.desk.offer(offer(task_id, epoch, lease_s=lease_s), self.now_ns)
        if epoch < self.highest_epoch:
            assert not answered.accepted
            assert answered.reason.code == "epoch_old"
        elif repeated:
            assert answered.accepted
        elif self.now_ns - self.done_ns.get(task_id, -math.inf) <= to_ns(DONE_REPORTED_S):
            assert answered == TaskAnswer.refused(DoneJustNow())
        else:
            assert answered == answer
            if answer.accepted:
                self.running, self.highest_epoch = (task_id, epoch), epoch
                self.lease_ns, self.heard_ns = to_ns(lease_s), self.now_ns

    @rule(task_id=IDS, epoch=EPOCHS)
    def withdraw(self, task_id, epoch):
        answered = self.desk.withdraw(TaskWithdrawal(id=task_id, epoch=epoch))
        assert answered.accepted == (epoch >= self.highest_epoch)
        if answered.accepted and self.running is not None and self.running[0] == task_id:
            self.running = None
            self.expected_let_go_count += 1

    @rule(task_id=IDS, state=STATES)
    def end(self, task_id, state):
        self.desk.end(task_id, state, "said so")
        if self.running is not None and self.running[0] == task_id:
            self.running = None
            if state is TaskState.DONE:
                self.done_ns[task_id] = self.checked_ns

    @rule(seconds=st.floats(0.0, 4.0))
    def wait(self, seconds):
        self.now_ns += to_ns(seconds)
        self.desk.check_lease(self.now_ns)
        self.checked_ns = self.now_ns
        if self.running is not None and self.now_ns - self.heard_ns > self.lease_ns:
            self.running = None
            self.expected_let_go_count += 1

    @precondition(lambda self: self.heard_ns is not None)
    @rule()
    def hear_the_coordinator(self):
        self.heard_ns = self.desk.coordinator_seen_ns = self.now_ns

    @invariant()
    def the_desk_runs_what_was_accepted_and_nothing_else(self):
        status = self.desk.status
        runs = status is not None and status.state is TaskState.RUNNING
        assert runs == (self.running is not None)
        if runs:
            assert (status.id, status.epoch) == self.running

    @invariant()
    def whoever_was_at_it_is_told_once(self):
        assert self.let_go_count == self.expected_let_go_count


Desk.TestCase.settings = settings(max_examples=60, stateful_step_count=25, deadline=None)
TestDesk = pytest.mark.slow(Desk.TestCase)


# -- one drives at a time -----------------------------------------------------------------------------------------


def visit(task_id="v1", epoch=2):
    return TaskOffer(task=Task(id=task_id, kind="visit", place=GOAL), epoch=epoch, lease_s=5.0)


def test_before_the_first_task_no_behavior_may_begin_one(desk, explorer):
    assert not desk.may_begin("t1")


def test_a_task_that_is_refused_leaves_the_one_that_runs_in_its_place(desk, explorer):
    desk.register("visit", lambda task: NO, lambda why: None)
    desk.offer(offer("t1"), 0)
    assert desk.offer(visit(), 0) == NO
    assert explorer.let_go_of == []
    assert desk.may_begin("t1")


def test_what_a_behavior_does_of_its_own_accord_gives_way_to_a_task(desk, explorer):
    assert desk.occupy("wander")
    assert desk.occupies("wander")
    desk.offer(offer(), 0)
    assert not desk.occupies("wander")
    assert not desk.occupy("wander")
    desk.end("t1", TaskState.DONE)
    assert desk.status.state is TaskState.DONE
    assert not desk.occupies("wander")  # it does not begin again by itself
    assert desk.occupy("wander")


def test_who_vacates_what_another_does_changes_nothing(desk):
    desk.occupy("wander")
    desk.vacate("idle")
    assert desk.occupies("wander")
    desk.vacate("wander")
    assert not desk.occupies("wander")


def test_what_came_of_a_task_is_told_with_its_end(desk, explorer):
    desk.offer(offer(), 0)
    desk.end("t1", TaskState.DONE, "", {"readings": 3, "energy_j": 12.5})
    assert desk.status.result == {"readings": 3, "energy_j": 12.5}


@pytest.mark.parametrize("result", [{"image": b"x" * 2000}, {"list": list(range(600))}, {"what": object()}])
def test_a_result_that_is_no_small_json_is_refused_where_it_is_told(desk, explorer, result):
    desk.offer(offer(), 0)
    with pytest.raises(ValueError, match="expected a result of t1"):
        desk.end("t1", TaskState.DONE, "", result)
    assert desk.status.state is TaskState.RUNNING
