"""A journal tells when its changes are on the disk, and waits for a slow disk only beside those who write."""

import errno
import os
import shutil
import sqlite3
import threading
from pathlib import Path

import pytest

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.protocol.messages.tasks.task_messages import TaskFilter, TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.waiting import PATIENCE_S


def queued(task_id: str) -> TaskRecord:
    return TaskRecord(task=Task(id=task_id, kind="visit", place=Point2D(1.0, 2.0)), state=TaskState.QUEUED)


class Disk:
    """A disk under the journal's file that is as slow as a test wants, and keeps what a power cut would leave.

    Args:
        path: of the journal.
        folder: where copies are kept.

    """

    def __init__(self, path: Path, folder: Path) -> None:
        self.is_ready = threading.Event()
        self.has_begun = threading.Event()
        self.syncs = 0
        self.error: OSError | None = None
        self._path = path
        self._folder = folder

    def sync(self, file: int) -> None:
        """Has the file as it was when the sync began."""
        assert os.path.samestat(os.fstat(file), os.stat(f"{self._path}-wal"))
        self.syncs += 1
        kept = self._folder / str(self.syncs)
        kept.mkdir()
        for ending in ("", "-wal"):
            shutil.copyfile(f"{self._path}{ending}", f"{kept / self._path.name}{ending}")
        self.has_begun.set()
        assert self.is_ready.wait(PATIENCE_S)
        if self.error is not None:
            raise self.error

    def kept(self, sync: int) -> set[str]:
        """The tasks that are there after a power cut just behind a sync."""
        after = Journal(self._folder / str(sync) / self._path.name)
        names = {record.task.id for record in after.select(TaskFilter())}
        after.close()
        return names


class Ears:
    """Waits for what a journal tells."""

    def __init__(self) -> None:
        self.heard: list[JournalUnwritable | None] = []
        self._changed = threading.Condition()

    def tell(self, error: JournalUnwritable | None) -> None:
        with self._changed:
            self.heard.append(error)
            self._changed.notify_all()

    def wait(self, count: int) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.heard) >= count, PATIENCE_S)


@pytest.fixture
def disk(tmp_path: Path) -> Disk:
    return Disk(tmp_path / "team.journal", tmp_path)


@pytest.fixture
def journal(tmp_path: Path, disk: Disk):
    one = Journal(tmp_path / "team.journal", sync=disk.sync)
    yield one
    disk.is_ready.set()
    one.close()


def test_what_is_told_to_be_on_the_disk_survives_a_power_cut(journal: Journal, disk: Disk) -> None:
    disk.is_ready.set()
    ears = Ears()
    for number in range(1, 4):
        journal.accept(queued(f"t{number}"))
        journal.when_on_disk(ears.tell)
        ears.wait(number)
        assert disk.kept(disk.syncs) == {f"t{one}" for one in range(1, number + 1)}
    assert ears.heard == [None] * 3


def test_disk_that_hangs_holds_up_who_waits_for_it_and_nobody_else(journal: Journal, disk: Disk) -> None:
    ears = Ears()
    record = journal.accept(queued("t1"))
    journal.when_on_disk(ears.tell)
    assert disk.has_begun.wait(PATIENCE_S)
    journal.change(record)  # these return
    journal.accept(queued("t2"))
    assert journal.new_epoch() == 1
    assert ears.heard == []
    disk.is_ready.set()
    ears.wait(1)
    assert ears.heard == [None]


def test_what_comes_while_the_disk_is_busy_waits_for_one_more_sync_together(journal: Journal, disk: Disk) -> None:
    ears = Ears()
    journal.accept(queued("t0"))
    journal.when_on_disk(ears.tell)
    assert disk.has_begun.wait(PATIENCE_S)
    for number in range(1, 50):
        journal.accept(queued(f"t{number}"))
        journal.when_on_disk(ears.tell)
    disk.is_ready.set()
    ears.wait(50)
    assert disk.syncs == 2
    assert disk.kept(1) == {"t0"}
    assert len(disk.kept(2)) == 50


def test_after_a_failed_sync_nothing_is_told_to_be_on_the_disk_before_it_is_in_the_main_file(
    journal: Journal, disk: Disk, tmp_path: Path
) -> None:
    disk.error = OSError(errno.EIO, "Input/output error")
    ears = Ears()
    journal.accept(queued("t1"))
    journal.when_on_disk(ears.tell)
    assert disk.has_begun.wait(PATIENCE_S)
    journal.accept(queued("t2"))
    journal.when_on_disk(ears.tell)  # behind t1 in the file whose sync fails
    disk.is_ready.set()
    ears.wait(2)
    assert all(isinstance(told, JournalUnwritable) for told in ears.heard)
    assert disk.syncs == 1
    disk.error = None
    journal.when_on_disk(ears.tell)  # as for a submission that is repeated
    ears.wait(3)
    assert ears.heard[2] is None
    shutil.copyfile(tmp_path / "team.journal", tmp_path / "main.journal")  # without the file whose sync failed
    after = Journal(tmp_path / "main.journal")
    assert [record.task.id for record in after.open_records()] == ["t1", "t2"]
    after.close()


def test_no_task_is_accepted_while_the_main_file_cannot_be_written_after_a_failed_sync(tmp_path: Path) -> None:
    class Full(sqlite3.Connection):
        def execute(self, statement: str, *values: str) -> sqlite3.Cursor:
            if "wal_checkpoint" in statement:
                raise sqlite3.OperationalError("disk full")
            return super().execute(statement, *values)

    def fail(_file: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    journal, ears = Journal(tmp_path / "team.journal", factory=Full, sync=fail), Ears()
    journal.accept(queued("t1"))
    journal.when_on_disk(ears.tell)
    ears.wait(1)
    for _ in range(2):
        with pytest.raises(JournalUnwritable, match="disk full"):
            journal.accept(queued("t2"))
    journal.when_on_disk(ears.tell)  # a submission that is repeated
    assert "disk full" in str(ears.heard[-1])
    assert [record.task.id for record in journal.open_records()] == ["t1"]
    journal.close()


def test_journal_that_is_closed_has_told_everybody(journal: Journal, disk: Disk) -> None:
    ears = Ears()
    journal.accept(queued("t1"))
    for _ in range(10):
        journal.when_on_disk(ears.tell)
    disk.is_ready.set()
    journal.close()
    assert ears.heard == [None] * 10


def test_journal_in_memory_tells_at_once_on_the_same_thread() -> None:
    threads: list[int] = []
    Journal().when_on_disk(lambda _error: threads.append(threading.get_ident()))
    assert threads == [threading.get_ident()]
