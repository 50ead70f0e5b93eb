"""The live drive: arena, coordinator and agents as processes of their own over TCP."""

import json

import pytest

from robrain.recording.reader.reading import read_messages
from tests.system.conftest import Commands
from tests.waiting import until

pytestmark = pytest.mark.system


def _status(commands: Commands, *options: str, **variables: str) -> tuple[bool, dict[str, str]] | None:
    """Whether the coordinator is there, and how each robot is."""
    done = commands.run("status", "--json", *options, **variables)
    if done.returncode != 0:
        return None
    told = json.loads(done.stdout)
    return told["coordinator"], {robot["robot"]: robot["condition"] for robot in told["standing"]}


def test_agents_explore_a_floor_together(commands) -> None:
    done = commands.run(
        "up", "arena_small", "--robots", "2", "--no-dashboard", "--until", "explored=0.6",
        "--time-limit", "480", "--record", "live.mcap", "--json",
        timeout_s=590.0,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["ended"] == "explored"
    assert result["map_accuracy"]["share_off"] < 0.02
    assert set(result["pose_accuracy"]) == {"r1", "r2"}
    assert all(told["rmse_m"] < 0.5 for told in result["pose_accuracy"].values())
    assert 1 <= result["robots_up"] <= 2  # at the end: on a busy machine one may just not be heard
    speakers = {message.topic_key.split("/")[3] for message in read_messages(commands.folder / "live.mcap")
                if message.topic_key.endswith("/state") and "/robot/" in message.topic_key}  # fmt: skip
    assert speakers == {"r1", "r2"}


def test_team_started_by_hand_is_found_and_survives_its_coordinator(commands) -> None:
    endpoint = commands.arena("arena_small", "--robots", "1")
    nobody = commands.run_until(
        lambda done: "nobody of team other" in done.stderr, "status", "--connect", endpoint, "--team", "other"
    )
    assert nobody.returncode == 2

    commands.agents("r1")
    coordinator = commands.start("coordinator", ROBRAIN_CONNECT=endpoint)
    commands.line_with(coordinator, "coordinator: of team default")
    # On an overloaded machine a robot may lose its link and be back a moment later, so status is asked until it agrees.
    there, left = (True, {"r1": "up"}), (False, {"r1": "up"})
    until(lambda: _status(commands, ROBRAIN_CONNECT=endpoint) == there, f"status never told {there}")

    coordinator.kill()
    coordinator.wait()
    until(lambda: _status(commands, "--connect", endpoint) == left, f"status never told {left}")
