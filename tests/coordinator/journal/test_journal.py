"""The journal on disk: what is in it stays in it, whatever file it finds."""

import sqlite3
from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from robrain.coordinator.journal import journal as journal_module
from robrain.coordinator.journal.errors import JournalError, JournalLocked, JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.journal.schema import MIGRATIONS, VERSION, migrate
from robrain.protocol.messages.tasks.task_messages import TaskFilter, TaskRecord
from robrain.protocol.messages.team.standing_messages import JournalAlarm, JournalEntry
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import Refused, RobotOut, no_path

ASKED = b'{"task":{"id":"t1","kind":"visit"}}'


def queued(task_id: str, **fields) -> TaskRecord:
    task = fields.pop("task", None) or Task(id=task_id, kind="visit", place=Point2D(1.0, 2.0))
    return TaskRecord(task=task, state=TaskState.QUEUED, **fields)


def change(journal: Journal, record: TaskRecord, state: TaskState, **fields) -> TaskRecord:
    return journal.change(msgspec.structs.replace(record, state=state, **fields))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "team.journal"


@pytest.fixture(autouse=True)
def quick_to_find_the_lock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_module, "LOCK_TIMEOUT_S", 0.05)


# -- keeping --------------------------------------------------------------------------------------------------


def test_what_was_written_is_there_when_it_is_opened_again(path: Path) -> None:
    one = Journal(path)
    first = one.accept(queued("t1", by="ann"), ASKED)
    one.accept(queued("t2"), ASKED)
    offered = change(one, first, TaskState.OFFERED, robot="r1", epoch=one.new_epoch(), changed_ns=5, why="nearest")
    one.close()
    other = Journal(path)
    assert [record.task.id for record in other.open_records()] == ["t1", "t2"]
    assert other.find("t1") == offered
    assert other.find("t3") is None
    assert other.asked("t1") == ASKED
    assert [(line.state, line.robot, line.epoch, line.why) for line in other.history("t1")] == [
        (TaskState.QUEUED, "", 0, ""),
        (TaskState.OFFERED, "r1", 1, "nearest"),
    ]
    assert other.when_offered("t1", "r1", 1)
    assert not other.when_offered("t1", "r2", 1)
    assert not other.when_offered("t1", "r1", 2)
    other.close()


def test_tasks_are_found_by_what_they_are(path: Path) -> None:
    journal = Journal(path)
    journal.accept(queued("t1", by="ann"))
    change(journal, journal.accept(queued("t2", by="bob")), TaskState.DONE, robot="r1")
    journal.accept(queued("e1", own=True, task=Task(id="e1", kind="explore", place=Point2D(0.0, 0.0))))

    def found(**wanted) -> list[str]:
        return [record.task.id for record in journal.select(TaskFilter(**wanted))]

    assert found() == ["t1", "t2"]
    assert found(own=True) == ["t1", "t2", "e1"]
    assert found(states=[TaskState.DONE, TaskState.FAILED]) == ["t2"]
    assert found(kinds=["explore"], own=True) == ["e1"]
    assert found(robot="r1") == ["t2"]
    assert found(by="ann") == ["t1"]
    assert found(limit=1) == ["t2"]
    assert found(limit=-1) == []
    assert journal.count(TaskState.DONE) == 1
    journal.close()


def test_a_task_is_accepted_once_and_ends_once(path: Path) -> None:
    journal = Journal(path)
    record = journal.accept(queued("t1"))
    with pytest.raises(sqlite3.IntegrityError):
        journal.accept(queued("t1", by="bob"))
    change(journal, record, TaskState.DONE)
    for state in (TaskState.DONE, TaskState.FAILED, TaskState.CANCELLED):
        with pytest.raises(sqlite3.IntegrityError):
            change(journal, record, state)
    assert journal.find("t1").state is TaskState.DONE
    assert len(journal.history("t1")) == 2
    journal.close()


def test_old_tasks_go_when_there_are_too_many_and_open_ones_stay(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_module, "KEPT_OWN", 3)
    monkeypatch.setattr(journal_module, "KEPT_ASKED", 5)
    monkeypatch.setattr(journal_module, "PRUNE_EVERY", 10)
    journal = Journal(path)
    journal.accept(queued("open"))
    for number in range(10):
        change(journal, journal.accept(queued(f"t{number}")), TaskState.DONE)
        change(journal, journal.accept(queued(f"o{number}", own=True)), TaskState.CANCELLED)
    kept = [record.task.id for record in journal.select(TaskFilter(own=True))]
    assert kept == ["open", "t5", "t6", "t7", "o7", "t8", "o8", "t9", "o9"]
    assert journal.history("t0") == []
    journal.close()


# -- whose file it is -----------------------------------------------------------------------------------------


def test_a_journal_that_another_coordinator_writes_is_refused(path: Path) -> None:
    one = Journal(path)
    one.accept(queued("t1"))
    with pytest.raises(JournalLocked, match=r"team\.journal: is locked: another coordinator writes it"):
        Journal(path)
    one.accept(queued("t2"))
    one.close()
    other = Journal(path)
    assert len(other.open_records()) == 2
    other.close()


def test_a_database_of_something_else_is_left_as_it_is(path: Path) -> None:
    path.parent.mkdir()
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE photos (name)")
    connection.close()
    before = path.read_bytes()
    with pytest.raises(JournalError, match="not a journal of robrain"):
        Journal(path)
    assert path.read_bytes()[100:] == before[100:]
    assert list(path.parent.glob("*damaged*")) == []


def test_a_journal_of_a_newer_robrain_is_left_as_it_is(path: Path) -> None:
    journal = Journal(path)
    journal.accept(queued("t1"))
    journal._db.execute(f"PRAGMA user_version = {VERSION + 1}")
    journal.close()
    with pytest.raises(JournalError, match=rf"newer robrain \(schema {VERSION + 1}, this one knows {VERSION}\)"):
        Journal(path)
    assert list(path.parent.glob("*damaged*")) == []


def test_a_path_that_cannot_be_a_journal_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for wrong in (tmp_path, tmp_path / "file" / "team.journal"):
        with pytest.raises(JournalError, match=str(wrong)):
            Journal(wrong)


# -- older ones -----------------------------------------------------------------------------------------------

SCHEMA_1 = """
PRAGMA application_id = 1919902322;
PRAGMA user_version = 1;
CREATE TABLE task (number INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, state TEXT NOT NULL,
    robot TEXT NOT NULL, record TEXT NOT NULL);
CREATE TABLE change (number INTEGER PRIMARY KEY AUTOINCREMENT, task TEXT NOT NULL, stamp_ns INTEGER NOT NULL,
    state TEXT NOT NULL, robot TEXT NOT NULL, epoch INTEGER NOT NULL, why TEXT NOT NULL);
CREATE INDEX change_of_task ON change (task);
CREATE UNIQUE INDEX one_end_of_task ON change (task) WHERE state IN ('done', 'failed', 'cancelled');
CREATE TABLE epoch (only_row INTEGER PRIMARY KEY CHECK (only_row = 1), ceiling INTEGER NOT NULL);
INSERT INTO epoch VALUES (1, 42);
INSERT INTO task VALUES (1, 't1', 'done', 'r1',
    '{"task":{"type":"visit","id":"t1","place":{"x_m":1.0,"y_m":2.0}},"state":"done","robot":"r1","epoch":7}');
INSERT INTO task VALUES (2, 'e1', 'running', 'r1',
    '{"task":{"type":"explore","id":"e1","goal":{"x_m":1.0,"y_m":2.0}},"state":"running","robot":"r1","own":true}');
INSERT INTO change VALUES (1, 't1', 5, 'queued', '', 0, ''), (2, 't1', 6, 'done', 'r1', 7, 'there');
"""
"""A journal as the first schema had it, word by word: it must not follow the code."""


def test_a_journal_of_the_first_schema_goes_on(path: Path) -> None:
    path.parent.mkdir()
    connection = sqlite3.connect(path)
    connection.executescript(SCHEMA_1)
    connection.close()
    journal = Journal(path)
    assert journal.find("t1").state is TaskState.DONE
    assert [record.task.id for record in journal.open_records()] == ["e1"]
    assert [record.task.id for record in journal.select(TaskFilter(kinds=["visit"]))] == ["t1"]
    assert [record.task.id for record in journal.select(TaskFilter())] == ["t1"]  # the other is an own one
    assert msgspec.json.decode(journal.asked("t1"))["task"]["id"] == "t1"
    assert [(line.why, line.reason) for line in journal.history("t1")] == [("", None), ("there", None)]
    assert (journal.find("t1").why, journal.find("t1").reason) == ("", None)
    assert journal.new_epoch() == 43
    assert journal.accept(queued("t2")).change == 3
    assert journal.opening_report == []
    journal.close()


def test_a_migration_that_fails_leaves_the_journal_as_it_was(path: Path) -> None:
    path.parent.mkdir()
    connection = sqlite3.connect(path, isolation_level=None)
    connection.executescript(SCHEMA_1)
    broken = (*MIGRATIONS[:1], "ALTER TABLE task ADD COLUMN extra; INSERT INTO nowhere VALUES (1)")
    with pytest.raises(sqlite3.OperationalError):
        migrate(connection, path, broken)
    assert connection.execute("PRAGMA user_version").fetchone() == (1,)
    assert "extra" not in connection.execute("SELECT sql FROM sqlite_master WHERE name = 'task'").fetchone()[0]
    assert migrate(connection, path) == 1
    connection.close()


# -- a full disk ----------------------------------------------------------------------------------------------


def fill_up(journal: Journal) -> int:
    """No more pages than there are; returns how many tasks still found room."""
    (pages,) = journal._db.execute("PRAGMA page_count").fetchone()
    journal._db.execute(f"PRAGMA max_page_count = {pages}")
    for number in range(1000):
        try:
            journal.accept(queued(f"filler{number}"), b"x" * 500)
        except JournalUnwritable:
            return number
    raise AssertionError("it never got full")


def test_on_a_full_disk_nothing_is_half_written_and_what_is_there_stays(path: Path) -> None:
    journal = Journal(path)
    record = journal.accept(queued("t1"), ASKED)
    assert journal.failing == ""
    room = fill_up(journal)
    with pytest.raises(JournalUnwritable, match=r"team\.journal: cannot be written: database or disk is full"):
        journal.accept(queued("big", by="x" * 5000))
    assert "disk is full" in journal.failing
    assert journal.find("big") is None
    assert len(journal.open_records()) == 1 + room
    journal._db.execute("PRAGMA max_page_count = 100000")
    assert journal.accept(queued("later")).change > record.change
    assert journal.failing == ""
    change(journal, record, TaskState.DONE)
    journal.close()
    again = Journal(path)
    assert again.find("t1").state is TaskState.DONE
    assert again.opening_report == []
    again.close()


def test_a_reason_is_kept_and_of_one_that_only_a_newer_robrain_knows_the_words_are_read(path: Path) -> None:
    journal, reason = Journal(path), RobotOut("r1", Refused(no_path()))
    change(journal, journal.accept(queued("t1")), TaskState.QUEUED, why="r1 waits", reason=reason)
    journal.close()
    for kept, statement in (
        (reason, "UPDATE task SET record = replace(record, 'robot_out', 'robot_naps')"),
        (None, "UPDATE change SET reason = replace(reason, 'robot_out', 'robot_naps')"),
    ):
        journal = Journal(path)
        (record,) = journal.open_records()
        assert (record.task.id, record.why, record.reason) == ("t1", "r1 waits", kept)
        assert [(line.why, line.reason) for line in journal.history("t1")] == [("", None), ("r1 waits", reason)]
        assert journal.wrong == {}
        journal.close()
        with closing(sqlite3.connect(path)) as connection, connection:
            connection.execute(statement)
    journal = Journal(path)
    assert [(line.why, line.reason) for line in journal.history("t1")] == [("", None), ("r1 waits", None)]
    journal.close()


def test_an_alarm_is_kept_with_its_task_or_not_at_all(path: Path) -> None:
    alarm = JournalAlarm(rule="heat", source="m1", measured_ns=10, fired_ns=20)
    journal = Journal(path)
    journal.accept(queued("t1"), alarm=alarm)
    with pytest.raises(sqlite3.IntegrityError):
        journal.accept(queued("t1"), alarm=msgspec.structs.replace(alarm, source="m2"))
    journal.close()
    again = Journal(path)
    assert (again.alarms(), [record.task.id for record in again.open_records()]) == ([alarm], ["t1"])
    armed = msgspec.structs.replace(alarm, is_armed=True)
    again.record_alarm(armed)
    assert again.alarms() == [armed]  # a source has one alarm, the last
    again.keep_alarms([])
    assert again.alarms() == []
    again.close()


def test_a_copy_takes_over_each_change_of_a_task_and_an_earlier_one_that_is_sent_again_undoes_nothing() -> None:
    journal, copy, page, entries = Journal(), Journal(), Journal(), []
    journal.on_written = entries.append
    change(journal, journal.accept(queued("t1")), TaskState.CANCELLED)
    for sent in (entries, entries[:1]):
        copy.follow(sent)
        assert copy.find("t1") == journal.find("t1")
    page.put_page(journal.page(0, limit=1, term=1, seq=0))
    assert page.history("t1") == copy.history("t1") == journal.history("t1")


def test_a_copy_that_becomes_an_ordinary_journal_gives_out_no_epoch_again_that_it_gave_out_before(path: Path) -> None:
    copy = Journal(path)
    epoch = copy.new_epoch(5000)
    copy.begin_copy()
    copy.put_page(Journal().page(0, limit=1, term=1, seq=0))
    copy.follow([JournalEntry(seq=1, epoch_ceiling=3)])
    copy.own()
    copy.close()
    again = Journal(path)
    assert again.copied == ""
    assert again.new_epoch() > epoch
    again.close()
