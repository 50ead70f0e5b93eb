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

from robrain.coordinator.journal.errors import BadBackup, JournalError, JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.journal.journal_check import JournalContents, check_journal
from robrain.coordinator.journal.replica import put_aside
from robrain.coordinator.journal.schema import migrate

PAGES_AT_A_TIME, PAUSE_S = 64, 0.005
"""The coordinator's loop waits for at most this number of pages, and a backup this long for a transaction of the
loop."""
ROOM = 3
"""A backup leaves this many times its size free on the disk, or it is not begun: the journal needs that space."""
PART = ".part"
FOLDER_ENDING, ENDING = ".backups", ".journal"


class Restored(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a restore."""

    path: Path
    """The journal."""
    contents: JournalContents
    """Its contents now."""
    told: list[str]
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
        told = list(opened.told)
        database = opened.database
        if database.execute("SELECT 1 FROM task LIMIT 1").fetchone() is not None:
            try:
                told.append(put_aside(database, journal))
            except sqlite3.OperationalError as error:
                raise JournalUnwritable(journal, f"cannot be put aside: {error}") from error
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
    return Restored(path=journal, contents=check_journal(journal), told=told)


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
    except sqlite3.Error as error:
        memory.close()
        raise BadBackup(backup, str(error)) from error
    except BaseException:
        memory.close()
        raise
    return memory


def _check_room(journal: Path, folder: Path) -> None:
    beside = (journal.with_name(journal.name + ending) for ending in ("", "-wal"))
    size_bytes = sum(path.stat().st_size for path in beside if path.exists())
    free_bytes = shutil.disk_usage(folder).free
    if free_bytes < (1 + ROOM) * size_bytes:
        text = (
            f"no backup is made: the disk has {free_bytes / 1e6:.0f} MB free, and the journal is {size_bytes / 1e6:.0f}"
        )
        raise JournalError(folder, f"{text} MB large; make room, or remove old backups")


def _put_on_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
