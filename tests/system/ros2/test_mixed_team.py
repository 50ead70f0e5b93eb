"""One team of a stock robot, one with a differential base by DBC and an LD19 on a pty, and one that speaks ROS 2."""

import tomllib
from pathlib import Path

import pytest

from robrain.client.team import Team
from robrain.protocol.model.tasks.task import TaskState
from tests.ros_domain import Domain
from tests.system.conftest import Commands
from tests.system.ros2.mixed_team import Kind, MixedTeam
from tests.waiting import until

pytest.importorskip("rclpy", reason="ROS 2 is not installed here: pip install 'robrain[ros2]'")

pytestmark = pytest.mark.system

CLINIC = Path(__file__).parents[3] / "examples" / "maps" / "clinic.yaml"
PLACES = [(2.0, 4.0), (5.0, 4.0), (8.0, 4.0)]
KNOWN_M2 = 60.0
"""More than half of the clinic's floor."""


def test_all_three_explore_one_floor_and_each_does_a_task(domain: Domain, commands: Commands) -> None:
    kinds = [Kind.STOCK, Kind.DESCRIBED, Kind.ROS2]
    with (
        MixedTeam(commands, domain, f'[map]\nfile = "{CLINIC}"', PLACES, kinds) as mixed,
        Team.connect(mixed.endpoint) as team,
    ):
        second = tomllib.loads((commands.folder / "robots" / "r2.toml").read_text())
        assert second["robot"]["roles"] == {"scan": "ld19"}
        assert second["parameters"]["mocdevice"]["base"]["type"] == "differential"
        assert Path(second["parameters"]["scan"]["port"]).is_symlink()
        until(lambda: team.state().known_area_m2 > KNOWN_M2, "the floor is not explored", pause_s=0.5)
        tasks = [team.submit("visit", place=place) for place in PLACES]
        assert {team.wait(task, timeout_s=170.0).state for task in tasks} == {TaskState.DONE}

        def are_well() -> bool:
            """On a busy machine a device may be without frames for a moment."""
            return not any(state.lost or state.faulted for state in map(team.state, ("r1", "r2", "r3")))

        until(are_well, "a robot is lost, or has a fault that does not end")
        counts = team.call("r2", "scan", "line_counts")
        assert counts["packets"] > 1000
        assert counts["bad_checksums"] == 0
