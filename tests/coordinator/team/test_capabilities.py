"""Who can do what: robots are asked for their plugins when it is time, and not all at once."""

from collections import Counter

import pytest

from robrain.coordinator.team.capabilities import ASKED_MOST, Capabilities
from robrain.coordinator.team.roster import Robot
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS, PluginInfo
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.wire.endpoint import Drive, Endpoint


class Desk:
    """Robots that answer, or do not."""

    def __init__(self, session):
        self.clock = VirtualClock()
        self.wire = Endpoint(session, "default", self.clock, Drive.LOCKSTEP)
        self.capabilities = Capabilities(self.wire)
        self.robots = []
        self.asked = Counter()
        self.plugins = {}

    def robot(self, name, *, plugins=("visit",), loaded=0):
        robot = Robot(name)
        robot.state = RobotState(robot=name, loaded=loaded)
        self.robots.append(robot)
        self.plugins[name] = plugins
        self.wire.answer(ROBOT_PLUGINS, lambda request: self._tell(request.names["robot"]), robot=name)
        return robot

    def follow(self, at_s):
        self.clock.advance_to(to_ns(at_s))
        return self.capabilities.follow(self.robots, self.clock.now_ns())

    def _tell(self, name):
        self.asked[name] += 1
        if self.plugins[name] is None:
            raise CallError(ErrorCode.BUSY, "not now")
        return [PluginInfo(name=plugin, level="behavior", state="active") for plugin in self.plugins[name]]


@pytest.fixture
def desk(lockstep_session):
    desk = Desk(lockstep_session)
    yield desk
    desk.wire.close()


def test_robot_whose_state_says_that_its_plugins_have_changed_is_asked_at_once(desk):
    robot = desk.robot("r1", loaded=7)
    desk.follow(0.0)
    desk.plugins["r1"] = ("visit", "arm")
    robot.state = RobotState(robot="r1", loaded=8)
    assert desk.follow(0.1)
    assert desk.capabilities.plugins["r1"] == {"r1", "visit", "arm"}


def test_robot_whose_state_says_so_is_asked_less_often_than_one_that_cannot(desk):
    desk.robot("telling", loaded=7)
    desk.robot("silent")
    for second in range(60):
        desk.follow(float(second))
    assert desk.asked["telling"] == 1
    assert desk.asked["silent"] == 6


def test_robots_that_do_not_answer_are_asked_a_few_at_a_time_and_again(desk):
    for number in range(ASKED_MOST + 10):
        desk.robot(f"r{number}", plugins=None)
    desk.follow(0.0)
    assert sum(desk.asked.values()) == ASKED_MOST
    for tenth in range(1, 60):
        desk.follow(0.1 * tenth)
    assert set(desk.asked) == {f"r{number}" for number in range(ASKED_MOST + 10)}
    assert all(plugins is None for plugins in desk.capabilities.plugins.values())


def test_robot_that_comes_again_is_asked_anew(desk):
    desk.robot("r1")
    desk.follow(0.0)
    desk.capabilities.came("r1")
    desk.follow(0.1)
    assert desk.asked["r1"] == 2
