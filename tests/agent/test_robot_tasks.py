import math

import msgspec
import pytest

from robrain.agent.robot_tasks import RESULT_BYTES_MAX, RobotTasks
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskCost, TaskOffer, TaskWithdrawal
from robrain.protocol.messages.team.team_messages import RobotSummary, TeamState
from robrain.protocol.model.energy_model import Work
from robrain.protocol.model.ranges import REASON_TEXT_MAX
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import DoneJustNow, NeedsEnergy, NoState, Occupied
from tests.agent.explorer import GOAL, NO, YES, Explorer, offer
from tests.plain_reason import Plain


@pytest.fixture
def desk():
    return RobotTasks()


@pytest.fixture
def explorer(desk):
    return Explorer(desk)


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
    assert len(desk.status.why) == REASON_TEXT_MAX


def test_a_behavior_that_raises_over_an_offer_has_not_taken_it(desk, explorer):
    explorer.answer = RuntimeError("lost the map")
    with pytest.raises(RuntimeError):
        desk.offer(offer(), 0)
    assert desk.status is None
    explorer.answer = YES
    assert desk.offer(offer(), 0).accepted
    assert explorer.started == ["t1", "t1"]


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


def test_result_is_json_of_at_most_a_kilobyte(desk, explorer):
    desk.offer(offer(), 0)
    for result in ({"x": "y" * (RESULT_BYTES_MAX - 7)}, {"what": object()}):  # 8 bytes more as JSON
        with pytest.raises(ValueError, match="result of t1: expected"):
            desk.end("t1", TaskState.DONE, "", result)
    assert desk.status.state is TaskState.RUNNING
    result = {"x": "y" * (RESULT_BYTES_MAX - 8)}
    desk.end("t1", TaskState.DONE, "", result)
    assert desk.status.result == result


# -- the lease, to the nanosecond -----------------------------------------------------------------------------------

SILENT = "the coordinator is silent, the lease ran out"


def held(task_id="t2", epoch=2, after="t1", lease_s=5.0):
    return TaskOffer(task=offer(task_id).task, epoch=epoch, lease_s=lease_s, after=after)


@pytest.mark.parametrize(("first_s", "second_s"), [(1.0, 9.0), (9.0, 1.0)])
def test_newer_offer_brings_its_own_lease(desk, explorer, first_s, second_s):
    desk.offer(offer(lease_s=first_s), 0)
    desk.offer(offer("t2", epoch=2, lease_s=second_s), 0)
    desk.check_lease(to_ns(second_s))
    assert desk.status.state is TaskState.RUNNING
    desk.check_lease(to_ns(second_s) + 1)
    assert (desk.status.id, desk.status.state, desk.status.why) == ("t2", TaskState.CANCELLED, SILENT)


@pytest.mark.parametrize("refusal", ["refused", "old", "repeated"])
def test_offer_that_begins_nothing_leaves_the_lease_as_it_was(desk, explorer, refusal):
    desk.offer(offer(epoch=5, lease_s=5.0), 0)
    if refusal == "refused":
        explorer.answer = NO
        assert not desk.offer(offer("t2", epoch=6, lease_s=50.0), to_ns(4)).accepted
    elif refusal == "old":
        assert not desk.offer(offer("t2", epoch=4, lease_s=50.0), to_ns(4)).accepted
    else:
        assert desk.offer(offer(epoch=5, lease_s=50.0), to_ns(4)).accepted
    desk.check_lease(to_ns(5) + 1)
    assert desk.status.why == SILENT


def test_held_task_that_begins_brings_its_own_lease(desk, explorer):
    desk.offer(offer(lease_s=2.0), 0)
    desk.offer(held(lease_s=7.0), to_ns(1))
    desk.end("t1", TaskState.DONE)
    assert desk.go_on(to_ns(2))
    desk.check_lease(to_ns(8))
    assert desk.status.state is TaskState.RUNNING
    desk.check_lease(to_ns(8) + 1)
    assert (desk.status.id, desk.status.state) == ("t2", TaskState.CANCELLED)


def test_offer_that_cannot_be_held_is_refused(desk, explorer):
    desk.offer(offer(lease_s=5.0), 0)
    assert not desk.offer(
        TaskOffer(task=Task(id="c1", kind="recharge", place=GOAL), epoch=2, lease_s=5.0, after="t1"), to_ns(4)
    ).accepted  # no behavior charges
    assert desk.facts.next_task is None
    desk.check_lease(to_ns(5) + 1)
    assert desk.status.state is TaskState.CANCELLED


def test_held_task_lives_as_long_as_its_own_lease(desk, explorer):
    desk.offer(offer(lease_s=60.0), 0)
    desk.offer(held(lease_s=5.0), 0)
    for second in range(6):
        desk.check_lease(to_ns(second))
    assert desk.facts.next_task is not None
    desk.check_lease(to_ns(5) + 1)
    assert desk.facts.next_task is None
    assert desk.status.state is TaskState.RUNNING


def test_held_task_stays_while_its_coordinator_is_received(desk, explorer):
    desk.offer(offer(lease_s=60.0), 0)
    desk.offer(held(lease_s=5.0), 0)
    for second in range(1, 20):
        desk.coordinator_seen_ns = to_ns(second)
        desk.check_lease(to_ns(second))
    assert desk.facts.next_task is not None


def test_robot_that_stood_still_for_just_the_lease_keeps_what_it_holds_and_for_longer_forgets_it(desk, explorer):
    desk.offer(offer(lease_s=60.0), 0)
    desk.offer(held(lease_s=5.0), 0)
    for late_ns, is_kept in ((0, True), (1, False)):
        desk.check_lease(to_ns(10))
        desk.coordinator_seen_ns = to_ns(10)
        desk.offer(held("t3", epoch=3 + late_ns), to_ns(10))
        desk.coordinator_seen_ns = to_ns(15)
        desk.check_lease(to_ns(15) + late_ns)
        assert (desk.facts.next_task is not None) == is_kept
        desk._checked_ns = None


def test_task_that_is_recalled_is_returned_once_and_what_is_held_goes_with_it(desk, explorer):
    desk.offer(offer(), 0)
    desk.offer(held(), 0)
    reason = NeedsEnergy(80.0, 60.0)
    desk.recall(reason)
    desk.check_lease(1)
    assert (desk.status.state, desk.status.reason) == (TaskState.CANCELLED, reason)
    assert desk.status.why == str(reason)
    assert desk.facts.next_task is None
    assert explorer.let_go_of == [str(reason)]
    desk.offer(offer("t3", epoch=3), 2)
    desk.check_lease(3)
    assert desk.status.state is TaskState.RUNNING


def test_epoch_of_what_is_held_fences_offers_but_not_the_withdrawal_of_what_runs(desk, explorer):
    desk.offer(offer(epoch=3), 0)
    desk.offer(held(epoch=7), 0)
    answer = desk.offer(offer("t3", epoch=6), 0)
    assert (answer.reason, answer.epoch) == (Plain("epoch_old", epoch=6, newest=7), 7)
    assert not desk.withdraw(TaskWithdrawal(id="t2", epoch=6)).accepted
    assert desk.withdraw(TaskWithdrawal(id="t1", epoch=3)).accepted
    assert desk.withdraw(TaskWithdrawal(id="t2", epoch=7)) == YES
    assert desk.facts.next_task is None


def test_halted_robot_forgets_its_task_its_held_task_and_its_own_activity(desk, explorer):
    desk.offer(offer(), 0)
    desk.offer(held(), 0)
    desk.halted()
    assert (desk.status.state, desk.status.why) == (TaskState.CANCELLED, "the robot is halted")
    assert desk.facts.next_task is None
    assert explorer.let_go_of == []  # the behavior was halted itself
    assert desk.occupy("wander")
    desk.halted()
    assert not desk.occupies("wander")


def test_task_that_takes_another_behaviors_place_has_that_one_let_go(desk, explorer):
    let_go = []
    desk.register("recharge", lambda _task: YES, let_go.append)
    desk.offer(offer(), 0)
    desk.offer(TaskOffer(task=Task(id="c1", kind="recharge", place=GOAL), epoch=2, lease_s=5.0), 0)
    assert (explorer.let_go_of, let_go) == (["c1 has taken its place"], [])
    assert desk.may_begin("c1")
    assert not desk.may_begin("t1")
    desk.offer(offer("t2", epoch=3), 0)
    assert let_go == ["t2 has taken its place"]
    desk.offer(offer("t3", epoch=4), 0)  # the same behavior, which needs no notice
    assert explorer.let_go_of == ["c1 has taken its place"]


def test_task_may_begin_only_after_the_one_before_was_let_go(desk, explorer):
    seen = []
    desk.register("recharge", lambda _task: YES, lambda _why: seen.append(desk.may_begin("t1")))
    desk.offer(TaskOffer(task=Task(id="c1", kind="recharge", place=GOAL), epoch=1, lease_s=5.0), 0)
    desk.offer(offer(epoch=2), 0)
    assert seen == [False]
    assert desk.may_begin("t1")
    desk.end("t1", TaskState.DONE)
    assert desk.status.state is TaskState.DONE
    assert not desk.may_begin("t1")


def test_behavior_that_is_firm_keeps_others_and_tasks_out_but_for_charging(desk, explorer):
    desk.register("recharge", lambda _task: YES, lambda _why: None)
    assert desk.occupy("idle")
    assert desk.occupy("recharge", firm="is on its way to charge")
    assert not desk.occupies("idle")
    assert not desk.occupy("idle")
    assert desk.occupy("recharge", firm="is on its way to charge")
    assert desk.offer(offer(), 0) == TaskAnswer.refused(Occupied("recharge", "is on its way to charge"))
    desk.vacate("idle")
    assert desk.occupies("recharge")
    assert desk.offer(TaskOffer(task=Task(id="c1", kind="recharge", place=GOAL), epoch=1, lease_s=5.0), 0).accepted
    assert not desk.occupies("recharge")
    assert not desk.occupy("idle")
    desk.end("c1", TaskState.DONE)
    assert desk.status.state is TaskState.DONE
    assert not desk.occupies("recharge")
    assert desk.occupy("idle")
    desk.vacate("idle")
    assert not desk.occupies("idle")


def test_remaining_time_is_reported_while_the_task_runs_and_is_never_negative(desk, explorer):
    desk.offer(offer(), 0)
    desk.foresee("t0", to_ns(8))
    assert desk.situation(0).task.remaining_s is None
    desk.foresee("t1", to_ns(8))
    assert desk.situation(to_ns(5.5)).task.remaining_s == 2.5
    assert desk.situation(to_ns(5.504)).task.remaining_s == 2.5  # to a hundredth
    assert desk.situation(to_ns(9)).task.remaining_s == 0.0
    desk.foresee("t1", None)
    assert desk.situation(0).task.remaining_s is None
    desk.foresee("t1", to_ns(8))
    desk.end("t1", TaskState.DONE)
    assert desk.situation(0).task.remaining_s is None
    desk.offer(offer("t1", epoch=2), 0)  # the same task again: the old estimate does not apply
    assert desk.situation(0).task.remaining_s is None


def summary(*robots: RobotSummary) -> TeamState:
    return TeamState(robots=list(robots))


@pytest.mark.parametrize(("is_heard", "until_s"), [(True, 33), (False, 5)])
def test_lease_counts_from_the_state_that_the_coordinator_received_last(desk, explorer, is_heard, until_s):
    desk.offer(offer(lease_s=5.0), 0)
    for second in range(1, 30 if is_heard else 6):
        heard = RobotSummary(name="r1", up=is_heard, age_s=1.0 if is_heard else float(second))
        desk.renew_lease(summary(heard), "r1", to_ns(second))
        desk.check_lease(to_ns(second + 4 * is_heard))
    assert (desk.status.state, explorer.let_go_of) == (TaskState.RUNNING, [])
    desk.check_lease(to_ns(until_s) + 1)
    assert desk.status.state is TaskState.CANCELLED


@pytest.mark.parametrize(
    "robots",
    [
        [],
        [RobotSummary(name="r2", up=True, age_s=0.1)],
        [RobotSummary(name="r1", up=False, age_s=1e6, out=NoState())],  # its token came before its state
    ],
)
def test_coordinator_that_has_just_begun_to_listen_renews_the_lease(desk, explorer, robots):
    desk.offer(offer(lease_s=5.0), 0)
    desk.renew_lease(summary(*robots), "r1", to_ns(4))
    desk.check_lease(to_ns(9))
    assert desk.status.state is TaskState.RUNNING


def test_coordinator_that_has_not_received_a_robot_after_its_first_summaries_renews_no_lease_of_it(desk, explorer):
    desk.offer(offer(lease_s=5.0), 0)
    robot = RobotSummary(name="r1", up=False, age_s=1e6, out=NoState())
    desk.renew_lease(TeamState(robots=[robot], seq=2), "r1", to_ns(4))
    desk.check_lease(to_ns(5) + 1)
    assert desk.status.state is TaskState.CANCELLED


def test_task_goes_on_while_robots_in_the_coordinators_place_vouch_for_it(desk, explorer):
    desk.offer(offer(lease_s=5.0), to_ns(1))
    desk.trusted_ns = to_ns(4)
    desk.check_lease(to_ns(9))
    assert desk.status.state is TaskState.RUNNING


# -- costs ----------------------------------------------------------------------------------------------------------


def test_the_desk_tells_what_tasks_would_take_and_why_it_cannot():
    desk = RobotTasks()

    def work(task: Task) -> Work:
        if task.service_s > 100:
            raise RuntimeError("too long for me")
        return Work(path_m=2.0, turn_rad=1.0, wait_s=task.service_s, radio_packets=3)

    desk.register("sweep", lambda _task: YES, lambda _why: None, work)
    sweep = Task(id="t1", kind="sweep", place=GOAL, service_s=4.0)
    assert desk.cost(sweep) == TaskCost(id="t1", path_m=2.0, turn_rad=1.0, wait_s=4.0, radio_packets=3)
    failed = desk.cost(msgspec.structs.replace(sweep, service_s=200.0))
    assert failed == TaskCost(id="t1", why="too long for me")
    unknown = desk.cost(msgspec.structs.replace(sweep, kind="fly"))
    assert "fly" in unknown.why
    desk.register("sweep", lambda _task: YES, lambda _why: None, lambda _task: Work(wait_s=1e12))
    assert desk.cost(sweep).why  # beyond what the wire carries
    assert desk.status is None
