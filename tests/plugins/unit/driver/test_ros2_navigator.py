"""The driver that has Nav2 drive, on a clock of the test's, with a Nav2 that the test plays."""

import math

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed here: pip install 'robrain[ros2]'")

from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.plugins.device.ros2 import topic_device
from robrain.plugins.unit.driver import ros2_navigator
from robrain.plugins.unit.driver.interface import Motion
from robrain.plugins.unit.driver.ros2_navigator import GoalEnd
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from tests.plugins.device.ros2.fake_link import Link
from tests.plugins.device.ros2.ros_words import STANDING, odometry

START = Pose2D(5.0, 2.0, math.pi / 2)
"""Where the robot's own odometry begins."""


class Nav2:
    """Takes goals."""

    def __init__(self):
        self.goals = []
        self.ends = []
        self.cancelled = 0
        self.is_closed = False

    def send(self, number, pose, frame, stamp):
        self.goals.append((number, pose, frame))

    def cancel(self):
        self.cancelled += 1

    def drain(self):
        ends, self.ends = self.ends, []
        return ends

    def close(self):
        self.cancel()
        self.is_closed = True

    def end(self, why):
        """The last goal ends."""
        self.ends.append(GoalEnd(self.goals[-1][0], why))


class Robot:
    def __init__(self, one, link, nav2, **parameters):
        self.one, self.link, self.nav2, self.number = one, link, nav2, 0
        roles = {"mocdevice": "ros2_base", "driver": "ros2_navigator"}
        table = RobotTable("r1", "test", load=["driver", "command"], roles=roles)
        self.host = one.add(RobotFile(robot=table, parameters={"driver": parameters}))
        self.host.start()
        self.ended = one.inbox(ROBOT_EVENT, robot="r1", plugin="driver")
        self.stand()
        self.run(0.1)

    def stand(self, pose=START, velocity=STANDING):
        self.number += 1
        self.link.inboxes["/odom"].put(odometry(pose, velocity), self.one.clock.now_ns(), self.number)

    def run(self, seconds):
        self.one.run(seconds, self.stand)

    @property
    def driver(self):
        return self.host.manager.get("driver").plugin

    def ends(self):
        told = [each.message for each in self.ended.drain()]
        return [(each.value["outcome"], each.value["why"]) for each in told if each.event == "finished"]


@pytest.fixture
def build(stage, monkeypatch):
    one, link, nav2 = stage(), Link(), Nav2()
    link.clock = one.clock
    for module in (topic_device, ros2_navigator):
        monkeypatch.setattr(module, "open_link", link.opened)
    monkeypatch.setattr(ros2_navigator, "GoalClient", lambda *_: nav2)
    return lambda **parameters: Robot(one, link, nav2, **parameters)


@pytest.fixture
def robot(build):
    return build()


def test_the_end_of_a_path_is_a_goal_in_the_frame_of_the_robots_own_odometry(robot):
    robot.driver.follow([Point2D(0.0, 0.0), Point2D(1.0, 0.0), Point2D(1.0, 1.0)])
    ((_, goal, frame),) = robot.nav2.goals
    # Of the team's frame odom, whose origin and x axis are those of the robot at its start.
    assert (goal.x_m, goal.y_m) == (pytest.approx(4.0), pytest.approx(3.0))
    assert abs(goal.yaw_rad) == pytest.approx(math.pi)
    assert frame == "odom"
    assert robot.driver.motion() is Motion.DRIVING


@pytest.mark.parametrize(
    ("function", "arguments", "x_m", "y_m", "yaw_rad"),
    [
        ("turn", (0.5,), 0.0, 0.0, 0.5),
        ("turn", (1.5 * math.pi,), 0.0, 0.0, -math.pi / 2),
        ("drive", (-2.0,), -2.0, 0.0, 0.0),
        ("go_to", (1.0, 2.0, 7.0), 1.0, 2.0, 7.0 - math.tau),
        ("drive_path", ([Point2D(1.0, 1.0)],), 1.0, 1.0, math.pi / 4),
        ("drive_path", ([Point2D(1.0, 1.0), Point2D(1.0, 3.0)],), 1.0, 3.0, math.pi / 2),
    ],
)
def test_each_action_has_an_id_and_is_a_goal_of_its_pose(robot, function, arguments, x_m, y_m, yaw_rad):
    action = getattr(robot.driver, function)(*arguments)
    assert action is not None
    ((_, goal, _frame),) = robot.nav2.goals
    expected = START.compose(Pose2D(x_m, y_m, yaw_rad))
    assert (goal.x_m, goal.y_m) == (pytest.approx(expected.x_m), pytest.approx(expected.y_m))
    assert math.remainder(goal.yaw_rad - expected.yaw_rad, math.tau) == pytest.approx(0.0, abs=1e-9)


def test_a_path_that_ends_where_the_one_before_does_is_no_new_goal(robot):
    robot.driver.follow([Point2D(1.0, 0.0), Point2D(2.0, 0.0)])
    robot.driver.follow([Point2D(1.5, 0.0), Point2D(2.05, 0.01)])
    assert len(robot.nav2.goals) == 1
    robot.driver.follow([Point2D(1.5, 0.0), Point2D(2.5, 0.0)])
    assert len(robot.nav2.goals) == 2


def test_an_action_ends_with_its_goal(robot):
    robot.driver.go_to(1.0, 0.0, 0.5)
    robot.nav2.end(None)
    robot.run(0.2)
    assert robot.ends() == [("done", "")]


def test_the_end_of_a_goal_that_was_replaced_is_not_that_of_the_new_one(robot):
    robot.driver.drive(1.0)
    robot.nav2.end("")
    robot.driver.drive(2.0)
    robot.run(0.2)
    assert robot.driver.motion() is Motion.DRIVING
    assert [outcome for outcome, _ in robot.ends()] == ["superseded"]


def test_a_goal_that_fails_blocks_the_robot_and_is_sent_again_until_its_patience_ends(build):
    robot = build(patience_s=3.0)
    robot.driver.drive(1.0)
    for _ in range(2):
        robot.nav2.end("Nav2 does not get there: error 204")
        robot.run(0.3)
        assert robot.driver.motion() is Motion.BLOCKED
        assert robot.driver.blocked_reason() == "Nav2 does not get there: error 204"
        robot.run(0.9)
    robot.nav2.end("Nav2 does not get there: error 204")
    robot.run(0.9)
    assert len(robot.nav2.goals) == 3
    assert robot.ends() == [("failed", "Nav2 does not get there: error 204, for 3 s")]
    assert robot.driver.motion() is Motion.STOPPED


def test_a_robot_that_moves_on_is_not_blocked_any_more(robot):
    robot.driver.follow([Point2D(2.0, 0.0)])
    robot.nav2.end("no way")
    robot.run(1.3)
    assert robot.driver.blocked_s() > 1.0
    robot.one.run(0.3, lambda: robot.stand(START, Twist2D(0.3, 0.0, 0.0)))
    assert robot.driver.blocked_s() == 0.0
    assert robot.driver.motion() is Motion.DRIVING


@pytest.mark.parametrize("stop", [lambda robot: robot.driver.stop(), lambda robot: robot.driver.follow([])])
def test_a_robot_that_is_to_stand_cancels_its_goal(robot, stop):
    robot.driver.follow([Point2D(2.0, 0.0)])
    stop(robot)
    assert robot.nav2.cancelled == 1
    assert robot.driver.motion() is Motion.STOPPED


def test_a_halt_cancels_the_goal_and_the_action_and_holds_the_wheels(robot):
    robot.driver.drive(2.0)
    robot.one.halt()
    robot.run(0.1)
    assert robot.nav2.cancelled >= 1
    assert robot.ends() == [("cancelled", "emergency halt")]
    assert robot.link.heard["/cmd_vel"].messages[-1].linear.x == 0.0
    robot.one.halt(halted=False)
    robot.run(0.3)
    assert robot.driver.motion() is Motion.STOPPED


def test_at_the_end_the_goal_is_cancelled_and_the_node_released(robot):
    robot.driver.drive(2.0)
    robot.host.close()
    assert robot.nav2.is_closed
    assert robot.link.users == 0


def test_where_nav2_is_not_installed_the_driver_says_so(stage, monkeypatch):
    one, link = stage(), Link()
    link.clock = one.clock
    for module in (topic_device, ros2_navigator):
        monkeypatch.setattr(module, "open_link", link.opened)
    roles = {"mocdevice": "ros2_base", "driver": "ros2_navigator"}
    host = one.add(RobotFile(robot=RobotTable("r1", "test", load=["driver", "command"], roles=roles)))
    host.start()
    assert "nav2_msgs is not installed: it comes with Nav2" in one.infos()["driver"].why
