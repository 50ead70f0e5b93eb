import math

import msgspec
import pytest

from robrain.agent.robot_tasks import RobotTasks
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


def test_an_offer_with_an_invalid_lease_changes_nothing(desk, explorer):
    desk.offer(offer("t0", epoch=1), 0)
    before = desk.facts
    forged = msgspec.structs.replace(offer("t1", epoch=9), lease_s=math.inf)
    with pytest.raises(OverflowError):
        desk.offer(forged, 0)
    assert desk.facts == before
    assert explorer.started == ["t0"]
    assert desk.offer(offer("t2", epoch=2), 0).accepted


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


def test_a_withdrawn_task_is_let_go_with_the_reason(desk, explorer):
    desk.offer(offer(), 0)
    assert desk.withdraw(TaskWithdrawal(id="t1", epoch=1, why="r2 is nearer")).accepted
    assert explorer.let_go_of == ["r2 is nearer"]
    assert (desk.status.state, desk.status.why) == (TaskState.CANCELLED, "r2 is nearer")


@pytest.mark.parametrize("ended", [True, False])
def test_withdrawing_what_does_not_run_is_no_trouble(desk, explorer, ended):
    desk.offer(offer(), 0)
    if ended:
        desk.end("t1", TaskState.DONE)
    answer = desk.withdraw(TaskWithdrawal(id="t1" if ended else "t0", epoch=1))
    assert answer == TaskAnswer(accepted=True, why="not running here")
    assert explorer.let_go_of == []


def test_a_task_whose_behavior_goes_has_failed(desk, explorer):
    desk.offer(offer(), 0)
    desk.unregister("explore")
    assert (desk.status.state, desk.status.why) == (TaskState.FAILED, "the behavior that did it has gone")
    assert not desk.offer(offer("t2", epoch=2), 0).accepted
    desk.unregister("explore")


# -- one drives at a time -----------------------------------------------------------------------------------------


def visit(task_id="v1", epoch=2):
    return TaskOffer(task=Task(id=task_id, kind="visit", place=GOAL), epoch=epoch, lease_s=5.0)


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


@pytest.mark.parametrize("result", [{"image": b"x" * 2000}, {"list": list(range(600))}, {"what": object()}])
def test_a_result_that_is_no_small_json_is_refused_where_it_is_told(desk, explorer, result):
    desk.offer(offer(), 0)
    with pytest.raises(ValueError, match="expected a result of t1"):
        desk.end("t1", TaskState.DONE, "", result)
    assert desk.status.state is TaskState.RUNNING
