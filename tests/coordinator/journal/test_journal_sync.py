"""Which changes are on disk when a call returns, and which may still be pending."""

import sqlite3
from pathlib import Path
from typing import Any

import msgspec
import pytest

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import EPOCH_BLOCK, Journal
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState

NORMAL, FULL = 1, 2
"""`PRAGMA synchronous`: whether a commit waits for the disk."""


class Watched(sqlite3.Connection):
    """Records how each transaction was committed; fails at a statement on demand."""

    last: "Watched"

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.commits: list[int] = []
        self.fails_at = ""
        Watched.last = self

    def execute(self, statement: str, *values: Any) -> sqlite3.Cursor:
        if self.fails_at and statement.startswith(self.fails_at):
            raise sqlite3.OperationalError("disk full")
        if statement == "COMMIT":
            self.commits.append(int(super().execute("PRAGMA synchronous").fetchone()[0]))
        return super().execute(statement, *values)

    @property
    def ceiling(self) -> int:
        """The greatest epoch reserved in the file."""
        return int(super().execute("SELECT ceiling FROM epoch").fetchone()[0])


@pytest.fixture
def journal(tmp_path: Path):
    one = Journal(tmp_path / "team.journal", factory=Watched)
    Watched.last.commits.clear()
    yield one
    one.close()


def queued(task_id: str, **fields: Any) -> TaskRecord:
    return TaskRecord(task=Task(id=task_id, kind="visit", place=Point2D(1.0, 2.0)), state=TaskState.QUEUED, **fields)


def test_no_change_of_a_task_waits_for_the_disk(journal: Journal) -> None:
    record = journal.accept(queued("t1"))
    journal.change(msgspec.structs.replace(record, state=TaskState.RUNNING, robot="r1"))
    journal.accept(queued("t2", own=True))
    assert Watched.last.commits == [NORMAL] * 3


def test_block_of_epochs_is_on_the_disk_before_the_first_of_them_is_given_out(journal: Journal) -> None:
    assert journal.new_epoch() == 1
    assert Watched.last.commits == [FULL]
    assert Watched.last.ceiling == 1 + EPOCH_BLOCK


def test_no_epoch_is_given_out_beyond_what_is_on_the_disk(journal: Journal) -> None:
    given = []
    for _ in range(2 * EPOCH_BLOCK + 3):
        given.append(journal.new_epoch())
        assert given[-1] <= Watched.last.ceiling
    assert given == list(range(1, 2 * EPOCH_BLOCK + 4))
    assert Watched.last.commits == [FULL] * 3


@pytest.mark.parametrize("demanded", [EPOCH_BLOCK, EPOCH_BLOCK + 1, EPOCH_BLOCK + 2, 10**6])
def test_epoch_that_is_demanded_beyond_the_block_is_on_the_disk_too(journal: Journal, demanded: int) -> None:
    journal.new_epoch()
    assert journal.new_epoch(demanded) == demanded
    assert demanded <= Watched.last.ceiling
    assert journal.new_epoch(5) == demanded + 1
    assert journal.new_epoch(demanded + 2) == demanded + 2
    assert demanded + 2 <= Watched.last.ceiling


def test_epoch_after_a_restart_is_beyond_all_that_the_one_before_could_have_given_out(tmp_path: Path) -> None:
    path = tmp_path / "team.journal"
    first = Journal(path, factory=Watched)
    first.new_epoch()
    ceiling = Watched.last.ceiling
    first.close()
    second = Journal(path, factory=Watched)
    assert second.new_epoch() == ceiling + 1
    second.close()


@pytest.mark.parametrize("statement", ["BEGIN", "UPDATE epoch", "COMMIT"])
def test_epoch_that_cannot_be_set_aside_is_not_given_out_and_the_next_try_is(journal: Journal, statement: str) -> None:
    Watched.last.fails_at = statement
    for _ in range(2):
        with pytest.raises(JournalUnwritable, match="disk full"):
            journal.new_epoch(7)
    assert Watched.last.ceiling == 0
    Watched.last.fails_at = ""
    assert journal.new_epoch() == 1
    assert Watched.last.ceiling == 1 + EPOCH_BLOCK


@pytest.mark.parametrize("statement", ["INSERT INTO task", "INSERT INTO change", "UPDATE task", "COMMIT"])
def test_task_that_cannot_be_written_is_not_there_and_nothing_of_it_stays(journal: Journal, statement: str) -> None:
    Watched.last.fails_at = statement
    with pytest.raises(JournalUnwritable, match="disk full"):
        journal.accept(queued("t1"))
    assert not Watched.last.in_transaction
    assert journal.find("t1") is None
    assert journal.history("t1") == []
    Watched.last.fails_at = ""
    assert journal.accept(queued("t1")).change == 1


def test_history_is_cut_to_the_last_changes_and_the_last_changed_tasks_to_their_number(journal: Journal) -> None:
    record = journal.accept(queued("t1"))
    for number in range(5):
        record = journal.change(msgspec.structs.replace(record, why=f"reason {number}"))
    assert [line.why for line in journal.history("t1", 2)] == ["reason 3", "reason 4"]
    journal.accept(queued("t2"))
    assert [one.task.id for one in journal.last_changed(1)] == ["t2"]


def test_offer_counts_as_made_only_to_its_robot_with_its_epoch(journal: Journal) -> None:
    record = journal.accept(queued("t1"))
    journal.change(msgspec.structs.replace(record, state=TaskState.OFFERED, robot="r1", epoch=3))
    journal.change(msgspec.structs.replace(record, state=TaskState.RUNNING, robot="r2", epoch=4))
    assert journal.when_offered("t1", "r1", 3)
    assert not journal.when_offered("t1", "r1", 4)
    assert not journal.when_offered("t1", "r2", 4)  # it runs it, but nobody offered it
    assert not journal.when_offered("t2", "r1", 3)
