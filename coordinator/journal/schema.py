"""The tables of a journal, and how older ones become those of today.

`PRAGMA user_version` is the schema's number. A new file goes through all migrations, so that today's tables are made in
one manner only. Each migration is one transaction, so all or nothing.
"""

import logging
import sqlite3
from pathlib import Path
from typing import Any

import msgspec

from robrain.coordinator.journal.errors import JournalError
from robrain.protocol.messages.tasks.task_messages import TaskChange, TaskRecord
from robrain.protocol.model.tasks.old_form import upgraded_json

logger = logging.getLogger(__name__)

APPLICATION_ID = 0x726F6272
"""`robr` in ASCII: by this a file is known to be a journal (https://sqlite.org/fileformat.html#application_id)."""

CHANGE_COLUMNS = "task, stamp_ns, state, robot, epoch, why, reason"
ENDED = "('done', 'failed', 'cancelled')"

PUT_ALARM = "INSERT OR REPLACE INTO alarm VALUES (?, ?, ?, ?, ?)"
PUT_CHANGE = f"INSERT OR IGNORE INTO change (number, {CHANGE_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)"

MIGRATIONS: tuple[str, ...] = (
    # 1: tasks as they stand, every change of them, and the epochs that may have been given out.
    f"""
    CREATE TABLE task (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        id TEXT NOT NULL UNIQUE,
        state TEXT NOT NULL,
        robot TEXT NOT NULL,
        record TEXT NOT NULL
    );
    CREATE TABLE change (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        task TEXT NOT NULL,
        stamp_ns INTEGER NOT NULL,
        state TEXT NOT NULL,
        robot TEXT NOT NULL,
        epoch INTEGER NOT NULL,
        why TEXT NOT NULL
    );
    CREATE INDEX change_of_task ON change (task);
    CREATE UNIQUE INDEX one_end_of_task ON change (task) WHERE state IN {ENDED};
    CREATE TABLE epoch (only_row INTEGER PRIMARY KEY CHECK (only_row = 1), ceiling INTEGER NOT NULL);
    INSERT INTO epoch VALUES (1, 0);
    """,
    # 2: the request word by word, so that a second submission can be compared; own tasks are marked.
    f"""
    ALTER TABLE task ADD COLUMN kind TEXT NOT NULL DEFAULT '';
    ALTER TABLE task ADD COLUMN own INTEGER NOT NULL DEFAULT 0;
    ALTER TABLE task ADD COLUMN asked TEXT NOT NULL DEFAULT '';
    UPDATE task SET
        kind = coalesce(json_extract(record, '$.task.type'), ''),
        own = coalesce(json_extract(record, '$.own'), 0),
        asked = json_object('task', json_extract(record, '$.task'));
    CREATE INDEX open_task ON task (number) WHERE state NOT IN {ENDED};
    """,
    # 3: reasons as values, in JSON, beside their words; of older changes only the words are known.
    "ALTER TABLE change ADD COLUMN reason TEXT NOT NULL DEFAULT 'null';",
    # 4: sources for which rules have made tasks, so that a coordinator that starts again does not make them again.
    """
    CREATE TABLE alarm (
        rule TEXT NOT NULL,
        source TEXT NOT NULL,
        taken_ns INTEGER NOT NULL,
        fired_ns INTEGER NOT NULL,
        is_armed INTEGER NOT NULL,
        PRIMARY KEY (rule, source)
    );
    """,
    # 5: whether the journal is a copy of another coordinator's, and whether that is whole.
    """
    CREATE TABLE copy (only_row INTEGER PRIMARY KEY CHECK (only_row = 1), state TEXT NOT NULL);
    INSERT INTO copy VALUES (1, '');
    """,
    # 6: the process that had a copy of this journal last, and the pairing with it that is not decided, as JSON.
    """
    CREATE TABLE standing (
        only_row INTEGER PRIMARY KEY CHECK (only_row = 1),
        copied_by TEXT NOT NULL DEFAULT '',
        pairing TEXT NOT NULL DEFAULT ''
    );
    INSERT INTO standing (only_row) VALUES (1);
    """,
    # 7: the robots that continue without a coordinator, and the time of each one's last message, as JSON.
    "ALTER TABLE standing ADD COLUMN on_their_own TEXT NOT NULL DEFAULT '{}';",
    # 8: the journal's own name, by which witnesses remember that it has all that was acknowledged. No pairings.
    "ALTER TABLE standing DROP COLUMN pairing; ALTER TABLE standing ADD COLUMN name TEXT NOT NULL DEFAULT '';",
    # 9: all robots of the team as last received, as JSON, in place of those that continue without a coordinator.
    """
    ALTER TABLE standing RENAME COLUMN on_their_own TO robots;
    UPDATE standing SET robots = (
        SELECT json_group_object(key, json_object('heard_ns', value, 'goes_on', json('true'), 'summary',
            json_object('name', key, 'up', json('false'), 'age_s', 0)))
        FROM json_each(robots)
    );
    """,
    # 10: only elected coordinators have copies, and the witnesses know which are complete.
    "ALTER TABLE standing DROP COLUMN copied_by;",
    # 11: what each part of the coordinator stores, by the part's name, as JSON.
    "ALTER TABLE standing ADD COLUMN parts TEXT NOT NULL DEFAULT '{}';",
)

VERSION = len(MIGRATIONS)


def migrate(connection: sqlite3.Connection, path: Path | None, migrations: tuple[str, ...] = MIGRATIONS) -> int:
    """Bring a journal to the schema of today; returns which it had (0 for a new file).

    Raises:
        JournalError: it is of another program or a newer robrain, and stays as it is.
        sqlite3.Error: it is damaged, locked, or cannot be written.

    """
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if application != APPLICATION_ID and (tables or version or application):
        raise JournalError(path, "is a database, but not a journal of robrain; give another file with --journal")
    if version > len(migrations):
        text = f"was written by a newer robrain (schema {version}, this one knows {len(migrations)}); use that one"
        raise JournalError(path, text)
    for number, script in enumerate(migrations[version:], start=version + 1):
        connection.execute("BEGIN IMMEDIATE")
        try:
            for statement in script.split(";"):
                if statement.strip():
                    connection.execute(statement)
            connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {number}")
            connection.execute("COMMIT")
        except BaseException:  # also Ctrl-C: half a migration must not stay
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise
    return int(version)


def read_json(connection: sqlite3.Connection, path: Path | None, column: str, kind: Any) -> dict[str, Any]:
    """Values by name in a column of the table `standing`; empty if unreadable."""
    (text,) = connection.execute(f"SELECT {column} FROM standing").fetchone()
    try:
        found: dict[str, Any] = msgspec.json.decode(upgraded_json(str(text).encode()), type=dict[str, kind])
    except msgspec.MsgspecError as error:
        logger.warning("%s: the %s of the team cannot be read: %s", path, column, error)
        return {}
    return found


def is_locked(error: sqlite3.DatabaseError) -> bool:
    """Whether another process has the journal open."""
    return error.sqlite_errorcode & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)


def last_change_of(record: TaskRecord) -> TaskChange:
    """The last change of a task, as its record shows it."""
    return TaskChange(
        number=record.change,
        stamp_ns=record.changed_ns,
        state=record.state,
        robot=record.robot,
        epoch=record.epoch,
        why=record.why,
        reason=record.reason,
    )


def change_values(task_id: str, change: TaskChange) -> tuple[object, ...]:
    """The values of `CHANGE_COLUMNS`."""
    reason = msgspec.json.encode(change.reason).decode()
    return (task_id, change.stamp_ns, change.state, change.robot, change.epoch, change.why, reason)
