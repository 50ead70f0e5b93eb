"""A robot whose own Nav2 drives it does tasks of a team; a small action server stands for Nav2."""

import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.ros2_interfaces.build import is_built, variables
from tests.waiting import until

pytest.importorskip("rclpy", reason="ROS 2 is not installed here: pip install 'robrain[ros2]'")

from tests.system.ros2.ros_robot import robot_file

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(not is_built(), reason="interfaces are not built here: make ros2-interfaces"),
]

NAV_SERVER = Path(__file__).parent / "nav_server.py"


@pytest.fixture
def nav2(domain):
    environment = {**os.environ, **variables(), **domain.variables}
    words = [sys.executable, str(NAV_SERVER), "--ros-args", "-r", "__ns:=/r1"]
    with subprocess.Popen(words, env=environment) as process:
        yield process
        process.kill()


def test_nav2_drives_the_robot_to_a_task_and_a_halt_stops_it(ros_robot, nav2, listener, commands, coordinator, team):
    ros_robot()
    roles = {"mocdevice": "ros2_base", "scan": "ros2_scan", "bm2": "ros2_battery", "driver": "ros2_navigator"}
    text = robot_file(roles=roles, load=["visit", "battery", "energy", "command"], driver={"namespace": "/r1"})
    (commands.folder / "r1.toml").write_text(text)
    agent = commands.start("agent", "r1.toml", "--connect", coordinator, **variables())
    commands.line_with(agent, "agent: r1 is up with")
    done = team.wait(team.submit("visit", place=(2.4, 1.6)), timeout_s=120.0)
    assert done.state == "done", done
    x_m, y_m = listener.place_m()
    assert math.hypot(x_m - 2.4, y_m - 1.6) < 0.5
    team.submit("visit", place=(0.6, 3.2))
    until(lambda: listener.path_m(0.3) > 0.03, "the robot does not drive")
    assert team.halt("r1").confirmed == ("r1",)
    until(lambda: listener.path_m(1.0) < 0.001, "the robot drives on though it is halted")
