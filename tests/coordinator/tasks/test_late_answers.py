"""Late answers and answers with an old epoch: only an answer to the current offer counts."""

from collections.abc import Iterator

import pytest
import zenoh

from robrain.coordinator.core.core import Parts
from robrain.coordinator.tasks.eligibility import REFUSALS_MAX
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.tasks.task_lifecycle import WITHDRAW_AGAIN_NS, Answered, TaskLifecycle
from robrain.coordinator.team.capabilities import Capabilities
from robrain.coordinator.team.roster import Roster
from robrain.coordinator.team.team_map import TeamMap
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState, TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskWithdrawal
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import (
    DoneJustNow,
    Gone,
    LeaseRanOut,
    NeedsEnergy,
    NoState,
    Occupied,
    OfferRefusal,
    PlainReason,
    PositionLost,
    Refused,
    RobotHalted,
    RobotReason,
    halted,
    lacks_plugins,
    plain,
)
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.presence import Change
from tests.plain_reason import Plain

YES, NO = TaskAnswer(accepted=True), TaskAnswer(accepted=False, why="no way there")
NOW_NS = to_ns(5.0)


class Mail:
    """Offers and withdrawals that stay pending until the test delivers the answers."""

    def __init__(self) -> None:
        self.asked: list[tuple[TaskRecord, str]] = []
        self.withdrawn: list[tuple[str, TaskWithdrawal]] = []
        self.arrived: list[Answered] = []

    @property
    def is_waiting(self) -> bool:
        return bool(self.asked or self.withdrawn or self.arrived)

    def offer(self, record: TaskRecord, after: str) -> None:
        self.asked.append((record, after))

    def withdraw(self, robot: str, withdrawal: TaskWithdrawal) -> None:
        self.withdrawn.append((robot, withdrawal))

    def answer(self, index: int, answer: TaskAnswer) -> None:
        self.arrived.append(Answered(*self.asked[index], answer))

    def answered(self) -> list[Answered]:
        arrived, self.arrived = self.arrived, []
        return arrived


class Desk:
    """A task lifecycle whose offers the test answers; robots r1 and r2 are present."""

    def __init__(self, session: zenoh.Session) -> None:
        self.clock = VirtualClock(NOW_NS)
        self.wire = Endpoint(session, "late", self.clock, Drive.LOCKSTEP)
        self.book = TaskBook(self.clock, 0, lambda _event: None)
        self.roster = Roster()
        parts = Parts()
        parts.task_refused = lambda record, robot, _why, now_ns: self.refused.append((record.task.id, robot, now_ns))
        self.tasks = TaskLifecycle(self.wire, self.book, self.roster, Capabilities(self.wire), parts, TeamMap())
        self.mail = Mail()
        self.tasks._offers = self.mail
        self.refused: list[tuple[str, str, int]] = []
        for name in ("r1", "r2"):
            self.roster.record_presence(Change({"robot": name}, True))
            self.say(name)

    def say(self, name: str, task: TaskStatus | None = None, held: TaskStatus | None = None) -> None:
        self.roster.record_state(RobotState(robot=name, task=task, next_task=held), self.clock.now_ns())

    def add(self, task_id: str = "t1", *, own: bool = False) -> None:
        task = (
            Task(id=task_id, kind="explore", place=Point2D(1.0, 1.0))
            if own
            else Task(id=task_id, kind="visit", place=Point2D(1.0, 1.0))
        )
        self.book.add(task, own=own)

    def stands(self, task_id: str = "t1") -> tuple[TaskState, str]:
        record = self.book.find(task_id)
        assert record is not None
        return record.state, record.robot


@pytest.fixture
def desk(session: zenoh.Session) -> Iterator[Desk]:
    one = Desk(session)
    yield one
    one.wire.close()


def test_answer_that_comes_later_begins_the_task_or_queues_it_again(desk: Desk) -> None:
    desk.add("t1")
    desk.add("t2")
    assert desk.tasks.offer("t1", "r1", NOW_NS) is None
    assert desk.tasks.offer("t2", "r2", NOW_NS) is None
    assert (desk.stands("t1"), desk.stands("t2")) == ((TaskState.OFFERED, "r1"), (TaskState.OFFERED, "r2"))
    assert desk.tasks.process_answers(NOW_NS) is False
    desk.mail.answer(0, YES)
    assert desk.tasks.process_answers(NOW_NS) is False
    desk.mail.answer(1, NO)
    assert desk.tasks.process_answers(NOW_NS) is True
    assert (desk.stands("t1"), desk.stands("t2")) == ((TaskState.RUNNING, "r1"), (TaskState.QUEUED, ""))
    assert desk.book.find("t2").why == "r2 refused: no way there"
    assert desk.tasks.backoff.pause_reason("t2", "r2", NOW_NS) == Refused(PlainReason("no way there"))


@pytest.mark.parametrize("answer", [YES, NO])
@pytest.mark.parametrize("robot", ["r1", "r2"])
def test_late_answer_to_an_old_offer_changes_nothing_of_the_new_one(desk: Desk, answer: TaskAnswer, robot: str) -> None:
    desk.add()
    desk.tasks.offer("t1", "r1", NOW_NS)
    desk.book.give_back("t1", plain("never_taken", "words"))
    desk.tasks.offer("t1", robot, NOW_NS)
    old, new = (record.epoch for record, _ in desk.mail.asked)
    assert old < new
    desk.mail.answer(0, answer)
    assert desk.tasks.process_answers(NOW_NS) is False
    assert desk.stands() == (TaskState.OFFERED, robot)
    assert desk.tasks.backoff.pause_reason("t1", "r1", NOW_NS) is None
    desk.mail.answer(1, YES)
    desk.tasks.process_answers(NOW_NS)
    assert desk.stands() == (TaskState.RUNNING, robot)


@pytest.mark.parametrize("answer", [YES, NO])
@pytest.mark.parametrize("state", [TaskState.QUEUED, TaskState.RUNNING, TaskState.DONE, TaskState.CANCELLED])
def test_answer_to_an_offer_that_does_not_stand_any_more_changes_nothing(
    desk: Desk, state: TaskState, answer: TaskAnswer
) -> None:
    desk.add()
    desk.tasks.offer("t1", "r1", NOW_NS)
    desk.book.move("t1", state) if state is not TaskState.QUEUED else desk.book.give_back("t1", None)
    before = desk.book.find("t1")
    desk.mail.answer(0, answer)
    assert desk.tasks.process_answers(NOW_NS) is False
    assert desk.book.find("t1") == before


def test_offer_for_later_stays_offered_when_it_is_accepted_and_is_not_shunned_when_it_is_not(desk: Desk) -> None:
    desk.add("t1")
    desk.add("t2")
    assert desk.tasks.may_be_next("r1", "t0")
    for task_id in ("t1", "t2"):
        desk.tasks.offer(task_id, "r1", NOW_NS, after="t0")
    assert not desk.tasks.may_be_next("r1", "t0")
    assert desk.tasks.may_be_next("r1", "t1")
    assert desk.tasks.may_be_next("r2", "t0")
    desk.mail.answer(0, YES)
    desk.mail.answer(1, NO)
    assert desk.tasks.process_answers(NOW_NS) is True
    assert (desk.stands("t1"), desk.stands("t2")) == ((TaskState.OFFERED, "r1"), (TaskState.QUEUED, ""))
    assert desk.tasks.backoff.pause_reason("t2", "r1", NOW_NS) is None
    assert [after for _, after in desk.mail.asked] == ["t0", "t0"]
    assert desk.book.find("t1").why == "it is next, after t0"


def offered(desk: Desk, robot: str, now_ns: int, answer: TaskAnswer) -> None:
    """A robot is offered the task, and answers at once."""
    desk.clock.advance_to(now_ns)
    desk.say("r1")
    desk.say("r2")
    desk.tasks.offer("t1", robot, now_ns)
    desk.mail.answer(-1, answer)
    desk.tasks.process_answers(now_ns)


def test_task_that_every_robot_has_refused_for_good_has_failed(desk: Desk) -> None:
    desk.add()
    for round_number in range(REFUSALS_MAX):
        assert desk.stands()[0] is TaskState.QUEUED
        for robot in ("r1", "r2"):
            offered(desk, robot, NOW_NS + to_ns(100.0 * round_number), NO)
    assert desk.stands()[0] is TaskState.FAILED
    assert desk.book.find("t1").reason == Plain("nobody_does", robots=("r1", "r2"), more=0)


@pytest.mark.parametrize(
    "passing",
    [DoneJustNow(), Occupied("recharge", "it goes home to charge"), PositionLost("r1", "no walls"), RobotHalted()],
)
def test_what_a_robot_is_at_just_now_is_not_its_last_word(desk: Desk, passing: OfferRefusal) -> None:
    desk.add()
    for round_number in range(REFUSALS_MAX + 2):
        now_ns = NOW_NS + to_ns(100.0 * round_number)
        offered(desk, "r1", now_ns, TaskAnswer.refused(passing))
        assert desk.stands()[0] is TaskState.QUEUED
    assert desk.tasks.backoff.pause_reason("t1", "r1", now_ns) == Refused(passing)


def test_an_offer_is_not_taken_back_because_the_coordinator_stood_still(desk: Desk) -> None:
    desk.add()
    desk.tasks.offer("t1", "r1", NOW_NS)
    later_ns = NOW_NS + to_ns(20.0)
    desk.roster.restart_silence(later_ns - NOW_NS)
    desk.tasks.restart_silence(later_ns)
    for waited_s, state in ((0.0, TaskState.OFFERED), (1.9, TaskState.OFFERED), (2.1, TaskState.QUEUED)):
        desk.tasks.settle(later_ns + to_ns(waited_s))
        assert desk.stands()[0] is state


ENERGY = {
    "half full, and full is enough": (0.5, 900.0, "recharge", TaskState.QUEUED),
    "half full, and full is not enough": (0.5, 1001.0, "recharge", TaskState.FAILED),
    "full": (0.95, 900.0, "recharge", TaskState.FAILED),
    "it cannot charge": (0.5, 900.0, "wander", TaskState.FAILED),
}


@pytest.mark.parametrize(("soc", "needed_j", "plugin", "state"), ENERGY.values(), ids=ENERGY)
def test_want_of_energy_is_the_last_word_of_a_robot_that_has_no_more_after_a_charge(
    desk: Desk, soc: float, needed_j: float, plugin: str, state: TaskState
) -> None:
    desk.add()
    desk.tasks.capabilities.plugins["r1"] = frozenset(("visit", plugin))
    desk.roster.record_presence(Change({"robot": "r2"}, False))
    battery = BatteryState(
        voltage_v=12.0, current_a=0.5, temperature_c=22.0, soc=soc,
        remaining_j=1000.0 * soc, remaining_low_j=1000.0 * soc, remaining_high_j=1000.0 * soc,
    )  # fmt: skip
    for round_number in range(REFUSALS_MAX):
        now_ns = NOW_NS + to_ns(100.0 * round_number)
        desk.clock.advance_to(now_ns)
        desk.roster.record_state(RobotState(robot="r1", battery=battery), now_ns)
        desk.tasks.offer("t1", "r1", now_ns)
        desk.mail.answer(-1, TaskAnswer.refused(NeedsEnergy(needed_j, 1000.0 * soc)))
        desk.tasks.process_answers(now_ns)
    assert desk.stands()[0] is state


def test_task_of_the_coordinators_own_that_is_refused_ends_and_is_told_and_anothers_is_not(desk: Desk) -> None:
    desk.add("e1", own=True)
    desk.add("t1")
    for index, task_id in enumerate(("e1", "t1")):
        desk.tasks.offer(task_id, f"r{index + 1}", NOW_NS)
        desk.mail.answer(index, NO)
    desk.tasks.process_answers(NOW_NS)
    assert desk.refused == [("e1", "r1", NOW_NS)]
    assert desk.stands("e1")[0] is TaskState.CANCELLED
    assert desk.stands("t1")[0] is TaskState.QUEUED


# -- withdrawals ------------------------------------------------------------------------------------------------


def at(task_id: str, epoch: int, state: TaskState = TaskState.RUNNING) -> TaskStatus:
    return TaskStatus(id=task_id, epoch=epoch, state=state)


def test_robot_that_is_at_a_task_with_an_old_epoch_is_told_to_stop_with_that_epoch(desk: Desk) -> None:
    desk.add()
    desk.tasks.offer("t1", "r1", NOW_NS)
    desk.book.give_back("t1", LeaseRanOut("r1"))
    desk.tasks.offer("t1", "r2", NOW_NS)
    first, second = (record.epoch for record, _ in desk.mail.asked)
    desk.say("r1", at("t1", first))
    desk.say("r2", at("t1", second))
    desk.tasks.withdraw_strays(NOW_NS)
    assert desk.mail.withdrawn == [
        ("r1", TaskWithdrawal(id="t1", epoch=first, why="it was given to others: it is offered at r2"))
    ]


def test_stray_is_told_again_twice_a_second_and_no_more_often(desk: Desk) -> None:
    told = []
    for now_ns in (0, WITHDRAW_AGAIN_NS - 1, WITHDRAW_AGAIN_NS, 2 * WITHDRAW_AGAIN_NS - 1, 2 * WITHDRAW_AGAIN_NS):
        desk.clock.advance_to(NOW_NS + now_ns)
        desk.say("r1", at("t7", 3))
        desk.tasks.withdraw_strays(NOW_NS + now_ns)
        told.append(len(desk.mail.withdrawn))
    assert told == [1, 1, 2, 2, 3]
    assert desk.mail.withdrawn[0][1].why == "the coordinator knows nothing of it"


def test_held_task_that_was_called_off_is_withdrawn_with_the_reason(desk: Desk) -> None:
    desk.add("t2")
    desk.tasks.offer("t2", "r1", NOW_NS, after="t1")
    epoch = desk.mail.asked[0][0].epoch
    desk.book.move("t2", TaskState.CANCELLED, PlainReason("ann does not want it"))
    desk.say("r1", None, at("t2", epoch, TaskState.OFFERED))
    desk.tasks.withdraw_strays(NOW_NS)
    assert desk.mail.withdrawn == [("r1", TaskWithdrawal(id="t2", epoch=epoch, why="ann does not want it"))]


# -- the book ---------------------------------------------------------------------------------------------------


def test_deadline_is_passed_only_after_it(desk: Desk) -> None:
    desk.book.add(Task(id="t1", kind="visit", place=Point2D(0.0, 0.0), deadline_ns=NOW_NS))
    desk.tasks.settle(NOW_NS)
    assert desk.stands()[0] is TaskState.QUEUED
    desk.tasks.settle(NOW_NS + 1)
    assert (desk.stands()[0], desk.book.find("t1").why) == (TaskState.FAILED, "its deadline has passed")


def test_robot_that_failed_is_not_asked_again_at_once_and_one_that_was_told_to_stop_is(desk: Desk) -> None:
    for index, (state, why) in enumerate(((TaskState.FAILED, Plain("failed")), (TaskState.CANCELLED, None))):
        task_id = f"t{index}"
        desk.add(task_id)
        desk.tasks.offer(task_id, "r1", NOW_NS)
        desk.book.move(task_id, TaskState.RUNNING)
        status = TaskStatus(id=task_id, epoch=desk.mail.asked[-1][0].epoch, state=state, why="blocked")
        assert desk.tasks.receive("r1", status, NOW_NS).task.id == task_id
        assert desk.tasks.backoff.pause_reason(task_id, "r1", NOW_NS) == why
        assert desk.stands(task_id)[0] is TaskState.QUEUED
        assert desk.tasks.receive("r1", status, NOW_NS) is None


# -- who is asked, and whose words count against it -----------------------------------------------------------------


def refusal(desk: Desk, robot: str = "r1", now_ns: int = NOW_NS) -> RobotReason | None:
    record = desk.book.find("t1")
    assert record is not None
    return desk.tasks.eligibility.refusal(record, desk.roster.robots[robot], now_ns)


def test_robot_that_is_silent_halted_gone_or_lacks_the_plugin_is_not_asked(desk: Desk) -> None:
    desk.add()
    assert refusal(desk) is None
    assert refusal(desk, now_ns=NOW_NS + to_ns(0.8)) is None
    assert refusal(desk, now_ns=NOW_NS + to_ns(1.5)) == Plain("lost_contact", silent_s=1.5)
    desk.tasks.capabilities.plugins["r1"] = frozenset({"explore"})
    assert refusal(desk) == lacks_plugins(("visit",))
    desk.tasks.capabilities.plugins["r1"] = None  # it may have any
    assert refusal(desk) is None
    desk.roster.record_state(RobotState(robot="r1", halted=True), NOW_NS)
    assert (refusal(desk), refusal(desk, "r2")) == (halted(), None)
    desk.roster.record_presence(Change({"robot": "r1"}, False))
    assert refusal(desk) == Gone()
    desk.roster.robots["r1"].received_ns = None
    assert refusal(desk) == NoState()


def test_only_a_held_task_that_is_called_off_before_its_turn_counts_as_refused(desk: Desk) -> None:
    def cancelled(task_id: str) -> RobotReason | None:
        record = desk.book.find(task_id)
        assert record is not None
        status = TaskStatus(id=task_id, epoch=record.epoch, state=TaskState.CANCELLED, why="no way")
        desk.tasks.receive("r1", status, NOW_NS)
        return desk.tasks.backoff.pause_reason(task_id, "r1", NOW_NS)

    for name in ("first", "held", "begun", "offered"):
        desk.add(name)
    desk.tasks.offer("first", "r1", NOW_NS)
    desk.tasks.offer("held", "r1", NOW_NS, after="first")
    assert cancelled("first") is None
    assert cancelled("held") == Refused(PlainReason("no way"))
    desk.tasks.offer("begun", "r1", NOW_NS, after="t0")
    desk.book.move("begun", TaskState.RUNNING)
    assert cancelled("begun") is None
    desk.book.offered("offered", "r1")  # the robot's answer is still on its way
    assert cancelled("offered") is None


def test_a_change_later_in_the_step_than_its_time_is_no_change_of_another_coordinator(desk: Desk) -> None:
    step_ns = NOW_NS + to_ns(5.0)
    desk.clock.advance_to(step_ns)
    desk.add()
    desk.say("r1")
    desk.tasks.offer("t1", "r1", step_ns)
    desk.mail.answer(0, TaskAnswer(accepted=True))
    desk.clock.advance_to(step_ns + 1_000_000)
    desk.tasks.process_answers(step_ns)
    desk.tasks.settle(step_ns)
    assert desk.stands() == (TaskState.RUNNING, "r1")
