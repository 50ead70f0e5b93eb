"""Reads pages of a journal for a copy, and writes entries of another journal. Rows keep their numbers."""

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

import msgspec

from robrain.coordinator.journal.alarm import Alarm
from robrain.coordinator.journal.schema import CHANGE_COLUMNS
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.messages.team.standing_messages import JournalAlarm, JournalEntry, JournalTask, KnownRobot

PUT_CHANGE = f"INSERT OR IGNORE INTO change (number, {CHANGE_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)"
NUMBERED = "SELECT record FROM task WHERE number > CAST(? AS INTEGER) ORDER BY number LIMIT CAST(? AS INTEGER)"


def alarm_rows(alarms: list[Alarm]) -> list[JournalAlarm]:
    """Alarms as they travel."""
    return [JournalAlarm(**alarm._asdict()) for alarm in alarms]


def put_entry(database: sqlite3.Connection, entry: JournalEntry) -> None:
    """Write the changes of an entry; within a transaction. An entry that is there already changes nothing."""
    if entry.task is not None:
        put_task(database, entry.task)
    if entry.only_alarms:
        database.execute("DELETE FROM alarm")
    put_alarms(database, entry.alarms)
    if entry.robots is not None:
        put_robots(database, entry.robots)
    if entry.epoch_ceiling:
        database.execute("UPDATE epoch SET ceiling = max(ceiling, ?)", (entry.epoch_ceiling,))


def put_alarms(database: sqlite3.Connection, alarms: list[JournalAlarm]) -> None:
    """Write alarms."""
    for one in alarms:
        values = (one.rule, one.source, one.measured_ns, one.fired_ns, one.is_armed)
        database.execute("INSERT OR REPLACE INTO alarm VALUES (?, ?, ?, ?, ?)", values)


def put_robots(database: sqlite3.Connection, robots: Mapping[str, KnownRobot]) -> None:
    """Write the robots of the team in place of those that are there."""
    database.execute("UPDATE standing SET robots = ?", (msgspec.json.encode(robots).decode(),))


def put_task(database: sqlite3.Connection, told: JournalTask) -> None:
    """Write a task and its changes, unless a later change of it is there already."""
    record = told.record
    for change in told.earlier:
        reason = msgspec.json.encode(change.reason).decode()
        values = (change.number, record.task.id, change.stamp_ns, change.state, change.robot, change.epoch, change.why)
        database.execute(PUT_CHANGE, (*values, reason))
    _put_last_change(database, record)
    encoded = msgspec.json.encode(record).decode()
    row = (told.number, record.task.id, record.state, record.robot, encoded, record.task.kind, record.own)
    database.execute(
        "INSERT OR IGNORE INTO task (number, id, state, robot, record, kind, own, asked)"
        " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
        (*row, told.asked),
    )
    database.execute(
        "UPDATE task SET state = ?, robot = ?, record = ?"
        " WHERE id = ? AND coalesce(json_extract(record, '$.change'), 0) <= ?",
        (record.state, record.robot, encoded, record.task.id, record.change),
    )


def _put_last_change(database: sqlite3.Connection, record: TaskRecord) -> None:
    reason = msgspec.json.encode(record.reason).decode()
    values = (record.change, record.task.id, record.changed_ns, record.state, record.robot, record.epoch, record.why)
    database.execute(PUT_CHANGE, (*values, reason))


def put_aside(database: sqlite3.Connection, path: Path) -> str:
    """Write the contents of a journal to `FILE.before-N` beside it, and report it (sqlite3.OperationalError)."""
    number = 1
    while (aside := path.with_name(f"{path.name}.before-{number}")).exists():
        number += 1
    database.execute("VACUUM INTO ?", (str(aside),))
    with closing(sqlite3.connect(aside)) as copy, copy:
        copy.execute("UPDATE standing SET name = ''")
    return f"{path}: its tasks were put aside as {aside}"
