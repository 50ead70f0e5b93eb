"""`robrain sweep` as a person uses it: what it prints, and what Ctrl-C and a kill leave."""

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from tests.system.conftest import Commands
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

WORDS = ("sweep", "arena_small", "--vary", "robots=1,2", "--time-limit", "3", "--output", "out", "--workers", "2")
SEEDS = ("--seeds", "1..3")


def finished(folder: Path) -> list[str]:
    """Names of the runs that the journal has as done, in its order."""
    path = folder / "out" / "runs.jsonl"
    lines = path.read_bytes().split(b"\n")[1:-1] if path.exists() else []
    records = [json.loads(line) for line in lines]
    return [record["run"] for record in records if record["state"] == "done"]


@pytest.fixture(scope="module")
def sweeping(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Commands]:
    """Runs the sweep without an interruption."""
    commands = Commands(tmp_path_factory.mktemp("whole"))
    yield commands
    commands.stop_all()


@pytest.fixture(scope="module")
def swept(sweeping: Commands) -> "subprocess.CompletedProcess[str]":
    """What it said."""
    return sweeping.run(*WORDS, *SEEDS)


@pytest.fixture(scope="module")
def whole(sweeping: Commands, swept: object) -> bytes:
    """Its table."""
    return (sweeping.folder / "out" / "table.parquet").read_bytes()


def test_it_says_how_many_runs_there_are_and_prints_means_and_differences(
    sweeping: Commands, swept: "subprocess.CompletedProcess[str]"
) -> None:
    done = swept
    assert done.returncode == 0, done.stderr
    assert "arena_small: 6 runs (2 settings × 3 seeds), 2 processes" in done.stderr
    assert "arena_small: mean [95 % interval]" in done.stdout
    assert "difference from robots=1, by seed" in done.stdout
    assert "written to out: table.parquet, runs.csv, summary.json, summary.csv, figures" in done.stdout
    again = sweeping.run(*WORDS, *SEEDS, "--json")
    assert (again.returncode, again.stderr) == (0, "")
    assert json.loads(again.stdout)["summary"]["settings"][0]["runs"] == {"done": 3}


def test_killed_then_interrupted_and_called_again_it_loses_nothing_and_does_nothing_twice(
    commands, whole: bytes
) -> None:
    table = commands.folder / "out" / "table.parquet"
    process = commands.start(*WORDS, *SEEDS)
    until(lambda: finished(commands.folder), "a run", pause_s=0.02)
    workers = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.wait(PATIENCE_S)
    killed = finished(commands.folder)
    assert 1 <= len(killed) < 5
    assert not table.exists()
    until(lambda: not any(worker.is_running() and worker.status() != "zombie" for worker in workers), "orphans ended")

    process = commands.start(*WORDS, *SEEDS)
    until(lambda: len(finished(commands.folder)) > len(killed), "another run", pause_s=0.02)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    said, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert "interrupted: the same command continues" in said
    ended = finished(commands.folder)
    assert len(killed) < len(ended) < 6
    states = [run["state"] for run in json.loads((commands.folder / "out" / "sweep.json").read_text())["runs"]]
    assert (states.count("done"), set(states) <= {"done", "interrupted", "not_run"}) == (len(ended), True)
    assert table.exists()

    done = commands.run(*WORDS, *SEEDS)
    assert done.returncode == 0, done.stderr
    assert f"6 runs (2 settings × 3 seeds), {len(ended)} of them done already" in done.stderr
    after = finished(commands.folder)
    assert after[: len(ended)] == ended
    assert len(after) == len(set(after)) == 6
    assert table.read_bytes() == whole
