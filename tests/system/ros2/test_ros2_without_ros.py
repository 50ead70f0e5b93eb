"""Where ROS 2 is not installed, a robot that wants it says so, and all others run."""

import pytest

from tests.system.conftest import Commands
from tests.system.plain_install import plain_python_path

pytestmark = pytest.mark.system

ROBOT = """
[robot]
name = "r1"
load = ["mocdevice", "scan", "bm2", "command"]

[robot.roles]
mocdevice = "ros2_base"
scan = "ros2_scan"
bm2 = "ros2_battery"
"""


@pytest.fixture
def plain(commands: Commands, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    (commands.folder / "r1.toml").write_text(ROBOT)
    return {"PYTHONPATH": plain_python_path(tmp_path_factory.mktemp("path"))}


def test_the_agent_names_the_extra_that_its_ros2_devices_need(commands: Commands, plain: dict[str, str]) -> None:
    commands.start("hub", "--listen", commands.hub.endpoint)
    agent = commands.start("agent", "r1.toml", **plain)
    line = commands.line_with(agent, "agent: r1 without ")
    assert line == "agent: r1 without bm2, mocdevice, scan: pip install 'robrain[ros2]'\n"


def test_the_doctor_names_the_extra_that_a_robots_ros2_devices_need(commands: Commands, plain: dict[str, str]) -> None:
    done = commands.run("doctor", "r1.toml", **plain)
    assert "mocdevice, scan, bm2 need robrain[ros2]" in done.stdout.replace("\n", " ")
    assert "pip install 'robrain[ros2]'" in done.stdout
