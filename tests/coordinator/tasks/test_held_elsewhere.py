"""Queued tasks that a robot may be at which the coordinator does not hear."""

import pytest

from robrain.coordinator.tasks.eligibility import HeldElsewhere
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.team.roster import Robot, Roster
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.robots.robot_messages import RobotState, TaskStatus
from robrain.protocol.messages.tasks.consensus_messages import TaskHeldBy, TeamBallot
from robrain.protocol.model.ballot import Ballot
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState


class Elsewhere:
    def __init__(self):
        self.roster = Roster()
        self.book = TaskBook(VirtualClock(), 0, lambda _: None)
        for name in ("t1", "t2"):
            self.book.add(Task(id=name, kind="visit", place=Point2D(1.0, 2.0)))
        self.held = HeldElsewhere(self.book, self.roster)

    def say(self, robot, now_s, **remaining_s):
        absent = [TaskHeldBy(id=task, robot="r9", remaining_s=value) for task, value in remaining_s.items()]
        said = TeamBallot(robot=robot, ballot=Ballot(robot=robot, number=1, bids=(), received=()), absent=absent)
        self.held.receive(said, to_ns(now_s))

    def by(self, now_s):
        return [self.held.by(name, to_ns(now_s)) for name in ("t1", "t2")]


@pytest.fixture
def one():
    return Elsewhere()


def test_a_task_waits_for_as_long_as_it_was_said_and_longer_if_another_robot_says_so(one):
    one.say("r1", 10.0, t1=5.0)
    assert one.by(14.9) == ["r9", ""]
    one.say("r2", 12.0, t1=1.0)
    assert one.by(14.9) == ["r9", ""]
    assert one.by(15.0) == ["", ""]
    one.say("r2", 12.0, t1=8.0)
    assert one.by(19.9) == ["r9", ""]


def test_what_the_robot_says_itself_counts_alone(one):
    one.say("r1", 10.0, t1=50.0)
    one.say("r9", 11.0)
    assert one.by(11.0) == ["", ""]
    one.say("r9", 11.0, t1=50.0)
    assert one.by(11.0) == ["", ""], "it is there, and does not speak of itself like this"


def test_a_robot_that_is_up_is_waited_for_only_if_it_is_at_the_task(one):
    one.say("r1", 10.0, t1=50.0, t2=50.0)
    robot = one.roster.robots["r9"] = Robot("r9")
    robot.has_token, robot.received_ns = True, to_ns(11.0)
    assert one.by(11.0) == ["r9", "r9"], "its state is not known yet"
    status = TaskStatus(id="t1", epoch=0, state=TaskState.RUNNING)
    robot.state = RobotState(robot="r9", task=status)
    assert one.by(11.0) == ["r9", ""]
    robot.state = RobotState(robot="r9", next_task=status)
    assert one.by(11.0) == ["r9", ""]
    assert one.by(13.0) == ["r9", "r9"], "it is silent again"


def test_only_tasks_that_are_queued_here_are_remembered(one):
    one.book.move("t2", TaskState.CANCELLED, None)
    one.say("r1", 10.0, t2=50.0, t3=50.0)
    assert one.held._until == {}
