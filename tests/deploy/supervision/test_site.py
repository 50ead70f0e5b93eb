"""Command lines of a team's processes, for first and later starts; files that go with them."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from robrain.deploy.errors import UsageError
from robrain.deploy.processes.arena_process import resumed, robot_file_of, started_again, write_resume
from robrain.deploy.supervision.up import Printed, Site
from robrain.protocol.messages.team.arena_messages import ArenaTruth, RobotTruth
from robrain.protocol.model.geometry import Pose2D
from robrain.sim.scenarios.scenario import Scenario


@pytest.fixture
def site(tmp_path) -> Site:
    return Site(tmp_path, "tcp/127.0.0.1:1", "blue", SimpleNamespace(), Printed(0))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def world():
    return Scenario.builtin("arena_small").replace(robots=2).world()


def test_two_coordinators_are_candidates_with_journals_of_their_own(site) -> None:
    parts = ["coordinator", "stand-by", "r1"]
    first, second = site.coordinators(Path("runs/a.journal"), [], parts, ["r1", "r2", "r3"])
    for part, journal in ((first, "runs/a.journal"), (second, "runs/a-stand-by.journal")):
        for start in (1, 2):
            words = part.arguments(start)
            assert words[words.index("--witnesses") + 1] == "r1,r2,r3"
            assert words[words.index("--journal") + 1] == journal
    [alone] = site.coordinators(Path("j"), [], ["coordinator"], [])
    assert "--witnesses" not in alone.arguments(1)


def test_recorder_that_comes_back_writes_another_file(site) -> None:
    part = site.recorder(Path("runs/live.mcap"), None)
    assert part.arguments(1)[2] == "runs/live.mcap"
    assert part.arguments(3)[2] == "runs/live_again_3.mcap"


def test_dashboard_that_comes_back_keeps_its_port(site) -> None:
    part = site.dashboard()
    assert part.arguments(1)[-1] == "0"
    site.printed.read("dashboard", "dashboard: http://127.0.0.1:8123")
    assert part.arguments(2)[-1] == "8123"


def test_hub_that_comes_back_listens_where_the_first_did() -> None:
    printed = Printed(None)
    printed.read("hub", "hub: tcp/127.0.0.1:4000, tcp/[::1]:4000")
    printed.read("hub", "hub: tcp/127.0.0.1:5000")
    assert printed.endpoint == "tcp/127.0.0.1:4000"


def test_messages_of_all_recorders_are_counted_together() -> None:
    printed = Printed(None)
    for line in ('{"messages": 3, "bytes": 1}', "{", "recording", '{"messages": 4}', '{"messages": "x"}'):
        printed.read("recorder", line)
    assert printed.messages == 7


def test_robots_stand_where_they_stood_when_the_arena_comes_back(tmp_path, world) -> None:
    pose = Pose2D(2.0, 1.0, 0.5)
    truth = ArenaTruth(
        sim_time_s=9.0, robots=[RobotTruth(robot="r2", pose=pose, collisions=0, distance_m=1.0, energy_j=2.0)]
    )
    again = resumed(world, write_resume(tmp_path / "resume.json", truth))
    assert [robot.start for robot in again.robots] == [world.robots[0].start, pose]


def test_file_to_resume_from_that_is_wrong_is_told(tmp_path, world) -> None:
    (tmp_path / "x.json").write_text(json.dumps({"r1": 3}))
    with pytest.raises(UsageError, match="--resume"):
        resumed(world, tmp_path / "x.json")


def test_agent_that_comes_back_begins_where_its_robot_last_said_it_was(world) -> None:
    robot_file = robot_file_of(world, world.robots[1], team="blue", connect="tcp/127.0.0.1:1")
    again = started_again(robot_file, Pose2D(2.0, 1.0, 0.5)).parameters["localisation"]
    assert (again["x_m"], again["y_m"], again["yaw_rad"], again["start_known"]) == (2.0, 1.0, 0.5, True)
    assert again["wall_slack_cells"] == robot_file.parameters["localisation"]["wall_slack_cells"]
    assert started_again(robot_file, None).parameters["localisation"]["start_known"] is False
