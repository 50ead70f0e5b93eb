"""`robrain journal` and `robrain fork` by the command line."""

import json
import signal
from pathlib import Path

import pytest

from robrain.protocol.messages.tasks.task_messages import TASK_LIST, TASK_SUBMIT, TaskFilter, TaskSubmission
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.session import listening_at
from robrain.recording.reader.reading import is_truncated, recording_info
from tests.asking import until_answered
from tests.system.conftest import Commands

pytestmark = pytest.mark.system

UP = "coordinator: of team default; Ctrl-C"


def test_journal_is_backed_up_while_the_coordinator_runs_and_restored_when_it_is_dead(
    commands, hub, wire, tmp_path
) -> None:
    endpoint = next(where for where in listening_at(hub) if where.startswith("tcp/"))
    journal = tmp_path / "default.journal"
    first = commands.start("coordinator", "--connect", endpoint, "--journal", str(journal))
    commands.line_with(first, UP)

    def submit(name: str) -> None:
        task = Task(id=name, kind="visit", place=Point2D(1.0, 1.0))
        until_answered(lambda: wire.ask(TASK_SUBMIT, TaskSubmission(task=task)))

    submit("t1")
    told = json.loads(commands.run_here("journal", "backup", "--connect", endpoint, "--json").stdout)
    assert (told["tasks"], told["open"]) == (1, 1)
    assert told["path"].startswith(f"{journal}.backups/")
    submit("t2")
    restore = ("journal", "restore", told["path"], "--journal", str(journal))
    assert "another coordinator writes it" in commands.refused(*restore)
    first.send_signal(signal.SIGKILL)
    first.wait()
    assert f"{journal}: 2 tasks, 2 of them open" in commands.run_here("journal", "check", str(journal)).stdout
    restored = commands.run_here(*restore)
    assert restored.returncode == 0, restored.stderr
    assert "were put aside as" in restored.stdout
    assert f"{journal}: 1 tasks, 1 of them open" in restored.stdout
    second = commands.start("coordinator", "--connect", endpoint, "--journal", str(journal))
    commands.line_with(second, UP)
    assert [record.task.id for record in until_answered(lambda: wire.ask(TASK_LIST, TaskFilter()))] == ["t1"]


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


def test_interrupted_fork_closes_its_recording(commands) -> None:
    words = ("fork", "run.mcap", "--at", "1s", "--seconds", "100000", "--output", "fork.mcap", "--json", "--progress")
    process = commands.start(*words)
    commands.line_with(process, '"progress":{"now_s":2')
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 130
    assert not is_truncated(commands.folder / "fork.mcap")
    assert recording_info(commands.folder / "fork.mcap").digest
