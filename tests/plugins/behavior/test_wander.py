import pytest

from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState


@pytest.mark.slow
def test_a_robot_that_wanders_gets_about_and_runs_into_nothing(errands):
    run = errands("wander")
    assert run.call("wander", "start", 25.0) is True
    run.run(24.0)
    assert run.call("wander", "wandering") is True
    assert run.path_m() > 4.0
    assert run.arena.collisions == 0
    run.run(3.0)
    assert run.call("wander", "wandering") is False
    here = run.pose()
    run.run(2.0)
    assert run.pose() == here


@pytest.mark.slow
def test_wandering_gives_way_to_a_task_and_does_not_come_back(errands):
    run = errands("wander", "visit")
    run.call("wander", "start", 100.0)
    run.run(3.0)
    status = run.finish(Task(id="v", kind="visit", place=Point2D(4.8, 1.6), service_s=1.0))
    assert status.state is TaskState.DONE
    assert run.call("wander", "wandering") is False
    here = run.pose()
    run.run(5.0)
    assert run.pose().distance_m(here) < 0.05


def test_a_halt_ends_wandering(errands):
    run = errands("wander")
    run.call("wander", "start")
    run.run(2.0)
    halt = run.wire.publisher(HALT)
    halt.put(Halt(halted=True, by="test"))
    run.run(0.5)
    halt.put(Halt(halted=False, by="test"))
    run.run(1.0)
    here = run.pose()
    run.run(3.0)
    assert run.pose() == here
    assert run.call("wander", "start") is True


def test_a_robot_with_a_task_does_not_wander(errands):
    run = errands("wander", "visit")
    run.offer(Task(id="v", kind="visit", place=Point2D(4.8, 1.6)))
    assert run.call("wander", "start") is False


def test_wandering_ends_when_told(errands):
    run = errands("wander")
    run.call("wander", "start")
    run.run(3.0)
    run.call("wander", "stop")
    run.run(1.5)
    here = run.pose()
    run.run(3.0)
    assert run.pose() == here
    assert run.robot().board.behavior == "idle"
