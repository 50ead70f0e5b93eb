"""After a link cut, a robot's token and states arrive before it can be queried."""

import pytest

from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint

SPARSE = 2
"""Maximum number of frontier offers during a second in which the robot cannot be queried."""


class Late:
    """A reply that arrives at the coordinator's next step, as in live."""

    def __init__(self, reply):
        self._reply = reply
        self._looks = 0

    def poll(self):
        self._looks += 1
        return None if self._looks == 1 else self._reply.poll()


@pytest.fixture
def team(team, monkeypatch):
    """A team in which answers to offers are as late as in live."""
    wire = team._coordinator_wire
    ask_later = wire.ask_later
    monkeypatch.setattr(wire, "ask_later", lambda *args, **names: Late(ask_later(*args, **names)))
    return team


def come_half(team, robot):
    """Restore the robot's token and states, but none of its queryables."""
    half = Endpoint(team.session, "default", team.clock, Drive.LOCKSTEP)
    half.token(ROBOT_ALIVE, robot=robot.name)
    robot._states = half.publisher(ROBOT_STATE, robot=robot.name)
    robot.speaks = True
    return half


def made(team):
    return {event.task.id for event in team.heard if event.task.id.startswith("explore-")}


def cut(team, robot):
    robot.speaks = False
    robot.leave()
    team.run(3.0)
    robot.task = None


def test_a_robot_that_cannot_be_queried_yet_gets_no_series_of_tasks(team):
    robot = team.explore()
    cut(team, robot)
    before = made(team)
    half = come_half(team, robot)
    team.run(0.8)
    assert 0 < len(made(team) - before) <= SPARSE
    assert not team.summary.all_explored
    half.close()
    robot.come()
    team.run(1.0)
    assert robot.task is not None
    assert not robot.task.state.ended
    assert robot.task.id not in before


def test_a_frontier_is_not_held_against_a_robot_that_could_not_be_asked(team):
    robot = team.robot("r1", 4.0)
    team.corridor()
    team.run(1.0)
    nearest = robot.goal
    cut(team, robot)
    half = come_half(team, robot)
    team.run(0.8)
    half.close()
    robot.come()
    team.run(1.0)
    assert robot.goal == nearest


def test_a_robot_that_refuses_frontier_after_frontier_is_asked_ever_less_often(team):
    robot = team.robot("r1")
    robot.accepts = False
    for x_m in (1.0, 2.5, 4.0, 5.5, 7.0, 8.5, 10.0):
        for y_m in (1.0, 3.0, 5.0, 7.0):
            team.draw(x_m, y_m, x_m + 0.7, y_m + 0.7)
    for y_m in (1.0, 3.0, 5.0, 7.0):
        team.draw(1.0, y_m + 0.2, 10.7, y_m + 0.7)
    team.draw(5.5, 1.0, 6.2, 7.7)
    team.run(0.8)
    assert 0 < len(robot.offers) <= 6
    robot.accepts = True
    team.run(4.0)
    assert robot.task is not None


def test_a_submitted_task_is_not_given_up_because_its_robot_cannot_be_queried(team):
    robot = team.explore()
    cut(team, robot)
    half = come_half(team, robot)
    team.submit(Task(id="v", kind="visit", place=Point2D(6.5, 4.5)))
    team.run(6.0)
    assert team.states()["v"] is TaskState.QUEUED
    half.close()
    robot.come()
    team.run(6.0)
    assert team.states()["v"] is TaskState.RUNNING
