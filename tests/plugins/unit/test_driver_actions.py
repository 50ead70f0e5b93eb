"""The driver's long actions."""

import math

import pytest

from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.model.geometry import Point2D, Pose2D

START = Pose2D(1.0, 2.0, 0.5)


@pytest.fixture
def robot(stage, room):
    """A robot in a room of 6 × 4 m, and all its events."""
    one = stage(room(6.0, 4.0), r1=START)
    one.events = one.inbox(ROBOT_EVENT, robot="r1", plugin="driver")
    one.host("localisation")
    one.run(0.4)
    return one


def told(one, event):
    return [received.message.value for received in one.events.drain() if received.message.event == event]


def end_of(one, action, limit_s=30.0):
    """Runs until the action ends."""
    ends = []
    one.run_until(lambda: ends.extend(told(one, "finished")) or ends, limit_s)
    (end,) = ends
    assert end["action"] == action
    return end["outcome"], end["why"]


def ahead_m(one):
    """How far it has come in the direction that it looked in at the start, and how far aside of that."""
    pose = one.truth().pose
    dx, dy = pose.x_m - START.x_m, pose.y_m - START.y_m
    cos, sin = math.cos(START.yaw_rad), math.sin(START.yaw_rad)
    return cos * dx + sin * dy, cos * dy - sin * dx


@pytest.mark.parametrize("distance_m", [1.0, -0.6])
def test_drive_goes_straight_ahead_or_back_without_turning(robot, distance_m):
    action = robot.call("driver", "drive", distance_m)
    assert action == "drive-1"
    assert robot.call("driver", "motion") == Motion.DRIVING
    assert end_of(robot, action) == ("done", "")
    robot.run(0.5)
    along_m, aside_m = ahead_m(robot)
    assert along_m == pytest.approx(distance_m, abs=0.1)
    assert aside_m == pytest.approx(0.0, abs=0.05)
    assert robot.truth().pose.yaw_rad == pytest.approx(START.yaw_rad, abs=0.05)
    assert robot.call("driver", "motion") == Motion.STOPPED


@pytest.mark.parametrize(
    ("end", "outcome", "why"),
    [
        (lambda one: one.call("driver", "stop"), "cancelled", "the driver was told to stop"),
        (lambda one: one.call("driver", "turn", 1.0), "superseded", "superseded by turn-2"),
        (
            lambda one: one.plugin("driver").follow([Point2D(1.0, 0.0)]),
            "superseded",
            "superseded by a call from outside",
        ),
        (lambda one: one.halt(), "cancelled", "emergency halt"),
        (lambda one: one.hosts[0].manager.unload("driver", cascade=True), "cancelled", "it is being unloaded"),
    ],
    ids=["stop", "turn", "follow", "halt", "unload"],
)
def test_what_comes_between_ends_the_action_and_says_so(robot, end, outcome, why):
    action = robot.call("driver", "drive", 3.0)
    robot.run(1.0)
    end(robot)
    assert end_of(robot, action, 0.1) == (outcome, why)


def test_a_halted_action_does_not_go_on_when_the_robot_is_resumed(robot):
    action = robot.call("driver", "turn", 6.0)
    robot.run(0.5)
    robot.halt()
    assert end_of(robot, action, 0.1) == ("cancelled", "emergency halt")
    robot.run(1.0)
    before = robot.truth().pose
    robot.halt(halted=False)
    robot.run(2.0)
    assert robot.truth().pose == before


def test_an_action_that_a_call_begins_while_a_halt_comes_does_not_go_on_when_the_robot_is_resumed(robot):
    host = robot.hosts[0]
    plugin = host.manager.get("driver").plugin
    start = plugin._actions.start

    def start_late(name):
        host.manager.halt()
        return start(name)

    plugin._actions.start = start_late
    action = plugin.drive(3.0)
    before = robot.truth().pose
    host.manager.resume()
    robot.run(2.0)
    assert robot.truth().pose == before
    assert end_of(robot, action, 0.1) == ("cancelled", "emergency halt")
