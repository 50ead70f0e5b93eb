"""What silence, restarts and old epochs make of a task: pure, with times of our choosing."""

import pytest

from robrain.coordinator.tasks.reconcile import FORGOTTEN_S, OFFER_ARRIVES_S, StateChange, reconcile, strays
from robrain.coordinator.team.roster import Robot
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import RobotState, TaskStatus
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import FREE_AFTER_S, LEASE_S, Task, TaskState
from robrain.protocol.reasons import Gone, LeaseRanOut, TaskReason
from tests.plain_reason import Plain

TASK = Task(id="t1", kind="visit", place=Point2D(1.0, 2.0))
LONG_AGO_S = -100.0


def record(state: TaskState, changed_s: float = 0.0) -> TaskRecord:
    return TaskRecord(task=TASK, state=state, robot="r1", epoch=7, changed_ns=to_ns(changed_s))


def robot(
    heard_s: float,
    task: TaskStatus | None = None,
    held: TaskStatus | None = None,
    before: TaskStatus | None = None,
    *,
    has_token: bool = True,
) -> Robot:
    found = Robot("r1")
    found.has_token = has_token
    found.received_ns = to_ns(heard_s)
    found.state = RobotState(robot="r1", task=task, next_task=held, task_before=before)
    return found


def status(state: TaskState = TaskState.RUNNING, epoch: int = 7, task_id: str = "t1") -> TaskStatus:
    return TaskStatus(id=task_id, epoch=epoch, state=state)


def judge(one: TaskRecord, other: Robot | None, now_s: float, since_s: float = LONG_AGO_S) -> StateChange | None:
    return reconcile(one, other, to_ns(now_s), to_ns(since_s))


def test_the_lease_ends_on_the_robots_side_before_the_task_is_given_to_another() -> None:
    assert LEASE_S + 0.4 < FREE_AFTER_S <= 2.0


def test_a_task_that_its_robot_is_at_stays() -> None:
    assert judge(record(TaskState.RUNNING), robot(9.9, status()), 10.0) is None


@pytest.mark.parametrize(("state", "why"), [(TaskState.OFFERED, None), (TaskState.LOST_CONTACT, Plain("contact_back"))])
def test_a_robot_that_says_that_it_is_at_its_task_is(state: TaskState, why: TaskReason | None) -> None:
    assert judge(record(state), robot(9.9, status()), 10.0) == StateChange(TaskState.RUNNING, why)


@pytest.mark.parametrize("state", [TaskState.OFFERED, TaskState.RUNNING, TaskState.LOST_CONTACT])
def test_how_a_task_ended_is_left_to_the_robots_own_word(state: TaskState) -> None:
    assert judge(record(state), robot(9.9, status(TaskState.DONE)), 10.0) is None


def test_a_robot_is_lost_after_eight_states_of_silence_though_its_token_is_there() -> None:
    """A process that is stopped (SIGSTOP) keeps its token for many seconds."""
    assert judge(record(TaskState.RUNNING), robot(10.0, status()), 10.8) is None
    lost = judge(record(TaskState.RUNNING), robot(10.0, status()), 10.85)
    assert lost is not None
    assert lost.state is TaskState.LOST_CONTACT
    assert lost.reason.code == "lost_contact"
    assert 0.8 <= lost.reason.values["silent_s"] <= 0.9


def test_a_robot_without_its_token_is_lost_at_once_and_its_task_free_after_the_lease() -> None:
    gone = robot(10.0, status(), has_token=False)
    assert judge(record(TaskState.RUNNING), gone, 10.1) == StateChange(TaskState.LOST_CONTACT, Gone())
    assert judge(record(TaskState.LOST_CONTACT), gone, 12.0) is None
    assert judge(record(TaskState.LOST_CONTACT), gone, 12.05) == StateChange(TaskState.QUEUED, LeaseRanOut("r1"))


def test_a_robot_that_has_lost_its_task_in_a_restart_gives_it_back() -> None:
    for said in (None, status(epoch=6), status(task_id="t2"), status(TaskState.DONE, epoch=6)):
        assert judge(record(TaskState.RUNNING, 9.5), robot(9.9, said), 10.0) is None
        assert judge(record(TaskState.RUNNING, 8.5), robot(9.9, said), 10.0) == StateChange(
            TaskState.QUEUED, Plain("forgotten", robot="r1")
        )


def test_an_offer_that_was_never_confirmed_is_given_back_after_its_lease() -> None:
    offered = record(TaskState.OFFERED, 10.0)
    for told in (robot(11.9, None), robot(11.9, status(epoch=3))):
        assert judge(offered, told, 12.0) is None
        told.received_ns = to_ns(12.0)
        assert judge(offered, told, 12.1) == StateChange(TaskState.QUEUED, Plain("never_taken", robot="r1"))
    silent = robot(9.0)
    assert judge(offered, silent, 11.5) is None  # the offer may have reached it: it has a lease of its own
    assert judge(offered, silent, 12.1) == StateChange(TaskState.QUEUED, LeaseRanOut("r1"))


def test_a_coordinator_that_begins_anew_listens_before_it_misses_anybody() -> None:
    """Its journal says that r1 was at a task long ago; r1 has not spoken to this coordinator yet."""
    for unheard in (None, robot(0.0, has_token=False)):
        old = record(TaskState.RUNNING, LONG_AGO_S)
        assert judge(old, unheard, 10.7, since_s=10.0) is None
        lost = judge(old, unheard, 10.9, since_s=10.0)
        assert lost is not None
        assert lost.state is TaskState.LOST_CONTACT
        waiting = record(TaskState.LOST_CONTACT, LONG_AGO_S)
        assert judge(waiting, unheard, 11.9, since_s=10.0) is None
        freed = judge(waiting, unheard, 12.1, since_s=10.0)
        assert freed is not None
        assert freed.state is TaskState.QUEUED


def test_a_coordinator_that_begins_anew_does_not_take_a_running_task_for_forgotten_too_early() -> None:
    fresh = robot(10.2, None)
    assert judge(record(TaskState.RUNNING, LONG_AGO_S), fresh, 10.3, since_s=10.0) is None
    fresh.received_ns = to_ns(10.0 + FORGOTTEN_S)
    assert judge(record(TaskState.RUNNING, LONG_AGO_S), fresh, 10.1 + FORGOTTEN_S, since_s=10.0) is not None


def test_a_robot_is_told_to_stop_what_nobody_wants_of_it() -> None:
    assert strays(robot(0.0, None), [], 0) == []
    assert strays(robot(0.0, status(TaskState.DONE)), [], 0) == []
    old = status(epoch=3)
    assert strays(robot(0.0, old), [], 0) == [old]
    assert strays(robot(0.0, status()), [record(TaskState.RUNNING)], 0) == []
    # The book has just given it another task: that offer takes the place of what it is at, unless it is lost.
    assert strays(robot(0.0, old), [record(TaskState.OFFERED)], to_ns(OFFER_ARRIVES_S)) == []
    assert strays(robot(0.0, old), [record(TaskState.OFFERED)], to_ns(OFFER_ARRIVES_S) + 1) == [old]
    assert strays(robot(0.0, old), [record(TaskState.RUNNING)], to_ns(9.0)) == []


OTHER = status(task_id="t0", epoch=6)
HELD = status(TaskState.OFFERED)


def test_what_a_robot_holds_stays_offered_for_as_long_as_it_says_so() -> None:
    assert judge(record(TaskState.OFFERED), robot(99.9, OTHER, HELD), 100.0) is None


def test_what_a_robot_holds_no_more_is_given_back() -> None:
    back = StateChange(TaskState.QUEUED, Plain("never_taken", robot="r1"))
    assert judge(record(TaskState.OFFERED, 9.0), robot(9.9, OTHER), 10.0) is None
    assert judge(record(TaskState.OFFERED), robot(9.9, OTHER), 10.0) == back
    assert judge(record(TaskState.OFFERED), robot(9.9, OTHER, status(TaskState.OFFERED, epoch=5)), 10.0) == back


def test_what_a_silent_robot_held_is_given_back_with_the_lease() -> None:
    silent = robot(10.0, OTHER, HELD)
    assert judge(record(TaskState.OFFERED), silent, 12.0) is None
    assert judge(record(TaskState.OFFERED), silent, 12.05) == StateChange(TaskState.QUEUED, LeaseRanOut("r1"))


def test_a_task_that_ended_before_the_one_that_runs_is_left_to_the_robots_word() -> None:
    both = robot(9.9, status(task_id="t2", epoch=8), before=status(TaskState.DONE))
    assert judge(record(TaskState.RUNNING), both, 10.0) is None


def test_what_a_robot_holds_and_should_not_is_taken_back() -> None:
    assert strays(robot(0.0, status(), HELD), [], 0) == [status(), HELD]
    held = status(TaskState.OFFERED, epoch=9, task_id="t2")
    assert strays(robot(0.0, status(), held), [record(TaskState.RUNNING)], 0) == [held]
    assert strays(robot(0.0, OTHER, HELD), [record(TaskState.OFFERED)], 0) == [OTHER]  # the one it is at was called off
    after = TaskRecord(
        task=Task(id="t2", kind="visit", place=Point2D(1.0, 2.0)), state=TaskState.OFFERED, robot="r1", epoch=9
    )
    assert strays(robot(0.0, status(), held), [record(TaskState.RUNNING), after], 0) == []
    assert strays(robot(0.0, status()), [record(TaskState.RUNNING), after], 0) == []  # it is on its way


@pytest.mark.parametrize("other", [None, Robot("r1")])
def test_a_robot_that_a_new_coordinator_has_not_heard_goes_on_as_long_as_its_mates_would(other: Robot | None) -> None:
    one = record(TaskState.RUNNING)
    assert reconcile(one, other, to_ns(100.0), to_ns(0.0), 120.0) is not None  # silent, and not given to others
    assert reconcile(one, other, to_ns(100.0), to_ns(0.0), 120.0).state is TaskState.LOST_CONTACT
    assert reconcile(one, other, to_ns(121.0), to_ns(0.0), 120.0).state is TaskState.QUEUED
    assert reconcile(one, other, to_ns(3.0), to_ns(0.0)).state is TaskState.QUEUED
