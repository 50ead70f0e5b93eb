"""A ROS 2 robot that knows nothing of robrain is driven, and what goes wrong with it is named and survived."""

import math
import signal
import subprocess
import time
from typing import Any

import pytest

from robrain.client.team import Team
from robrain.plugins.device.ros2.ros2_base import ZEROS
from robrain.protocol.errors import CallError, NobodyThere
from tests.system.conftest import Commands
from tests.waiting import until

pytest.importorskip("rclpy", reason="ROS 2 is not installed here: pip install 'robrain[ros2]'")

from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from tests.system.ros2.ros_robot import robot_file

pytestmark = pytest.mark.system

BACK_S = 2.0
GRACE_S = 1.0
"""Beyond a limit, for machines with other work."""


def start_agent(commands: Commands, endpoint: str, **parameters: dict[str, object]) -> "subprocess.Popen[str]":
    (commands.folder / "r1.toml").write_text(robot_file(**parameters))
    agent = commands.start("agent", "r1.toml", "--connect", endpoint)
    commands.line_with(agent, "agent: r1 is up with")
    return agent


def fault_of(team: Team, plugin: str) -> str:
    """Why a plugin of the robot does not run; empty if it does."""
    try:
        infos = {info.name: info for info in team.plugins("r1")}
    except (NobodyThere, CallError):
        return ""
    return infos[plugin].why if infos[plugin].state == "faulted" else ""


def runs(team: Team, *plugins: str) -> bool:
    try:
        infos = {info.name: info for info in team.plugins("r1")}
    except (NobodyThere, CallError):
        return False
    return all(infos[plugin].state == "active" for plugin in plugins)


def called(team: Team, plugin: str, function: str) -> Any:
    """What a plugin answers; on a busy machine its device may have a fault for a moment."""

    def answers() -> list[Any]:
        try:
            return [team.call("r1", plugin, function)]
        except (NobodyThere, CallError):
            return []

    return until(answers, f"{plugin} does not answer", pause_s=0.1)[0]


def wander(team: Team, seconds: float) -> None:
    """Have the robot drive around, as soon as it can."""

    def started() -> bool:
        try:
            team.call("r1", "wander", "start", seconds)
        except (NobodyThere, CallError):
            return False
        return True

    until(started, "the robot does not wander", pause_s=0.1)


def test_a_robot_that_hangs_or_whose_node_dies_is_a_named_fault_and_is_back_when_it_speaks_again(
    ros_robot, listener, commands, coordinator, team
):
    robot = ros_robot(holonomic=True)
    start_agent(commands, coordinator, mocdevice={"holonomic": True})
    until(lambda: called(team, "driver", "bus_counters")["believed"] > 20, "no odometry", pause_s=0.1)
    robot.signal(signal.SIGSTOP)
    try:
        began_s = time.monotonic()
        why = until(lambda: fault_of(team, "mocdevice"), "no fault")
        assert time.monotonic() - began_s < 0.6 + GRACE_S
        assert why.startswith("BusFault: no odometry for 0.5")
        time.sleep(1.0)
    finally:
        robot.signal(signal.SIGCONT)
    began_s = time.monotonic()
    until(lambda: runs(team, "mocdevice", "driver"), "the robot is not back")
    assert time.monotonic() - began_s < BACK_S + GRACE_S
    wander(team, 600.0)
    until(lambda: listener.path_m(0.3) > 0.02, "the robot does not drive")
    robot.kill()
    why = until(lambda: fault_of(team, "mocdevice"), "no fault")
    assert "no odometry" in why
    assert "/r1/odom" in why
    assert "/r1/scan" in until(lambda: fault_of(team, "scan"), "no fault of the lidar")
    time.sleep(5.0)  # longer than a pause that doubles would be short
    robot.start()
    listener.place_m()  # it speaks
    began_s = time.monotonic()
    until(lambda: runs(team, "mocdevice", "scan", "driver", "localisation"), "the robot is not back")
    assert time.monotonic() - began_s < BACK_S + GRACE_S


def test_messages_that_cannot_be_are_refused_and_the_wheels_stand_when_the_robot_is_halted_and_when_its_agent_dies(
    ros_robot, listener, commands, coordinator, team
):
    ros_robot(holonomic=True)
    agent = start_agent(commands, coordinator, mocdevice={"holonomic": True})
    odometry = listener.node.create_publisher(Odometry, "/r1/odom", 10)
    scans = listener.node.create_publisher(LaserScan, "/r1/scan", 10)
    until(lambda: odometry.get_subscription_count() and scans.get_subscription_count(), "nobody listens")
    until(lambda: runs(team, "mocdevice", "scan"), "the devices do not run")
    places = [_odometry_at(value) for value in (math.nan, math.inf, 1e300)]
    turns = [
        LaserScan(),
        LaserScan(angle_increment=math.nan, range_max=8.0, ranges=[1.0] * 8),
        LaserScan(angle_increment=0.1, angle_max=0.7, range_max=8.0, ranges=[math.nan] * 8),
    ]
    for message in (*places, _odometry_at(0.0, w=0.0)):
        _refused(odometry, message, lambda: called(team, "driver", "bus_counters")["rejected"])
    for turn in turns:
        _refused(scans, turn, lambda: called(team, "scan", "rejected"))
    assert "expected" in team.call("r1", "scan", "rejection")
    wander(team, 600.0)
    until(lambda: listener.path_m(0.3) > 0.02, "the robot does not drive")
    assert runs(team, "mocdevice", "scan")
    zeros: list[bool] = []
    listener.node.create_subscription(Twist, "/r1/cmd_vel", lambda each: zeros.append(each == Twist()), 10)
    assert team.halt("r1").confirmed == ("r1",)
    until(lambda: listener.path_m(1.0) < 0.001, "the robot drives on though it is halted")
    zeros.clear()
    # More than a stop is repeated: for as long as the robot is halted.
    assert listener.spin(30.0, lambda: len(zeros) > 2 * ZEROS)
    assert all(zeros)
    assert team.resume("r1").confirmed == ("r1",)
    wander(team, 600.0)
    until(lambda: listener.path_m(0.3) > 0.02, "the robot does not drive")
    agent.send_signal(signal.SIGKILL)
    until(lambda: listener.path_m(0.5) < 0.001, "the robot drives on without its agent")


def _odometry_at(x_m, w=1.0):
    odometry = Odometry()
    odometry.pose.pose.position.x, odometry.pose.pose.orientation.w = x_m, w
    return odometry


def _refused(publisher, message, count):
    """Publish until the message has been counted: the first may come before the subscription knows the publisher."""
    before = count()
    until(lambda: count() > before, f"{message} is not refused", step=lambda: publisher.publish(message), pause_s=0.1)
