"""One team of a stock robot, one with a differential base by DBC and an LD19 on a pty, and one that speaks ROS 2."""

import tomllib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from robrain.client.team import Team
from robrain.protocol.model.tasks.task import TaskState
from tests.ros_domain import Domain
from tests.system.conftest import Commands
from tests.waiting import until

if TYPE_CHECKING:
    from tests.system.ros2.ros_robot import RosRobot

pytest.importorskip("rclpy", reason="ROS 2 is not installed here: pip install 'robrain[ros2]'")

pytestmark = pytest.mark.system

CLINIC = Path(__file__).parents[3] / "examples" / "maps" / "clinic.yaml"
SCENARIO = f"""
[scenario]
name = "mixed"
[map]
file = "{CLINIC}"
[team]
robots = 2
[[robots]]
place_m = [2.0, 4.0]
[[robots]]
type = "two_wheels"
place_m = [5.0, 4.0]
[robots.hardware.lidar]
protocol = "ld19"
"""
START = {"x": 8.0, "y": 4.0, "yaw": 0.0}
"""Of the ROS 2 robot, in a world of its own with the same walls."""
KNOWN_M2 = 85.0
PLACES = {"r1": (2.0, 4.0), "r2": (5.0, 4.0), "r3": (8.0, 4.0)}


@pytest.fixture
def third(domain: Domain) -> Iterator["RosRobot"]:
    from tests.system.ros2.ros_robot import RosRobot

    with ExitStack() as closing:
        robot = RosRobot(CLINIC, domain, **START)
        closing.callback(robot.kill)
        robot.start()
        yield robot


def test_all_three_explore_one_floor_and_each_does_a_task(third: "RosRobot", commands: Commands) -> None:
    import tomli_w

    (commands.folder / "mixed.toml").write_text(SCENARIO)
    arena = commands.start("arena", "mixed.toml", "--listen", "tcp/127.0.0.1:0", "--robot-files", "robots")
    endpoint = commands.line_with(arena, "arena: mixed at ").split(" at ")[1].split(",")[0]
    coordinator = commands.start("coordinator", "--connect", endpoint)
    commands.line_with(coordinator, "coordinator: of team default")
    folder = commands.folder / "robots"
    second = tomllib.loads((folder / "r2.toml").read_text())
    assert second["robot"]["roles"] == {"scan": "ld19"}
    assert second["parameters"]["mocdevice"]["base"]["type"] == "differential"
    assert Path(second["parameters"]["scan"]["port"]).is_symlink()
    from tests.system.ros2.ros_robot import ROLES

    known = {
        **{name: {"namespace": "/r1"} for name in ROLES},
        "localisation": {"x_m": START["x"], "y_m": START["y"], "yaw_rad": START["yaw"]},
        "mapper": second["parameters"]["mapper"],
    }
    load = ["explore", "visit", "battery", "energy", "recharge", "command"]
    table = {"name": "r3", "load": load, "roles": dict(ROLES)}
    (folder / "r3.toml").write_text(tomli_w.dumps({"robot": table, "parameters": known}))
    for name in PLACES:
        agent = commands.start("agent", f"robots/{name}.toml", "--connect", endpoint)
        commands.line_with(agent, f"agent: {name} is up with")
    with Team.connect(endpoint) as team:
        until(lambda: team.state().known_area_m2 > KNOWN_M2, "the floor is not explored", pause_s=0.5)
        tasks = [team.submit("visit", place=place) for place in PLACES.values()]
        assert {team.wait(task, timeout_s=170.0).state for task in tasks} == {TaskState.DONE}
        states = [team.state(name) for name in PLACES]
        assert not [state.robot for state in states if state.lost]
        assert not [fault for state in states for fault in state.faulted]
        counts = team.call("r2", "scan", "line_counts")
        assert counts["packets"] > 1000
        assert counts["bad_checksums"] == 0
