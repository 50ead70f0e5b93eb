"""`robrain fork` as a person uses it."""

import json
import signal
from pathlib import Path

import pytest

from robrain.recording.reader.reading import is_truncated, recording_info
from tests.system.conftest import Commands

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    commands = Commands(tmp_path_factory.mktemp("recording"))
    words = ("run", "arena_small", "--seed", "3", "--time-limit", "6", "--until", "explored=1")
    assert commands.run_here(*words, "--record", "run.mcap").returncode == 0
    commands.stop_all()
    return (commands.folder / "run.mcap").read_bytes()


@pytest.fixture(autouse=True)
def path(commands: Commands, recording: bytes) -> Path:
    """The recording, in the folder of the commands."""
    path = commands.folder / "run.mcap"
    path.write_bytes(recording)
    return path


def test_fork_tells_that_the_part_before_is_equal_and_sets_both_runs_beside_each_other(commands) -> None:
    done = commands.run_here(
        "fork", "run.mcap", "--at", "3s", "--without", "r2", "--task", "visit --at 2,2 --priority 2"
    )
    assert done.returncode == 0, done.stderr
    assert "before 3 s: equal, " in done.stdout
    assert "after it: without r2, a task to visit at 2, 2" in done.stdout
    assert "visit-1" in done.stdout
    assert "recorded in run.fork-3s.mcap" in done.stdout
    differs = commands.run_here("diff", "run.mcap", "run.fork-3s.mcap")
    assert differs.returncode == 1
    assert "message " in differs.stdout
    assert "visit-1" in differs.stdout
    told = json.loads(commands.run_here("diff", "run.mcap", "run.fork-3s.mcap", "--json").stdout)
    assert told["difference"]["time_s"] > 2.9
    assert [task["task"] for task in told["runs"]["second"]["tasks"]] == ["visit-1"]
    assert "run.fork-3s.mcap: it exists already" in commands.refused("fork", "run.mcap", "--at", "3s")


def test_fork_without_changes_is_told_to_be_equal(commands, path: Path) -> None:
    done = commands.run_here("fork", "run.mcap", "--at", "0m2s", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["fork"]["same_whole"] is True
    assert told["fork"]["digest"] == recording_info(path).digest
    assert told["runs"] is None


def test_wrong_command_line_is_one_sentence(commands) -> None:
    for words, said in (
        (("--at", "9s"), "--at 9s: expected a time from 0 to 6 s, the end of run.mcap"),
        (("--at", "noon"), "--at noon: expected a time of the run"),
        (("--at", "0.5", "--without", "r7"), "--without r7: there is no such robot; there are r1 to r2"),
        (("--at", "0.5", "--task", "visit"), "a task to visit needs --at"),
        (("--at", "0.5", "--output", "x.bag"), "give a file name that ends in .mcap"),
    ):
        assert said in commands.refused("fork", "run.mcap", *words)
    assert [path.name for path in commands.folder.glob("*.mcap")] == ["run.mcap"]


def test_interrupted_fork_closes_its_recording(commands) -> None:
    words = ("fork", "run.mcap", "--at", "1s", "--seconds", "100000", "--output", "fork.mcap", "--json", "--progress")
    process = commands.start(*words)
    commands.line_with(process, '"progress":{"now_s":2')
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 130
    assert not is_truncated(commands.folder / "fork.mcap")
    assert recording_info(commands.folder / "fork.mcap").digest
