"""Checks a journal or a backup of one: whether SQLite finds it whole, and whether its rows agree with each other."""

import sqlite3
from contextlib import closing
from pathlib import Path

import msgspec

from robrain.coordinator.journal.errors import JournalError, JournalLocked
from robrain.coordinator.journal.journal_copy import journal_copy
from robrain.coordinator.journal.mending import read_record
from robrain.coordinator.journal.schema import APPLICATION_ID, ENDED, VERSION, migrate

PROBLEMS_MAX = 20
LOCKED = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)


class JournalContents(msgspec.Struct, frozen=True, kw_only=True):
    """Contents and problems of a journal."""

    path: Path
    bytes: int
    schema: int = 0
    """Number of its schema; older ones are brought to today's when a coordinator opens them."""
    tasks: int = 0
    open: int = 0
    """Tasks that have not ended."""
    changes: int = 0
    epoch_ceiling: int = 0
    """No greater epoch was given out."""
    last_changed_ns: int = 0
    """Stamp of the last change; 0 without any."""
    problems: list[str] = []
    """The first of them, in words; none if it can be used as it is."""


def check_journal(path: Path) -> JournalContents:
    """Check a journal that no coordinator has open, or a backup. A copy is read: the file stays as it is.

    Raises:
        JournalLocked: a coordinator has it open.
        JournalError: it is not there, cannot be read, is none of ours, was written by a newer robrain, or there is no
            room for the copy.

    """
    if not path.is_file():
        raise JournalError(path, "is not there")
    size_bytes = path.stat().st_size
    problems: list[str] = []
    _refuse_locked(path)
    with journal_copy(path) as copy, closing(sqlite3.connect(copy, isolation_level=None)) as database:
        try:
            return _contents(database, path, size_bytes, problems)
        except sqlite3.DatabaseError as error:
            problems.append(f"it is damaged: {error}")
    return JournalContents(path=path, bytes=size_bytes, problems=problems)


def _refuse_locked(path: Path) -> None:
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=0.0)) as database:
            database.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode & 0xFF in LOCKED:
            text = "a coordinator has it open; check a backup of it: robrain journal backup"
            raise JournalLocked(path, text) from error


def _contents(database: sqlite3.Connection, path: Path, size_bytes: int, problems: list[str]) -> JournalContents:
    verdicts = [str(row[0]) for row in database.execute(f"PRAGMA integrity_check({PROBLEMS_MAX})")]
    problems += [f"it is damaged: {verdict}" for verdict in verdicts if verdict != "ok"]
    if database.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
        raise JournalError(path, "is no journal of robrain")
    schema = migrate(database, path)
    epochs = database.execute("SELECT ceiling FROM epoch").fetchone()
    if epochs is None:
        problems.append("it has lost its epochs")
    ceiling = 0 if epochs is None else int(epochs[0])
    tasks = still_open = 0
    for task_id, state, text in database.execute("SELECT id, state, record FROM task ORDER BY number"):
        tasks += 1
        wrong = _wrong_with(task_id, state, str(text))
        if wrong and len(problems) < PROBLEMS_MAX:
            problems.append(f"task {task_id}: {wrong}")
    (still_open,) = database.execute(f"SELECT count(*) FROM task WHERE state NOT IN {ENDED}").fetchone()
    changes, last_ns, epoch = database.execute("SELECT count(*), max(stamp_ns), max(epoch) FROM change").fetchone()
    if changes and epoch > ceiling:
        problems.append(f"epoch {epoch} was given out, and it says that none above {ceiling} was")
    (strays,) = database.execute("SELECT count(*) FROM change WHERE task NOT IN (SELECT id FROM task)").fetchone()
    if strays:
        problems.append(f"{strays} changes are of tasks that it does not have")
    return JournalContents(
        path=path,
        bytes=size_bytes,
        schema=schema or VERSION,
        tasks=tasks,
        open=still_open,
        changes=changes,
        epoch_ceiling=ceiling,
        last_changed_ns=last_ns or 0,
        problems=problems,
    )


def _wrong_with(task_id: str, state: str, text: str) -> str:
    try:
        record, wrong = read_record(text)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        return f"cannot be read: {error}"
    if record.task.id != task_id:
        return f"its record is of task {record.task.id}"
    if record.state != state:
        return f"it is {state}, and {record.state} by its record"
    return wrong
