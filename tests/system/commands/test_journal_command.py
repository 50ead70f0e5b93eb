"""`robrain journal` beside a coordinator that runs, is killed, and goes on from a backup."""

import json
import signal
from pathlib import Path

import pytest

from robrain.protocol.messages.tasks.task_messages import TaskFilter, TaskSubmission
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.table.topics import TASK_LIST, TASK_SUBMIT
from robrain.protocol.wire.session import listening_at
from tests.asking import until_answered
from tests.system.conftest import Commands
from tests.waiting import PATIENCE_S

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


@pytest.mark.slow
def test_backup_under_up_is_there_when_the_team_has_ended(commands: Commands, tmp_path: Path) -> None:
    up = commands.start("up", "depot", "--robots", "1", "--no-dashboard")
    journal = tmp_path / commands.line_with(up, "journal: ").split()[1]
    made = commands.run_until(lambda ended: ended.returncode == 0, "journal", "backup", "--json")
    up.send_signal(signal.SIGINT)
    up.wait(PATIENCE_S)
    backup = Path(json.loads(made.stdout)["path"])
    assert backup.is_relative_to(f"{journal}.backups")
    for file in (journal, backup):
        assert commands.run_here("journal", "check", str(file)).returncode == 0


def test_damaged_backup_is_told_and_ends_the_command_with_1(commands, tmp_path) -> None:
    bad = tmp_path / "bad"
    bad.write_bytes(b"no database" * 1000)
    assert commands.run_here("journal", "check", str(bad)).returncode in (1, 2)
    assert commands.run_here("journal", "restore", str(bad), "--journal", str(tmp_path / "j")).returncode == 2
    assert not (tmp_path / "j").exists()


def test_options_that_do_not_go_together_are_refused(commands, tmp_path) -> None:
    line = commands.refused("journal", "backup", "--output", str(tmp_path / "x"))
    assert "--journal and --output: give both, or neither" in line
