"""A damaged journal: it is set aside under another name, and its readable parts are read, row by row."""

import logging
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import msgspec

from robrain.coordinator.journal.errors import JournalError, JournalUnwritable
from robrain.coordinator.journal.schema import CHANGE_COLUMNS, PUT_ALARM, PUT_CHANGE, migrate
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.tasks.old_form import upgraded_json

logger = logging.getLogger(__name__)

COMPANIONS = ("", "-wal", "-shm")
MISSES_MAX = 5000
"""After this number of row numbers in a row without a readable row, there are no more (chosen). Only where the highest
number itself cannot be read."""
COPIED = ("", "-wal")
LEFT_BYTES = 64_000_000
"""A copy leaves this much room to others; where it would not, another disk is tried (chosen)."""
TASK_COLUMNS = "id, state, robot, record, kind, own, asked"


@contextmanager
def journal_copy(path: Path) -> Iterator[Path]:
    """The copy's path; the copy is removed at the end.

    Raises:
        JournalError: the journal cannot be read, or there is no room for a copy of it.

    """
    files = {ending: path.with_name(path.name + ending) for ending in COPIED}
    needed_bytes = sum(file.stat().st_size for file in files.values() if file.exists())
    with tempfile.TemporaryDirectory(prefix="robrain-journal-", dir=_folder_for(path, needed_bytes)) as folder:
        copy = Path(folder) / "journal"
        try:
            for ending, file in files.items():
                if file.exists():
                    shutil.copyfile(file, copy.with_name(copy.name + ending))
        except OSError as error:
            raise JournalError(path, f"cannot be read: {error}") from error
        yield copy


def _folder_for(path: Path, needed_bytes: int) -> Path:
    """Where there is room: the folder for temporary files, which may be memory, or that of the journal."""
    folders = (Path(tempfile.gettempdir()), path.absolute().parent)
    for folder in folders:
        if shutil.disk_usage(folder).free >= needed_bytes + LEFT_BYTES:
            return folder
    text = f"a copy to read needs {needed_bytes / 1e6:.0f} MB, and there is no space for it in "
    raise JournalError(path, text + f"{' or '.join(map(str, folders))}; free some space or set TMPDIR")


class Salvaged(NamedTuple):
    """Rows that were read from a damaged journal, by their numbers."""

    tasks: dict[int, Sequence[object]]
    """TASK_COLUMNS."""
    changes: dict[int, Sequence[object]]
    """CHANGE_COLUMNS."""
    epoch_ceiling: int
    lost: tuple[str, ...]
    """Ids of tasks that are known by their changes only."""
    open: int
    copy: str = ""
    """Whether it is a copy of another coordinator's journal, as in the table; `partial` if that cannot be read."""
    robots: str = "{}"
    """The robots of the team, as JSON."""
    alarms: Sequence[Sequence[object]] = ()

    def summary(self) -> str:
        """In words."""
        if not self.tasks and not self.changes:
            return "nothing of it could be read"
        text = f"{len(self.tasks)} tasks were read from it, {self.open} of them open"
        if self.lost:
            names = ", ".join(self.lost[:20]) + (" …" if len(self.lost) > 20 else "")
            text += f"; lost: {names}"
        return text


class Malformed(sqlite3.DatabaseError):
    """A check of a journal's own has found that the file is damaged."""


def is_damage(error: sqlite3.DatabaseError) -> bool:
    """Whether an error speaks of a broken file, and not of a full disk, a lock or missing rights."""
    if isinstance(error, Malformed):
        return True
    code = getattr(error, "sqlite_errorcode", None)
    # SQLITE_ERROR: a table or column that should be there is not.
    return code is not None and code & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)


def new_path(path: Path) -> Path:
    """Where the journal that is to take a damaged one's place is written first."""
    return path.with_name(f"{path.name}.salvaged")


def move_aside(path: Path) -> Path:
    """Rename a journal with all that belongs to it to `….damaged-<n>`, the first number that is free."""
    aside = path.with_name(f"{path.name}.damaged-{_last_aside(path) + 1}")
    path.rename(aside)
    _move_companions(path, aside)
    return aside


def replace_journal(path: Path) -> None:
    """There is no journal at `path`: write the salvaged rows there, if there are any.

    Comes after `move_aside`, and after an end of the process at any instant between the two.
    """
    last = _last_aside(path)
    # A write-ahead log that was left behind would be played into any file beside it.
    _move_companions(path, path.with_name(f"{path.name}.damaged-{max(last, 1)}"))
    salvaged = new_path(path)
    if last and salvaged.exists():
        salvaged.rename(path)


def _last_aside(path: Path) -> int:
    number = 0
    while path.with_name(f"{path.name}.damaged-{number + 1}").exists():
        number += 1
    return number


def _move_companions(path: Path, aside: Path) -> None:
    for ending in COMPANIONS[1:]:
        companion = path.with_name(path.name + ending)
        if companion.exists():
            companion.rename(aside.with_name(aside.name + ending))


def read_readable_rows(path: Path) -> Salvaged:
    """Rows of a damaged journal. It is not written to: a copy is read (JournalError if there is no room for one)."""
    with journal_copy(path) as copy, closing(sqlite3.connect(copy, isolation_level=None)) as connection:
        try:
            migrate(connection, path)
        except sqlite3.DatabaseError as error:
            logger.warning("%s: not upgraded to the present schema: %s", path, error)
        return _read(connection)


def _read(connection: sqlite3.Connection) -> Salvaged:
    tasks: dict[int, Sequence[object]] = {}
    seen: set[str] = set()
    still_open, highest = 0, 0
    for number, row in _rows(connection, "task", TASK_COLUMNS):
        try:
            record = msgspec.json.decode(upgraded_json(str(row[3]).encode()), type=TaskRecord)
        except (msgspec.DecodeError, UnicodeDecodeError):
            continue
        if record.task.id != row[0] or record.task.id in seen:
            continue
        seen.add(record.task.id)
        # The record is the truth; the other columns are there to be searched.
        tasks[number] = (row[0], record.state, record.robot, *row[3:])
        still_open += not record.state.ended
        highest = max(highest, record.epoch)
    changes: dict[int, Sequence[object]] = {}
    lost: dict[str, None] = {}
    for number, row in _rows(connection, "change", CHANGE_COLUMNS):
        highest = max(highest, int(str(row[4])))
        if row[0] in seen:
            changes[number] = row
        else:
            lost[str(row[0])] = None
    try:
        (ceiling,) = connection.execute("SELECT ceiling FROM epoch").fetchone()
    except (sqlite3.DatabaseError, TypeError):
        ceiling = 0
    copy = _one(connection, "SELECT state FROM copy")
    if copy is None and tasks:
        is_there = _one(connection, "SELECT count(*) FROM sqlite_master WHERE name = 'copy'")
        copy = ("partial",) if is_there is None or is_there[0] else None
    robots = _one(connection, "SELECT robots FROM standing")
    return Salvaged(
        tasks,
        changes,
        max(int(ceiling), highest),
        tuple(lost),
        still_open,
        "" if copy is None else str(copy[0]),
        "{}" if robots is None else str(robots[0]),
        list(_readable(connection, "SELECT * FROM alarm")),
    )


def _one(connection: sqlite3.Connection, query: str) -> Sequence[object] | None:
    return next(_readable(connection, query), None)


def _readable(connection: sqlite3.Connection, query: str) -> Iterator[Sequence[object]]:
    """The rows before the first that cannot be read."""
    with suppress(sqlite3.DatabaseError):
        yield from connection.execute(query)


def _rows(connection: sqlite3.Connection, table: str, columns: str) -> Iterator[tuple[int, Sequence[object]]]:
    """Each row that can be read: asked for one by one, because one that is broken ends a whole query."""
    number, misses = 0, 0
    try:
        found = connection.execute("SELECT seq FROM sqlite_sequence WHERE name = ?", (table,)).fetchone()
    except sqlite3.DatabaseError:
        found = None
    last = int(found[0]) if found is not None else None
    while misses < MISSES_MAX if last is None else number < last:
        number += 1
        try:
            row = connection.execute(f"SELECT {columns} FROM {table} WHERE number = ?", (number,)).fetchone()
        except sqlite3.DatabaseError as error:
            if error.sqlite_errorcode == sqlite3.SQLITE_NOTADB:
                return
            row = None
        misses = 0 if row is not None else misses + 1
        if row is not None:
            yield number, row


def write_new_journal(salvaged: Salvaged, path: Path) -> None:
    """A new journal with the salvaged rows, whole and closed, so that it may replace the old one."""
    path.unlink(missing_ok=True)
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("PRAGMA synchronous = FULL")
        migrate(connection, path)
        connection.execute("BEGIN IMMEDIATE")
        connection.execute("UPDATE epoch SET ceiling = ?", (salvaged.epoch_ceiling,))
        connection.execute("UPDATE copy SET state = ?", (salvaged.copy,))
        connection.execute("UPDATE standing SET robots = ?", (salvaged.robots,))
        connection.executemany(PUT_ALARM, salvaged.alarms)
        connection.executemany(
            f"INSERT INTO task (number, {TASK_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            ((number, *task) for number, task in salvaged.tasks.items()),
        )
        # Of two ends of one task, which only damage can make, the first is kept.
        connection.executemany(PUT_CHANGE, ((number, *change) for number, change in salvaged.changes.items()))
        connection.execute("COMMIT")


def put_aside(database: sqlite3.Connection, path: Path) -> str:
    """Write the contents of a journal to `FILE.before-N` beside it, and report it (JournalUnwritable)."""
    number = 1
    while (aside := path.with_name(f"{path.name}.before-{number}")).exists():
        number += 1
    try:
        database.execute("VACUUM INTO ?", (str(aside),))
        with closing(sqlite3.connect(aside)) as copy, copy:
            copy.execute("UPDATE standing SET name = ''")
    except sqlite3.OperationalError as error:
        raise JournalUnwritable(path, f"cannot be put aside: {error}") from error
    return f"{path}: its tasks were put aside as {aside}"
