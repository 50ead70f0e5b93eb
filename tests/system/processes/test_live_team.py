"""The live drive: arena, coordinator and agents as processes of their own over TCP."""

import json

import pytest

from robrain.recording.reader.reading import read_messages

pytestmark = pytest.mark.system


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


def test_team_knows_the_map_of_an_earlier_run_and_explores_nothing(commands) -> None:
    assert commands.run("run", "arena_small", "--record", "first.mcap").returncode == 0
    done = commands.run(
        "up", "arena_small", "--map", "first.mcap", "--known", "--robots", "2", "--no-dashboard",
        "--until", "explored=0.9", "--time-limit", "300", "--record", "live.mcap", "--json",
        timeout_s=590.0,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["ended"] == "explored"
    keys = {message.topic_key for message in read_messages(commands.folder / "live.mcap")}
    assert any(key.endswith("/robot/floor/map") for key in keys)
    assert not any(key.endswith("/task/event") for key in keys)
