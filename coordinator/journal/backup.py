"""Backups of a journal: written while a coordinator has it open, checked, and restored.

SQLite's own backup copies the journal a few pages at a time (https://sqlite.org/backup.html). Changes that the
coordinator writes meanwhile are copied too. A backup gets its name once it is whole, checked and on the disk. If the
process ends earlier, a file `….part` remains, which the next backup removes.
"""

import os
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import msgspec

from robrain.coordinator.journal.errors import BadBackup, JournalError, JournalLocked, JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.journal.mending import read_record
from robrain.coordinator.journal.salvage import journal_copy, put_aside
from robrain.coordinator.journal.schema import APPLICATION_ID, ENDED, VERSION, is_locked, migrate

PAGES_AT_A_TIME, PAUSE_S = 64, 0.005
"""The coordinator's loop waits for at most this number of pages, and a backup this long for a transaction of the
loop."""
ROOM = 3
"""A backup leaves this many times its size free on the disk, or it is not begun: the journal needs that space."""
PROBLEMS_MAX = 20
"""Problems of a journal that a check lists."""
PART = ".part"
FOLDER_ENDING, ENDING = ".backups", ".journal"


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
        if is_locked(error):
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
    tasks = 0
    for task_id, state, text in database.execute("SELECT id, state, record FROM task ORDER BY number"):
        tasks += 1
        problem = _problem_of(task_id, state, str(text))
        if problem and len(problems) < PROBLEMS_MAX:
            problems.append(f"task {task_id}: {problem}")
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


def _problem_of(task_id: str, state: str, text: str) -> str:
    try:
        record, problem = read_record(text)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        return f"cannot be read: {error}"
    if record.task.id != task_id:
        return f"its record is of task {record.task.id}"
    if record.state != state:
        return f"it is {state}, and {record.state} by its record"
    return problem


class Restored(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a restore."""

    path: Path
    """The journal."""
    contents: JournalContents
    """Its contents now."""
    report: list[str]
    """Place of its previous contents, as text."""


def backup_folder(journal: Path) -> Path:
    """Where a coordinator puts the backups of its journal.

    >>> backup_folder(Path("site/default.journal")).as_posix()
    'site/default.journal.backups'
    """
    return journal.with_name(f"{journal.name}{FOLDER_ENDING}")


def write_backup(
    database: sqlite3.Connection, journal: Path, target: Path, on_pages: Callable[[], None] = lambda: None
) -> JournalContents:
    """Copy an open journal to a separate file; on a separate thread if the coordinator's loop is to continue.

    Args:
        database: the journal's connection.
        journal: its file, for its size and for error texts.
        target: the file, which must not exist; its folder is made.
        on_pages: called after each few pages; an error that it raises ends the backup.

    Returns:
        Its contents.

    Raises:
        JournalError: it cannot be written, or there would be too little room left; there is no such file then.
        BadBackup: the written file does not pass the check; there is no such file then.

    """
    part = target.with_name(target.name + PART)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists():
            raise JournalError(target, "exists already; give another name")
        _check_room(journal, target.parent)
        if target.parent.name.endswith(FOLDER_ENDING):  # of a coordinator that was killed; elsewhere they are others'
            for old in target.parent.glob(f"*{ENDING}{PART}*"):
                old.unlink(missing_ok=True)
        with closing(sqlite3.connect(part, isolation_level=None)) as copy:
            database.backup(copy, pages=PAGES_AT_A_TIME, progress=lambda *_: on_pages(), sleep=PAUSE_S)
            copy.execute("PRAGMA journal_mode = DELETE")  # one file, without a log beside it
        contents = check_journal(part)
        if contents.problems:
            raise BadBackup(target, "; ".join(contents.problems))
        _put_on_disk(part)
        part.rename(target)
        _put_on_disk(target.parent)
    except (OSError, sqlite3.Error) as error:
        raise JournalError(target, f"the backup cannot be written: {error}") from error
    finally:
        part.unlink(missing_ok=True)
    return contents


def back_up_closed(journal: Path, target: Path) -> JournalContents:
    """Back up a journal that no coordinator has open.

    Raises:
        JournalLocked: a coordinator has it open: ask that one.
        JournalError: it cannot be read, or the backup cannot be written.

    """
    if not journal.is_file():
        raise JournalError(journal, "is not there")
    with closing(Journal(journal, lock_timeout_s=0.0)) as opened:
        return write_backup(opened.database, journal, target)


def restore_backup(backup: Path, journal: Path) -> Restored:
    """Restore a journal from a backup.

    The journal is locked meanwhile, and changed in one transaction: an end of the process at any instant leaves the one
    or the other. Its previous contents are kept beside it as `FILE.before-N`, or as `FILE.damaged-N`. Epochs never go
    back: those of the old journal count on.

    Raises:
        JournalLocked: a coordinator has the journal open; nothing was changed.
        BadBackup: the backup does not pass the check; nothing was changed.
        JournalUnwritable: the disk is full; the journal is as it was.
        JournalError: one of the two cannot be used.

    """
    found = check_journal(backup)
    if found.problems:
        raise BadBackup(backup, "; ".join(found.problems))
    with closing(Journal(journal, lock_timeout_s=0.0)) as opened, closing(_in_memory(backup)) as source:
        report = list(opened.opening_report)
        database = opened.database
        if database.execute("SELECT 1 FROM task LIMIT 1").fetchone() is not None:
            report.append(put_aside(database, journal))
        (ceiling,) = database.execute("SELECT ceiling FROM epoch").fetchone()
        source.execute("UPDATE epoch SET ceiling = max(ceiling, ?)", (ceiling,))
        source.execute("UPDATE copy SET state = ''")
        source.execute("UPDATE standing SET name = ''")  # it may lack what the journal of that name has
        try:
            database.execute("PRAGMA synchronous = FULL")
            source.backup(database)
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        except sqlite3.OperationalError as error:
            raise JournalUnwritable(journal, f"cannot be written: {error}") from error
    return Restored(path=journal, contents=check_journal(journal), report=report)


def prune_backups(folder: Path, kept: int, but: Path | None = None) -> list[Path]:
    """Remove all but the newest backups of a folder, by their names, and never `but`; returns which."""
    old = [path for path in sorted(folder.glob(f"*{ENDING}"))[:-kept] if path != but]
    for path in old:
        path.unlink(missing_ok=True)
    return old


def _in_memory(backup: Path) -> sqlite3.Connection:
    """Contents of a backup, in the tables of today; the file stays as it is."""
    memory = sqlite3.connect(":memory:", isolation_level=None)
    try:
        with closing(sqlite3.connect(f"{backup.absolute().as_uri()}?mode=ro", uri=True)) as file:
            file.backup(memory)
        migrate(memory, backup)
    except BaseException as error:
        memory.close()
        if isinstance(error, sqlite3.Error):
            raise BadBackup(backup, str(error)) from error
        raise
    return memory


def _check_room(journal: Path, folder: Path) -> None:
    beside = (journal.with_name(journal.name + ending) for ending in ("", "-wal"))
    size_bytes = sum(path.stat().st_size for path in beside if path.exists())
    free_bytes = shutil.disk_usage(folder).free
    if free_bytes < (1 + ROOM) * size_bytes:
        text = f"no backup is made: the disk has {free_bytes / 1e6:.0f} MB free, and the journal has"
        text = f"{text} {size_bytes / 1e6:.0f} MB; free some space or remove old backups"
        raise JournalError(folder, text)


def _put_on_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
