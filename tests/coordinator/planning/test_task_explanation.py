"""Why a task is not offered to a robot, and which words of a robot about its task count against it."""

from collections.abc import Iterator

import pytest

from robrain.coordinator.core.core import Parts
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.team.capabilities import Capabilities
from robrain.coordinator.team.roster import Robot, Roster
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.robots.robot_messages import RobotState, TaskStatus
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER, TaskAnswer
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import Gone, NoState, RobotReason, halted, lacks_plugins
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from tests.plain_reason import Plain

NOW_NS = to_ns(100.0)


class Office:
    """Tasks, robots r1 and r2 that accept whatever they are offered, and the life of the tasks."""

    def __init__(self, wire: Endpoint) -> None:
        self.book = TaskBook(wire.clock, 1, lambda _event: None)
        self.roster = Roster()
        self.capabilities = Capabilities(wire)
        self.life = TaskLifecycle(wire, self.book, self.roster, self.capabilities, Parts())
        for name in ("r1", "r2"):
            robot = self.roster.robots[name] = Robot(name)
            robot.state = RobotState(robot=name)
            robot.received_ns = NOW_NS
            robot.has_token = True
            self.capabilities.plugins[name] = frozenset({"visit"})
            wire.answer(ROBOT_OFFER, lambda _request: TaskAnswer(accepted=True), robot=name)

    def add(self, *names: str) -> None:
        for name in names:
            self.book.add(Task(id=name, kind="visit", place=Point2D(1.0, 2.0)))

    def hold(self, task: str, after: str) -> None:
        """r1 is at one task and holds another for afterwards."""
        self.add(after, task)
        self.life.offer(after, "r1", NOW_NS)
        self.life.offer(task, "r1", NOW_NS, after=after)

    def refusal(self, task: str = "t", robot: str = "r1", now_ns: int = NOW_NS) -> RobotReason | None:
        record = self.book.find(task)
        assert record is not None
        return self.life.eligibility.refusal(record, self.roster.robots[robot], now_ns)

    def say(self, task: str, state: TaskState, why: str = "") -> None:
        record = self.book.find(task)
        assert record is not None
        self.life.receive("r1", TaskStatus(id=task, epoch=record.epoch, state=state, why=why), NOW_NS)


@pytest.fixture
def office() -> Iterator[Office]:
    with open_lockstep_session() as session:
        clock = VirtualClock()
        clock.advance_to(NOW_NS)
        wire = Endpoint(session, "default", clock, Drive.LOCKSTEP)
        yield Office(wire)
        wire.close()


# -- what speaks against a robot ------------------------------------------------------------------------------------


def test_a_robot_that_is_silent_or_gone_is_not_asked(office: Office) -> None:
    office.add("t")
    assert office.refusal(now_ns=NOW_NS + to_ns(0.8)) is None
    assert office.refusal(now_ns=NOW_NS + to_ns(1.5)) == Plain("lost_contact", silent_s=1.5)
    office.roster.robots["r1"].has_token = False
    assert office.refusal() == Gone()
    office.roster.robots["r1"].received_ns = None
    assert office.refusal() == NoState()


def test_a_robot_that_is_halted_is_not_asked(office: Office) -> None:
    office.add("t")
    office.roster.robots["r1"].state = RobotState(robot="r1", halted=True)
    assert office.refusal() == halted()
    assert office.refusal(robot="r2") is None


def test_a_robot_without_the_plugin_is_not_asked_and_one_whose_plugins_are_not_known_is(office: Office) -> None:
    office.add("t")
    office.capabilities.plugins["r1"] = frozenset({"explore"})
    assert office.refusal() == lacks_plugins(("visit",))
    office.capabilities.plugins["r1"] = None
    assert office.refusal() is None


# -- what a robot says of its task ----------------------------------------------------------------------------------


def test_a_task_that_was_held_and_then_begun_was_not_refused_if_it_is_given_up(office: Office) -> None:
    office.hold("t", after="first")
    office.say("first", TaskState.DONE)
    office.book.move("t", TaskState.RUNNING)
    office.say("t", TaskState.CANCELLED, "halted")
    assert office.life.backoff.pause_reason("t", "r1", NOW_NS) is None


def test_only_the_task_that_was_held_counts_as_refused(office: Office) -> None:
    office.hold("t", after="first")
    office.say("first", TaskState.CANCELLED, "halted")
    assert office.life.backoff.pause_reason("first", "r1", NOW_NS) is None


def test_a_task_that_was_offered_for_at_once_and_is_called_off_was_not_held(office: Office) -> None:
    office.hold("t", after="first")
    office.say("first", TaskState.DONE)
    office.say("t", TaskState.DONE)
    office.add("later")
    office.book.offered("later", "r1")  # the robot's answer is still on its way
    office.say("later", TaskState.CANCELLED, "halted")
    assert office.life.backoff.pause_reason("later", "r1", NOW_NS) is None
