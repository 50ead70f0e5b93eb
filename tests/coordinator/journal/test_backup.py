"""Backups of a journal: whole or not there, whatever ends the process, and never over a coordinator that runs."""

import multiprocessing
import os
import shutil
import signal
import sqlite3
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

import robrain.coordinator.parts.backups
from robrain.coordinator.journal import backup as backup_module
from robrain.coordinator.journal.backup import (
    PART,
    back_up_closed,
    backup_folder,
    check_journal,
    prune_backups,
    restore_backup,
    write_backup,
)
from robrain.coordinator.journal.errors import BadBackup, JournalError, JournalLocked, JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.parts.backups import Backups
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.task_messages import TaskFilter, TaskRecord
from robrain.protocol.messages.team.standing_messages import COORDINATOR_BACKUP
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.endpoint import Endpoint
from tests.waiting import until

ALL = TaskFilter(own=True, limit=10_000)


def queued(task_id: str) -> TaskRecord:
    task = Task(id=task_id, kind="visit", place=Point2D(1.0, 2.0))
    return TaskRecord(task=task, state=TaskState.QUEUED, why="w" * 500)


def fill(journal: Journal, first: int, count: int) -> None:
    for number in range(first, first + count):
        journal.accept(queued(f"t{number}"), b"{}")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "team.journal"


@pytest.fixture
def journal(path: Path):
    with closing(Journal(path)) as opened:
        fill(opened, 0, 50)
        yield opened


def ids(path: Path) -> list[str]:
    with closing(Journal(path)) as opened:
        return [record.task.id for record in opened.select(ALL)]


def test_backup_of_an_open_journal_holds_all_and_the_journal_goes_on(journal, path, tmp_path) -> None:
    found = write_backup(journal.database, path, tmp_path / "one.journal")
    assert (found.tasks, found.open, found.problems) == (50, 50, [])
    fill(journal, 50, 1)
    assert ids(tmp_path / "one.journal") == [f"t{n}" for n in range(50)]
    assert sorted(path.name for path in tmp_path.glob("one*")) == ["one.journal"]


def test_what_is_written_during_the_backup_is_in_it_and_never_waits_for_it(journal, path, tmp_path) -> None:
    fill(journal, 50, 600)  # more pages than are copied at a time
    copied, has_begun, may_go_on = [], threading.Event(), threading.Event()

    def on_pages() -> None:
        has_begun.set()
        assert may_go_on.wait(10)

    def back_up() -> None:
        copied.append(write_backup(journal.database, path, tmp_path / "one.journal", on_pages))

    thread = threading.Thread(target=back_up)
    thread.start()
    assert has_begun.wait(10)
    fill(journal, 650, 20)  # the backup stands still, and holds nothing up
    assert not (tmp_path / "one.journal").exists()
    may_go_on.set()
    thread.join()
    assert copied[0].tasks == 670
    assert ids(tmp_path / "one.journal") == [f"t{n}" for n in range(670)]


def _killed_in_the_middle(path: Path, target: Path) -> None:
    with closing(Journal(path)) as journal:
        write_backup(journal.database, path, target, lambda: os.kill(os.getpid(), signal.SIGKILL))


@pytest.mark.slow
def test_kill_in_the_middle_of_a_backup_leaves_nothing_under_its_name(path, tmp_path) -> None:
    with closing(Journal(path)) as journal:
        fill(journal, 0, 600)
    target = tmp_path / "backups" / "one.journal"
    child = multiprocessing.get_context("fork").Process(target=_killed_in_the_middle, args=(path, target))
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGKILL
    assert not target.exists()
    assert [left.name for left in target.parent.iterdir() if PART in left.name]
    assert back_up_closed(path, target).tasks == 600
    assert [left.name for left in target.parent.iterdir()] == [target.name]


def test_backup_that_is_ended_leaves_nothing(journal, path, tmp_path) -> None:
    def on_pages() -> None:
        raise RuntimeError("the coordinator ends")

    with pytest.raises(RuntimeError, match="the coordinator ends"):
        write_backup(journal.database, path, tmp_path / "b" / "one.journal", on_pages)
    assert list((tmp_path / "b").iterdir()) == []


def test_backup_is_not_begun_where_it_would_fill_the_disk(journal, path, tmp_path, monkeypatch) -> None:
    used = shutil.disk_usage(tmp_path)
    size_bytes = sum(path.with_name(path.name + ending).stat().st_size for ending in ("", "-wal"))
    monkeypatch.setattr(backup_module.shutil, "disk_usage", lambda _: used._replace(free=4 * size_bytes - 1))
    with pytest.raises(JournalError, match="no backup is made: the disk has"):
        write_backup(journal.database, path, tmp_path / "b" / "one.journal")
    assert list((tmp_path / "b").iterdir()) == []


def test_backup_that_does_not_pass_the_check_is_reported_and_not_left_there(journal, path, tmp_path) -> None:
    journal.database.execute("UPDATE task SET record = '{}' WHERE id = 't1'")
    with pytest.raises(BadBackup, match="task t1: cannot be read"):
        write_backup(journal.database, path, tmp_path / "b" / "one.journal")
    assert list((tmp_path / "b").iterdir()) == []


def test_backup_never_overwrites(journal, path, tmp_path) -> None:
    (tmp_path / "one.journal").write_text("mine")
    with pytest.raises(JournalError, match="exists already"):
        write_backup(journal.database, path, tmp_path / "one.journal")
    assert (tmp_path / "one.journal").read_text() == "mine"


def test_backup_into_a_folder_of_somebody_else_removes_nothing_there(journal, path, tmp_path) -> None:
    (tmp_path / "browser.part").write_text("half a download")
    (tmp_path / "one.journal.part").write_text("of somebody else")
    write_backup(journal.database, path, tmp_path / "mine.journal")
    assert {"browser.part", "one.journal.part", "mine.journal"} <= {each.name for each in tmp_path.iterdir()}


def test_only_the_newest_backups_stay_and_the_one_just_made_though_the_clock_is_behind(tmp_path) -> None:
    for name in ("2026", "2028", "2027", "1970"):
        (tmp_path / f"{name}.journal").touch()
    assert [path.stem for path in prune_backups(tmp_path, 2, tmp_path / "1970.journal")] == ["2026"]
    assert [path.stem for path in prune_backups(tmp_path, 2)] == ["1970"]
    assert sorted(path.stem for path in tmp_path.iterdir()) == ["2027", "2028"]


# -- restoring ------------------------------------------------------------------------------------------------


def backed_up(path: Path, target: Path, tasks: int = 5) -> Path:
    with closing(Journal(path)) as journal:
        fill(journal, 0, tasks)
        write_backup(journal.database, path, target)
    return target


def test_restored_journal_is_as_it_was_and_what_was_there_is_kept(path, tmp_path) -> None:
    backup = backed_up(path, tmp_path / "one.backup")
    with closing(Journal(path)) as journal:
        before = journal.select(ALL)
        fill(journal, 5, 2)
        journal.change(msgspec.structs.replace(before[0], state=TaskState.DONE))
    done = restore_backup(backup, path)
    assert (done.contents.tasks, done.contents.open) == (5, 5)
    assert "were put aside as" in done.report[0]
    with closing(Journal(path)) as journal:
        assert journal.select(ALL) == before
        assert journal.asked("t0") == b"{}"
    assert len(ids(path.with_name(f"{path.name}.before-1"))) == 7


def test_restored_journal_gives_out_no_epoch_twice(path, tmp_path) -> None:
    backup = backed_up(path, tmp_path / "one.backup")
    with closing(Journal(path)) as journal:
        last = journal.new_epoch(at_least=1_000_000)
    restore_backup(backup, path)
    with closing(Journal(path)) as journal:
        assert journal.new_epoch() > last


def test_restored_journal_has_another_name_since_it_may_lack_changes_that_witnesses_know_of(path, tmp_path) -> None:
    with closing(Journal(path)) as journal:
        name = journal.name
    back_up_closed(path, tmp_path / "one.backup")
    restore_backup(tmp_path / "one.backup", path)
    with closing(Journal(path)) as journal:
        assert journal.name != name


def test_restored_copy_of_another_coordinators_journal_is_one_of_its_own(path, tmp_path) -> None:
    with closing(Journal(path)) as journal:
        journal.begin_copy()
        backup = tmp_path / "one.backup"
        write_backup(journal.database, path, backup)
    restore_backup(backup, path)
    with closing(Journal(path)) as journal:
        assert not journal.copied


def test_restore_over_a_journal_that_a_coordinator_has_open_is_refused(path, tmp_path) -> None:
    backup = backed_up(path, tmp_path / "one.backup")
    with closing(Journal(path)) as journal:
        fill(journal, 5, 1)
        with pytest.raises(JournalLocked):
            restore_backup(backup, path)
        assert len(journal.select(ALL)) == 6


def test_restore_over_a_damaged_journal_puts_it_aside(path, tmp_path) -> None:
    backup = backed_up(path, tmp_path / "one.backup")
    path.write_bytes(b"no database at all" * 500)
    done = restore_backup(backup, path)
    assert "was damaged" in done.report[0]
    assert path.with_name(f"{path.name}.damaged-1").exists()
    assert len(ids(path)) == 5


def test_restore_that_fails_leaves_the_journal_as_it_was(path, tmp_path, monkeypatch) -> None:
    backup = backed_up(path, tmp_path / "one.backup")
    with closing(Journal(path)) as journal:
        fill(journal, 5, 2)

    class Full(sqlite3.Connection):
        def backup(self, *_, **__) -> None:
            raise sqlite3.OperationalError("database or disk is full")

    def in_memory(_: Path) -> sqlite3.Connection:
        connection = sqlite3.connect(backup, isolation_level=None, factory=Full)
        connection.execute("BEGIN")
        return connection

    monkeypatch.setattr(backup_module, "_in_memory", in_memory)
    with pytest.raises(JournalUnwritable, match="disk is full"):
        restore_backup(backup, path)
    assert len(ids(path)) == 7


class _Killing(sqlite3.Connection):
    def backup(self, target: sqlite3.Connection, **_: object) -> None:
        super().backup(target, pages=5, progress=lambda *_: os.kill(os.getpid(), signal.SIGKILL))


def _killed_in_a_restore(backup: Path, path: Path) -> None:
    backup_module._in_memory = lambda _: sqlite3.connect(backup, isolation_level=None, factory=_Killing)
    restore_backup(backup, path)


@pytest.mark.slow
def test_kill_in_the_middle_of_a_restore_leaves_the_journal_as_it_was(path, tmp_path) -> None:
    backup = backed_up(path, tmp_path / "one.backup", tasks=200)
    with closing(Journal(path)) as journal:
        fill(journal, 200, 2)
    child = multiprocessing.get_context("fork").Process(target=_killed_in_a_restore, args=(backup, path))
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGKILL
    assert check_journal(path).problems == []
    assert len(ids(path)) == 202


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:5000]), "damaged"),
        (lambda path: _execute(path, "DELETE FROM epoch"), "lost its epochs"),
        (lambda path: _execute(path, "UPDATE change SET epoch = 5000"), "epoch 5000 was given out"),
        (lambda path: _execute(path, "UPDATE task SET record = '{}' WHERE id = 't1'"), "task t1: cannot be read"),
        (lambda path: _execute(path, "UPDATE task SET state = 'done' WHERE id = 't1'"), "task t1: it is done"),
        (lambda path: _execute(path, "UPDATE task SET id = 't9' WHERE id = 't1'"), "its record is of task t1"),
        (lambda path: _execute(path, "DELETE FROM task WHERE id = 't1'"), "1 changes are of tasks"),
    ],
)
def test_damaged_backup_is_not_restored(path, tmp_path, damage: Callable[[Path], None], said: str) -> None:
    backup = backed_up(path, tmp_path / "one.backup")
    damage(backup)
    assert said in "; ".join(check_journal(backup).problems)
    with pytest.raises(BadBackup, match=said):
        restore_backup(backup, path)
    assert len(ids(path)) == 5


def _execute(path: Path, statements: str) -> None:
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(statements)


# -- checking -------------------------------------------------------------------------------------------------


def test_check_counts_and_leaves_the_file_as_it_is(path, tmp_path) -> None:
    backup = backed_up(path, tmp_path / "one.backup")
    before = backup.read_bytes()
    found = check_journal(backup)
    assert (found.tasks, found.open, found.changes, found.problems) == (5, 5, 5, [])
    assert backup.read_bytes() == before
    assert list(tmp_path.glob("one.backup?*")) == []


def test_check_reads_what_a_killed_coordinator_left_in_the_log(path, tmp_path) -> None:
    with closing(Journal(path)) as journal:
        fill(journal, 0, 5)
        for ending in ("", "-wal"):
            shutil.copyfile(f"{path}{ending}", tmp_path / f"killed{ending}")
    assert check_journal(tmp_path / "killed").tasks == 5


def test_check_of_a_journal_that_a_coordinator_has_open_says_so(journal, path) -> None:
    with pytest.raises(JournalLocked, match="a coordinator has it open"):
        check_journal(path)


@pytest.mark.parametrize("content", [b"", b"hello " * 2000])
def test_check_of_another_file_says_so(tmp_path, content: bytes) -> None:
    (tmp_path / "other").write_bytes(content)
    try:
        assert check_journal(tmp_path / "other").problems
    except JournalError as error:
        assert "no journal of robrain" in str(error)  # noqa: PT017 - either is right


# -- asked for over the wire ----------------------------------------------------------------------------------


def backups(endpoint: Endpoint, journal: Journal) -> Backups:
    core = SimpleNamespace(wire=endpoint, tasks=SimpleNamespace(journal=journal))
    return Backups(core)  # type: ignore[arg-type]


def test_few_backups_are_kept_and_none_is_begun_once_it_is_closed(journal, path, endpoint, monkeypatch) -> None:
    monkeypatch.setattr(robrain.coordinator.parts.backups, "KEPT", 2)
    desk = backups(endpoint, journal)
    told = [endpoint.ask(COORDINATOR_BACKUP) for _ in range(3)]
    assert [one.tasks for one in told] == [50, 50, 50]
    assert sorted(backup_folder(path).iterdir()) == [Path(one.path) for one in told[1:]]
    desk.close()
    with pytest.raises(CallError, match="the coordinator ends"):
        endpoint.ask(COORDINATOR_BACKUP)


def test_second_backup_at_the_same_time_is_refused(journal, endpoint, monkeypatch) -> None:
    has_begun, may_go_on = threading.Event(), threading.Event()

    def stand_still(*_: object) -> None:
        has_begun.set()
        may_go_on.wait(10)
        raise JournalError(None, "the disk has gone")

    monkeypatch.setattr(robrain.coordinator.parts.backups, "write_backup", stand_still)
    desk = backups(endpoint, journal)
    first = endpoint.ask_later(COORDINATOR_BACKUP, None, timeout_s=20.0)
    assert has_begun.wait(10)
    with pytest.raises(CallError, match="another backup is being written") as busy:
        endpoint.ask(COORDINATOR_BACKUP)
    assert busy.value.code is ErrorCode.BUSY
    may_go_on.set()
    with pytest.raises(CallError, match="the disk has gone"):
        until(first.poll, "no answer came")
    desk.close()


def test_journal_in_memory_has_no_backup(endpoint) -> None:
    with closing(Journal()) as journal:
        backups(endpoint, journal)
        with pytest.raises(CallError, match="the journal is in memory"):
            endpoint.ask(COORDINATOR_BACKUP)
