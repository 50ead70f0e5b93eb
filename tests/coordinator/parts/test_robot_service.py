"""Robots are taken out of service; whole runs are in `tests/sim/lockstep/test_robots_out_of_service.py`."""

from types import NoneType

from robrain.protocol.messages.team.service_messages import COORDINATOR_HOLD_ROBOT, ServiceHold
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import OutOfService, RobotOut


def test_a_task_that_is_given_back_goes_to_another_robot_only_once_the_first_has_stopped(team):
    """The first robot falls silent, so it may still do the task until its lease and the guard time are over."""
    first, other = team.settle("r1", 6.0, 4.0), team.robot("r2", 8.0, 4.0)
    team.run(12.0)
    team.submit(Task(id="t1", kind="visit", place=Point2D(5.0, 4.0)))
    team.run(4.0)
    assert first.task.state is TaskState.RUNNING
    first.speaks = False
    team.ask(COORDINATOR_HOLD_ROBOT, ServiceHold(robot="r1", gives_back=True), NoneType)
    team.run(1.0)
    assert not other.offers
    assert team.coordinator.tasks.find("t1").recalled
    team.run(4.0)
    assert [offer.task.id for offer in other.offers] == ["t1"]


def test_a_task_that_is_given_back_says_why(team):
    first = team.settle("r1", 6.0, 4.0)
    team.submit(Task(id="t1", kind="visit", place=Point2D(5.0, 4.0)))
    team.run(4.0)
    team.ask(COORDINATOR_HOLD_ROBOT, ServiceHold(robot="r1", gives_back=True, reason="repair"), NoneType)
    team.run(1.0)
    record = team.coordinator.tasks.find("t1")
    assert first.task.state is TaskState.CANCELLED
    assert (record.state, record.reason.robot, record.attempts) == (TaskState.QUEUED, "r1", 0)
    assert isinstance(record.reason, RobotOut)
    assert isinstance(record.reason.because, OutOfService)
