"""The devices of a ROS 2 robot on a clock of the test's, with a link that the test speaks on."""

import math
import re

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed here: pip install 'robrain[ros2]'")


from robrain.agent.errors import HardwareAbsent
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.plugins.device.ros2 import ros2_base, topic_device
from robrain.plugins.device.ros2.link import Ros2Parameters, open_link
from robrain.plugins.device.ros2.ros2_base import TICK_S
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.model.geometry import Pose2D, Twist2D
from tests.plugins.device.ros2.fake_link import Link
from tests.plugins.device.ros2.ros_words import STANDING, battery, imu, odometry, scan

ROLES = {"mocdevice": "ros2_base", "scan": "ros2_scan", "bm2": "ros2_battery", "imu": "ros2_imu"}
GONE = Pose2D(0.0, 0.0, 0.0)


class Robot:
    """A host with the devices, in lockstep."""

    def __init__(self, one, link, **parameters):
        self.one, self.link = one, link
        named = {name: {"namespace": "/r1"} | parameters.get(name, {}) for name in ROLES}
        load = ["mocdevice", "scan", "bm2", "imu", "driver", "command"]
        self.host = one.add(RobotFile(robot=RobotTable("r1", "test", load=load, roles=ROLES), parameters=named))
        self.host.start()
        self.number = 0

    def say(self, pose, velocity=STANDING, **said):
        """One message of odometry, as of now."""
        self.number += 1
        message = odometry(pose, velocity, **({"stamp_ns": self.one.clock.now_ns()} | said))
        self.link.inboxes["/r1/odom"].put(message, self.one.clock.now_ns(), self.number)

    def run(self, seconds, each=None):
        def tick():
            if each is not None:
                each()
            for function in self.link.ticks:
                function()

        self.one.run(seconds, tick)

    def until(self, is_so, limit_s, each=None):
        """Run until it is so, at most for `limit_s`."""
        for _ in range(round(limit_s / 0.02)):
            if is_so():
                return
            self.run(0.02, each)
        assert is_so(), f"not so after {limit_s} s"

    @property
    def device(self):
        return self.host.manager.get("mocdevice").plugin

    @property
    def commands(self):
        return [(each.linear.x, each.linear.y, each.angular.z) for each in self.link.heard["/r1/cmd_vel"].messages]

    def state(self, plugin="mocdevice"):
        info = self.one.infos()[plugin]
        return info.state, info.why


@pytest.fixture
def link(monkeypatch):
    link = Link()

    monkeypatch.setattr(topic_device, "open_link", link.opened)
    # The clock of the gate stands for one that is never set; in these tests the robot's clock is not.
    monkeypatch.setattr(ros2_base.time, "monotonic_ns", lambda: link.clock.now_ns())
    return link


@pytest.fixture
def build(stage, link):
    def made(**parameters):
        one = stage()
        link.clock = one.clock
        return Robot(one, link, **parameters)

    return made


@pytest.fixture
def robot(build):
    return build()


def test_velocities_go_out_and_odometry_comes_in(robot):
    robot.say(Pose2D(3.0, 1.0, 0.0))
    robot.run(0.1)
    robot.device.drive(Twist2D(0.5, 0.0, 0.2))
    assert robot.commands == [(0.5, 0.0, 0.2)]
    robot.say(Pose2D(3.04, 1.0, 0.0), Twist2D(0.4, 0.0, 0.0))
    assert robot.device.pose() == Pose2D(pytest.approx(0.04), 0.0, 0.0)
    assert robot.device.velocity() == Twist2D(0.4, 0.0, 0.0)
    assert robot.device.is_fresh()
    assert robot.device.odometry_until_ns() == robot.one.clock.now_ns()


def test_beyond_the_limits_the_curvature_is_kept(robot):
    robot.device.drive(Twist2D(4.0, 0.0, 2.0))
    assert robot.commands[-1] == (1.0, 0.0, 0.5)
    robot.device.drive(Twist2D(0.5, 0.0, -6.0))
    assert robot.commands[-1] == (0.25, 0.0, -3.0)


@pytest.mark.parametrize("twist", [Twist2D(math.nan, 0.0, 0.0), Twist2D(0.0, 0.0, math.inf)])
def test_a_velocity_that_is_not_finite_is_refused(robot, twist):
    with pytest.raises(ValueError, match="finite velocity"):
        robot.device.drive(twist)
    assert robot.commands == []


@pytest.mark.parametrize(("holonomic", "left_m_s"), [(False, 0.0), (True, 0.3)])
def test_only_a_holonomic_base_is_told_to_drive_sideways(build, holonomic, left_m_s):
    robot = build(mocdevice={"holonomic": holonomic})
    assert robot.device.is_holonomic() is holonomic
    robot.device.drive(Twist2D(0.2, 0.3, 0.0))
    assert robot.commands[-1] == (0.2, left_m_s, 0.0)


def test_a_halted_robot_is_told_to_stand_until_it_is_resumed(robot):
    robot.say(GONE)
    robot.run(0.1)
    robot.device.drive(Twist2D(0.5, 0.0, 0.0))
    robot.one.halt()
    robot.run(0.1)
    before = len(robot.commands)
    robot.run(10.0)
    assert len(robot.commands) - before >= 10.0 / TICK_S
    assert set(robot.commands[before - 1 :]) == {(0.0, 0.0, 0.0)}
    robot.one.halt(halted=False)
    robot.run(0.5, lambda: robot.say(GONE))
    robot.device.drive(Twist2D(0.5, 0.0, 0.0))
    assert robot.commands[-1] == (0.5, 0.0, 0.0)


def test_a_robot_that_has_never_spoken_is_no_fault_and_is_told_in_words(robot):
    robot.link.present.clear()
    robot.run(5.0)
    assert robot.state()[0] == "active"
    assert not robot.device.is_fresh()
    assert robot.device.trouble() == "no odometry: /r1/odom has no publisher in ROS domain 7"


def test_odometry_that_stops_is_a_fault_with_its_name_and_the_wheels_are_stopped(robot):
    told = robot.one.inbox(ROBOT_EVENT, robot="r1", plugin="mocdevice")
    robot.run(1.0, lambda: robot.say(GONE))
    robot.device.drive(Twist2D(0.5, 0.0, 0.0))
    publisher = robot.link.heard["/r1/cmd_vel"]
    robot.link.present.clear()
    robot.until(lambda: robot.state()[0] == "faulted", 0.6)
    robot.run(0.02)
    assert "no odometry for 0.5" in robot.state()[1]
    assert "/r1/odom has no publisher in ROS domain 7" in robot.state()[1]
    assert publisher.messages[-1].linear.x == 0.0
    assert publisher.is_closed
    (event,) = told.drain()
    assert (event.message.value["ok"], "no odometry for 0.5" in event.message.value["why"]) == (False, True)


def test_odometry_that_is_silent_or_rejected_while_it_has_a_publisher_is_told_apart(robot):
    robot.run(1.0, lambda: robot.say(GONE))
    robot.run(0.5, lambda: robot.say(Pose2D(math.nan, 0.0, 0.0)))
    robot.until(lambda: robot.state()[0] == "faulted", 0.6)
    assert re.search(r"\d messages of /r1/odom were rejected: .*nan", robot.state()[1])


@pytest.mark.slow
@pytest.mark.parametrize("periods", [7, 29])
def test_a_robot_that_was_away_for_long_is_back_within_two_seconds_where_its_odometry_was(robot, periods):
    robot.run(0.4, lambda: robot.say(Pose2D(1.0, 0.0, 0.0)))
    robot.run(1.0, lambda: robot.say(Pose2D(1.05, 0.0, 0.0)))
    robot.link.present.clear()
    robot.run(1.0)
    for _ in range(periods):
        robot.run(3.0)
        assert robot.state()[0] == "faulted"
        assert robot.link.users == 3  # lidar, battery and IMU
    robot.link.present.add("/r1/odom")
    robot.number = 0  # its node was started again, and its odometry with it

    def say():
        if not robot.link.inboxes["/r1/odom"].is_closed:
            robot.say(Pose2D(0.2, 0.0, 0.0))

    robot.until(lambda: robot.state()[0] == "active" and robot.device.is_fresh(), 2.0, say)
    robot.run(1.0, say)
    assert robot.device.pose().x_m == pytest.approx(0.05)
    assert robot.state("driver")[0] == "active"


def test_before_a_restarted_device_has_heard_the_robot_nothing_moves(robot):
    robot.run(1.0, lambda: robot.say(GONE))
    robot.until(lambda: robot.state()[0] == "faulted", 1.0)
    robot.until(lambda: robot.state()[0] == "active", 1.0)
    robot.device.drive(Twist2D(0.5, 0.0, 0.0))
    assert robot.commands == []


def test_what_cannot_be_is_rejected_and_counted(robot):
    robot.run(0.3, lambda: robot.say(GONE))
    for wrong in (math.nan, math.inf, 1e30):
        robot.say(Pose2D(wrong, 0.0, 0.0))
    robot.run(0.1)
    assert robot.device.counters().rejected == 3
    assert robot.device.pose() == GONE
    assert "expected a place within" in robot.device.trouble()
    for message in (scan([math.nan] * 8), scan([1.0] * 8, angle_increment=math.nan), scan([])):
        robot.link.inboxes["/r1/scan"].put(message, 0)
    for message in (battery(math.nan), battery(15.0, math.nan)):
        robot.link.inboxes["/r1/battery_state"].put(message, 0)
    robot.run(0.1)
    assert robot.one.call("scan", "rejected") == 3
    assert "expected 1 to" in robot.one.call("scan", "rejection")
    assert robot.one.call("bm2", "rejected") == 2
    assert "give current_a" in robot.one.call("bm2", "rejection")
    assert robot.one.call("scan", "nearest_m") is None
    assert robot.one.call("bm2", "latest") is None


def test_a_turn_that_was_doubted_is_not_handed_on_again_after_the_restart(robot):
    def say(range_m):
        robot.link.inboxes["/r1/scan"].put(scan([range_m] * 8), robot.one.clock.now_ns())

    robot.run(0.1, lambda: say(1.0))
    robot.host.manager.get("scan").plugin.doubt("the lidar is frozen")
    robot.until(lambda: "the lidar is frozen" in robot.state("scan")[1], 0.5)
    robot.until(lambda: robot.state("scan")[0] == "active", 1.0)
    robot.run(0.3, lambda: say(1.0))
    assert robot.host.manager.get("scan").plugin.latest() is None
    robot.run(0.3, lambda: say(1.1))
    assert robot.host.manager.get("scan").plugin.latest() is not None


def test_turn_rates_go_to_the_odometry_in_the_robots_frame_and_in_order(build):
    robot = build(imu={"upside_down": True, "mounted_yaw_rad": math.pi})
    inbox, rates = robot.link.inboxes["/r1/imu/data"], robot.host.board.yaw_rates
    robot.run(1.0)
    for stamp_s, rate_rad_s in ((0.98, 0.5), (0.99, 0.6), (0.97, 0.7), (0.995, math.nan)):
        inbox.put(imu(rate_rad_s, 1.0, 2.0, stamp_ns=to_ns(stamp_s)), to_ns(1.0))
    robot.run(0.1)
    assert [one.rad_s for one in rates] == [-0.5, -0.6, -0.7]
    stamps = [one.stamp_ns for one in rates]
    assert stamps == sorted(set(stamps))
    assert stamps[-1] <= robot.one.clock.now_ns()
    latest = robot.one.call("imu", "latest")
    assert (latest["forward_m_s2"], latest["left_m_s2"]) == (pytest.approx(-1.0), pytest.approx(2.0))
    assert robot.one.call("imu", "rejected") == 1
    assert "expected a rate up to 40 rad/s" in robot.one.call("imu", "rejection")


@pytest.mark.parametrize("device", ["imu", "bm2"])
def test_devices_whose_ros_node_has_failed_are_a_fault_and_get_another(robot, device):
    robot.run(0.3)
    robot.link.failure = "the ROS 2 node has failed: test"
    robot.run(0.3)
    state, why = robot.state(device)
    assert (state, "the ROS 2 node has failed: test" in why) == ("faulted", True)


def test_at_the_end_everything_is_released(robot):
    robot.run(0.1)
    assert robot.link.users == 4
    robot.host.close()
    assert robot.link.users == 0
    assert all(inbox.is_closed for inbox in robot.link.inboxes.values())
    assert all(publisher.is_closed for publisher in robot.link.heard.values())
    assert robot.link.ticks == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plugin", "wrong", "what"),
    [
        ("mocdevice", {"odom": "odom now"}, "topic such as"),
        ("mocdevice", {"namespace": "/r 1"}, "namespace"),
        ("mocdevice", {"domain_id": 233}, "domain_id <= 232"),
        ("mocdevice", {"silent_s": 0.0}, "silent_s"),
        ("scan", {"beams": 0, "mount": {"x_m": 0.1}}, "beams > 0"),
        ("scan", {"mount": {"yaw_rad": 7.0}}, "mount: expected yaw_rad"),
        ("bm2", {"current_a": math.nan}, "finite"),
        ("imu", {"mounted_yaw_rad": math.inf}, "finite mounted_yaw_rad"),
    ],
)
def test_a_parameter_that_cannot_be_is_named(build, plugin, wrong, what):
    robot = build(**{plugin: wrong})
    assert robot.state(plugin)[0] != "active"
    assert what in robot.state(plugin)[1]


def test_a_ros_robot_does_not_run_in_lockstep(stage):
    one = stage()
    host = one.host("command")
    with pytest.raises(HardwareAbsent, match="wall clock"):
        open_link(host.manager.get("command").environment, Ros2Parameters())
