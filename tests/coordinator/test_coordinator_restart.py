"""The coordinator is killed and starts again on its journal, while robots go on."""

import msgspec
import pytest

from robrain.coordinator.journal.journal import Journal
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.task_messages import TASK_CANCEL, TaskRequest
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import FREE_AFTER_S, Task, TaskState


def visit(task_id="t1", x_m=6.0, **fields):
    return Task(id=task_id, kind="visit", place=Point2D(x_m, 4.0), **fields)


@pytest.fixture
def kept(team):
    """The team's journal; it outlives its coordinators."""
    journal = Journal()
    team.begin(journal)
    yield journal
    journal.close()


@pytest.fixture
def robot(team, kept):
    return team.settle()


def wait_for(team, condition):
    """Zenoh tells of tokens that were there before on a thread of its own, a little later."""
    for _ in range(100):
        team.run(0.1)
        if condition():
            return
    raise AssertionError(team.states())


def test_a_running_task_goes_on_as_if_nothing_had_been(team, kept, robot):
    team.submit(visit())
    team.run(0.5)
    team.begin(kept)
    team.run(1.0)
    assert team.history("t1") == [TaskState.QUEUED, TaskState.OFFERED, TaskState.RUNNING]
    robot.end(TaskState.DONE)
    wait_for(team, lambda: team.states()["t1"] is TaskState.DONE)
    assert len(robot.offers) == 1
    assert robot.withdrawals == []


def test_a_task_that_the_robot_let_go_meanwhile_is_offered_again(team, kept, robot):
    team.submit(visit())
    team.run(0.5)
    robot.end(TaskState.CANCELLED, "the coordinator is silent, the lease ran out")
    before = robot.offers[-1].epoch
    team.begin(kept)
    wait_for(team, lambda: team.states()["t1"] is TaskState.RUNNING)
    assert robot.offers[-1].epoch > before
    assert team.why("t1") == ""
    assert TaskState.CANCELLED not in team.history("t1")


def test_a_task_that_its_robot_has_forgotten_is_offered_again_also_if_the_clock_was_ahead_before(team, kept, robot):
    team.submit(visit())
    team.run(0.5)
    later_ns = team.clock.now_ns() + to_ns(3600.0)
    kept.change(msgspec.structs.replace(kept.find("t1"), state=TaskState.LOST_CONTACT, changed_ns=later_ns))
    robot.task = None
    team.begin(kept)
    wait_for(team, lambda: len(robot.offers) == 2)


@pytest.mark.parametrize("took_it", [True, False])
def test_an_offer_in_the_air_is_settled_by_the_robots_own_word(team, kept, robot, took_it):
    """Killed between the offer and the robot's answer: the journal says offered, whatever the robot did."""
    team.submit(visit())
    record = team.coordinator.tasks.offered("t1", "r1")
    if took_it:
        from robrain.protocol.messages.robots.robot_messages import TaskStatus

        robot.task = TaskStatus(id="t1", epoch=record.epoch, state=TaskState.RUNNING)
    team.begin(kept)
    wait_for(team, lambda: team.states()["t1"] is TaskState.RUNNING)
    assert len(robot.offers) == (0 if took_it else 1)
    told = [event.why for event in team.heard if event.state is TaskState.QUEUED and event.why]
    assert told == ([] if took_it else ["r1 never said that it took it"])


def test_an_offer_that_nobody_answered_in_time_is_settled_the_same_way(team, kept, robot):
    robot.answers = False
    team.submit(visit())
    team.run(1.0)
    assert team.states() == {"t1": TaskState.OFFERED}
    robot.answers = True
    team.run(FREE_AFTER_S)
    assert team.states() == {"t1": TaskState.RUNNING}
    assert len(robot.offers) == 2


def test_a_cancellation_that_did_not_reach_the_robot_is_made_good(team, kept, robot):
    team.submit(visit())
    team.run(0.5)
    team.ask(TASK_CANCEL, TaskRequest(id="t1"))
    team.begin(kept)  # killed before it told the robot
    wait_for(team, lambda: robot.withdrawals)
    assert robot.task.state is TaskState.CANCELLED


def test_a_robot_that_never_comes_back_loses_its_task_to_another(team, kept, robot):
    team.submit(visit())
    team.run(0.5)
    robot.speaks = False
    robot.leave()
    team.begin(kept)
    other = team.robot("r2", 4.0)
    wait_for(team, lambda: team.states()["t1"] is TaskState.RUNNING and kept.find("t1").robot == "r2")
    assert team.history("t1")[2:] == [
        TaskState.RUNNING, TaskState.LOST_CONTACT, TaskState.QUEUED, TaskState.OFFERED, TaskState.RUNNING,
    ]  # fmt: skip
    assert other.task.state is TaskState.RUNNING
    robot.come()


def test_a_robot_that_comes_back_with_an_old_epoch_is_told_to_stop(team, kept, robot):
    other = team.robot("r2", 4.0)
    team.run(0.5)
    team.submit(visit())
    team.run(0.5)
    robot.speaks = False
    team.run(0.7)
    assert team.history("t1")[-1] is TaskState.RUNNING
    team.run(0.2)
    assert team.history("t1")[-1] is TaskState.LOST_CONTACT
    team.run(1.2)  # 2.1 s of silence in all
    assert other.task.state is TaskState.RUNNING
    robot.speaks = True
    team.run(0.3)
    assert [(one.id, one.epoch) for one in robot.withdrawals] == [("t1", robot.offers[0].epoch)]
    assert robot.withdrawals[0].why == "it was given to others: it is running at r2"
    other.end(TaskState.DONE)
    team.run(0.3)
    assert team.states() == {"t1": TaskState.DONE}


def test_what_a_lost_robot_finished_counts_and_the_other_is_told_to_stop(team, kept, robot):
    other = team.robot("r2", 4.0)
    team.run(0.5)
    team.submit(visit())
    team.run(0.5)
    robot.speaks = False
    team.run(2.3)
    assert other.task.state is TaskState.RUNNING
    robot.end(TaskState.DONE, "there")
    robot.speaks = True
    team.run(0.3)
    record = kept.find("t1")
    assert (record.state, record.robot, record.epoch) == (TaskState.DONE, "r1", robot.offers[0].epoch)
    assert other.task.state is TaskState.CANCELLED
    assert robot.withdrawals == []
    other.task = None
    team.run(1.0)
    assert team.history("t1").count(TaskState.DONE) == 1
