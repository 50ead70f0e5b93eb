"""A damaged journal is named and kept aside; what can be read of it goes on."""

import itertools
import logging
import random
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from robrain.coordinator.journal.errors import JournalError
from robrain.coordinator.journal.journal import Journal
from robrain.protocol.messages.tasks.task_messages import TaskFilter, TaskRecord
from robrain.protocol.messages.team.standing_messages import JournalAlarm, KnownRobot
from robrain.protocol.messages.team.team_messages import RobotSummary
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState

TASKS = 120
PAGE = 4096
R1 = KnownRobot(5, True, RobotSummary(name="r1", up=True, age_s=0.0))
LEAF = 13
"""First byte of a page that holds rows of a table (https://sqlite.org/fileformat.html#b_tree_pages)."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A journal with 120 tasks, every third of them done."""
    path = tmp_path_factory.mktemp("journal") / "team.journal"
    journal = Journal(path)
    for number in range(TASKS):
        task = Task(id=f"t{number}", kind="visit", place=Point2D(1.0, 2.0))
        record = journal.accept(TaskRecord(task=task, state=TaskState.QUEUED), b"{}" * 40)
        if number % 3 == 0:
            epoch = journal.new_epoch()
            for state in (TaskState.OFFERED, TaskState.RUNNING, TaskState.DONE):
                record = journal.change(msgspec.structs.replace(record, state=state, robot="r1", epoch=epoch))
    journal.close()
    assert path.stat().st_size > 12 * PAGE
    return path


@pytest.fixture
def path(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(whole, tmp_path))


def overwrite(path: Path, start: int, data: bytes) -> None:
    with path.open("r+b") as file:
        file.seek(start)
        file.write(data)


def asides(path: Path) -> list[str]:
    return sorted(found.name for found in path.parent.iterdir() if "damaged" in found.name)


def test_a_file_that_is_no_database_is_put_aside_and_named(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rubbish = b"not a journal at all\n" * 1000
    path.write_bytes(rubbish)
    with caplog.at_level(logging.WARNING):
        journal = Journal(path)
    assert journal.open_records() == []
    assert journal.opening_report == [
        f"{path} was damaged (file is not a database) and is now {path}.damaged-1; nothing of it could be read"
    ]
    assert journal.opening_report[0] in caplog.text
    assert path.with_name("team.journal.damaged-1").read_bytes() == rubbish
    journal.close()


class Failing(sqlite3.Connection):
    """A connection on which the check of the whole file fails."""

    error: sqlite3.DatabaseError

    def execute(self, sql: str, *values: object) -> sqlite3.Cursor:
        if "quick_check" in sql:
            raise self.error
        return super().execute(sql, *values)


@pytest.mark.parametrize("kind", [sqlite3.OperationalError, sqlite3.DatabaseError])
@pytest.mark.parametrize("code", [sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL, sqlite3.SQLITE_READONLY])
def test_journal_that_cannot_be_opened_but_is_not_damaged_is_left_as_it_is(
    path: Path, kind: type[sqlite3.DatabaseError], code: int
) -> None:
    """A full disk or missing rights are no damage; what is in the file is still good."""
    Failing.error = kind("no luck")
    Failing.error.sqlite_errorcode = code
    with pytest.raises(JournalError, match="cannot be opened: no luck"):
        Journal(path, factory=Failing)
    assert asides(path) == []
    journal = Journal(path)
    assert journal.opening_report == []
    assert len(journal.open_records()) == TASKS - TASKS // 3
    journal.close()


def test_there_is_nothing_to_salvage_of_a_journal_in_memory() -> None:
    Failing.error = sqlite3.DatabaseError("malformed")
    with pytest.raises(JournalError, match="cannot be opened: malformed"):
        Journal(factory=Failing)


def test_damaged_files_are_counted_and_none_takes_the_place_of_another(path: Path) -> None:
    for number in (1, 2, 3):
        path.write_bytes(b"%d rubbish" % number * 500)
        Journal(path).close()
        assert path.with_name(f"team.journal.damaged-{number}").read_bytes().startswith(b"%d" % number)
    journal = Journal(path)
    assert journal.opening_report == []
    journal.close()


@pytest.mark.parametrize("seed", range(12))
def test_what_can_be_read_of_a_damaged_journal_is_read_and_the_rest_is_told(path: Path, seed: int) -> None:
    """A page in the middle is overwritten; each row that is there afterwards is as it was before."""
    pages = path.stat().st_size // PAGE
    draw = random.Random(seed)
    overwrite(path, draw.randrange(1, pages) * PAGE, draw.randbytes(PAGE))
    journal = Journal(path)
    records = {record.task.id: record for record in journal.select(TaskFilter())}
    for name, record in records.items():
        expected = TaskState.DONE if int(name[1:]) % 3 == 0 else TaskState.QUEUED
        assert record.state is expected
    if asides(path):  # quick_check does not look into indexes
        assert asides(path) == ["team.journal.damaged-1"]
        [text] = journal.opening_report
        assert f"{len(records)} tasks were read from it" in text or "nothing of it could be read" in text
        lost = {f"t{number}" for number in range(TASKS)} - set(records)
        if lost and records:
            assert "lost: " in text
    else:
        assert len(records) == TASKS
    assert journal.new_epoch() > TASKS // 3 or not records
    # And it is a journal like any other.
    task = Task(id="new", kind="visit", place=Point2D(0.0, 0.0))
    journal.accept(TaskRecord(task=task, state=TaskState.QUEUED))
    journal.close()
    again = Journal(path)
    assert again.find("new") is not None
    assert again.opening_report == []
    again.close()


def test_most_of_a_journal_survives_the_loss_of_one_leaf(path: Path) -> None:
    content = path.read_bytes()
    pages = {number: content[number * PAGE : (number + 1) * PAGE] for number in range(1, len(content) // PAGE)}
    leaves = [number for number, page in pages.items() if page[0] == LEAF and b'"kind":"visit"' in page]
    overwrite(path, leaves[len(leaves) // 2] * PAGE, bytes(PAGE))
    journal = Journal(path)
    kept = len(journal.select(TaskFilter()))
    assert TASKS // 2 < kept < TASKS
    assert "lost: " in journal.opening_report[0]
    journal.close()


def test_a_cut_off_file_is_salvaged(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    journal = Journal(path)
    assert asides(path) == ["team.journal.damaged-1"]
    assert path.with_name("team.journal.damaged-1").read_bytes() == content[: len(content) * 2 // 3]
    assert journal.opening_report
    journal.close()


@pytest.mark.parametrize(("table", "tasks"), [("change", TASKS), ("task", 0)])
def test_a_lost_table_is_damage_and_no_epoch_of_the_other_one_is_given_out_again(
    path: Path, table: str, tasks: int
) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute(f"DROP TABLE {table}")
        connection.execute("DROP TABLE epoch")
    connection.close()
    journal = Journal(path)
    assert len(journal.select(TaskFilter())) == tasks
    assert journal.new_epoch() > TASKS // 3
    journal.close()


def damaged_copy(path: Path) -> None:
    """A copy that is not whole, of which another process has a copy, with a robot on its own and an alarm."""
    journal = Journal(path)
    journal.record_robots({"r1": R1})
    journal.record_alarm(JournalAlarm(rule="hot", source="m1", measured_ns=1, fired_ns=2))
    journal.close()
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE copy SET state = 'partial'")
        connection.execute("DELETE FROM epoch")


def test_copies_robots_and_alarms_are_salvaged(path: Path) -> None:
    damaged_copy(path)
    journal = Journal(path)
    assert (journal.copied, journal.robots) == ("partial", {"r1": R1})
    assert [(alarm.rule, alarm.source) for alarm in journal.alarms()] == [("hot", "m1")]
    with pytest.raises(JournalError, match="incomplete copy"):
        journal.own()
    journal.close()


def test_a_journal_that_may_be_a_copy_is_taken_for_one_that_is_not_whole(path: Path) -> None:
    damaged_copy(path)
    with closing(sqlite3.connect(path)) as connection:
        (page,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'copy'").fetchone()
    overwrite(path, (page - 1) * PAGE, b"\xff" * PAGE)
    journal = Journal(path)
    assert journal.copied == "partial"
    journal.close()


def test_lost_epochs_are_damage(path: Path) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute("DELETE FROM epoch")
    connection.close()
    journal = Journal(path)
    assert "lost its epochs" in journal.opening_report[0]
    assert len(journal.select(TaskFilter())) == TASKS
    assert [change.state for change in journal.history("t0")] == [
        TaskState.QUEUED, TaskState.OFFERED, TaskState.RUNNING, TaskState.DONE
    ]  # fmt: skip
    assert [change.state for change in journal.history("t1")] == [TaskState.QUEUED]
    journal.close()


class Killed(BaseException):
    """The process ends here."""


@pytest.mark.parametrize("at", range(12))
def test_a_kill_in_the_middle_of_the_salvage_loses_nothing(
    path: Path, at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files are written, copied and renamed; after a kill before any of these the next start finds the same."""
    overwrite(path, 3 * PAGE, bytes(PAGE))
    with_log = path.with_name("team.journal-wal")
    with_log.write_bytes(b"a log that is left behind")
    untouched = Path(shutil.copytree(path.parent, path.parent.with_name(f"untouched-{at}")))
    expected = Journal(untouched / path.name)
    names = [record.task.id for record in expected.select(TaskFilter())]
    expected.close()

    steps = itertools.count()

    def deadly(function):
        def wrapped(*arguments, **named):
            if next(steps) == at:
                raise Killed
            return function(*arguments, **named)

        return wrapped

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", deadly(Path.rename))
        patch.setattr(Path, "unlink", deadly(Path.unlink))
        patch.setattr(shutil, "copyfile", deadly(shutil.copyfile))
        try:
            Journal(path).close()
        except Killed:
            pass
        else:
            assert next(steps) <= at + 1
    journal = Journal(path)
    assert [record.task.id for record in journal.select(TaskFilter())] == names
    assert any("damaged" in name for name in asides(path))
    journal.close()
