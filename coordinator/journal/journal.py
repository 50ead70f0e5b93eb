"""The journal of one coordinator: tasks, every change of them, and the epochs that were given out, in SQLite.

A change is one transaction. It is in the file when it returns and survives the end of the process at any instant. A
power cut may lose the last ones (`synchronous=NORMAL`; https://sqlite.org/pragma.html#pragma_synchronous); the states
of the robots then restore them. The answer to a submission promises that the task is kept, so it waits for
`when_on_disk`, beside the coordinator's loop. Measured on an ext4 disk, a commit takes 0.01 ms, and 4 to 6 ms if it
waits for the disk. It takes 0.1 to 0.5 s one time in a hundred while other processes write there. Epochs are reserved
on the disk by the thousand before the first of them is used (`FULL`). No power cut can therefore issue one twice.

The file is locked while the journal is open. Stamps come with the records; nothing here reads a clock.
"""

import logging
import os
import secrets
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import astuple, replace

from robrain.coordinator.journal.disk_sync import DiskSync, Sync
from robrain.coordinator.journal.errors import JournalError, JournalLocked, JournalUnwritable
from robrain.coordinator.journal.mending import read_reason, read_record
from robrain.coordinator.journal.salvage import (
    Malformed,
    is_damage,
    move_aside,
    new_path,
    put_aside,
    read_readable_rows,
    replace_journal,
    write_new_journal,
)
from robrain.coordinator.journal.schema import (
    CHANGE_COLUMNS,
    ENDED,
    PUT_ALARM,
    PUT_CHANGE,
    change_values,
    is_locked,
    last_change_of,
    migrate,
    read_json,
)
from robrain.protocol.messages.tasks.task_messages import TaskChange, TaskFilter, TaskRecord
from robrain.protocol.messages.team.standing_messages import (
    JournalAlarm,
    JournalEntry,
    JournalPage,
    JournalTask,
    KnownRobot,
)
from robrain.protocol.model.tasks.old_form import upgraded_json
from robrain.protocol.model.tasks.task import TaskState

logger = logging.getLogger(__name__)

LOCK_TIMEOUT_S = 2.0
"""How long is waited for another coordinator, which may be just ending, to leave the file."""
EPOCH_BLOCK = 1000
KEPT_OWN = 1000
KEPT_ASKED = 100_000
"""Ended tasks that stay in the journal: those of the coordinator's own making, and those that were asked for."""
PRUNE_EVERY = 500


class Journal:
    """Store of a coordinator for data that must not be lost.

    Args:
        path: of the file, made if there is none; None keeps the journal in memory, for lockstep.
        factory: makes the connection.
        sync: see `DiskSync`.
        lock_timeout_s: how long to wait for another process that has it open; `LOCK_TIMEOUT_S` if None.
        new_name: draws the name of a journal that has none.

    Raises:
        JournalLocked: another coordinator writes it.
        JournalError: it cannot be opened, is none of ours, or was written by a newer robrain.

    """

    def __init__(
        self,
        path: Path | None = None,
        *,
        factory: type[sqlite3.Connection] = sqlite3.Connection,
        sync: Sync = os.fdatasync,
        lock_timeout_s: float | None = None,
        new_name: Callable[[], str] = lambda: secrets.token_hex(8),
    ) -> None:
        self.path = path
        self.wrong: dict[str, str] = {}
        """Open tasks that could be read only in part, by id, with the reason; they cannot be done as requested."""
        self.failing = ""
        """Why the last change could not be written, in words; empty once one could."""
        self.opening_report: list[str] = []
        """Report of the opening: the name of a damaged file, and the number of tasks that could be read."""
        self.on_written: Callable[[JournalEntry], None] | None = None
        """Called with each transaction once it is in the file; its receiver sets `seq`."""
        self._factory, self._new_name = factory, new_name
        self._lock_timeout_s = LOCK_TIMEOUT_S if lock_timeout_s is None else lock_timeout_s
        self._ends = 0
        self._db = self._open_or_salvage()
        self._disk = None if path is None else DiskSync(path.with_name(f"{path.name}-wal"), sync)
        self._epoch = self._epoch_ceiling = int(self._db.execute("SELECT ceiling FROM epoch").fetchone()[0])
        for text in self.opening_report:
            logger.warning("%s", text)

    # -- writing --------------------------------------------------------------------------------------------

    def accept(self, record: TaskRecord, asked: bytes = b"", alarm: JournalAlarm | None = None) -> TaskRecord:
        """A new task; on the disk once `when_on_disk` confirms it.

        Args:
            record: as it begins.
            asked: the request, word by word.
            alarm: source for which a rule has made it; kept if and only if the task is.

        Returns:
            The record with the number of its change.

        Raises:
            JournalUnwritable: it is not in the journal.
            sqlite3.IntegrityError: there is a task of that id.

        """
        self._mend_disk()
        with self._transaction():
            self._db.execute(
                "INSERT INTO task (id, state, robot, record, kind, own, asked) VALUES (?, ?, ?, '', ?, ?, ?)",
                (record.task.id, record.state, record.robot, record.task.kind, record.own, asked.decode()),
            )
            if alarm is not None:
                self._put_alarms([alarm])
            written = self._write(record)
        if self.on_written is not None:
            alarms = [] if alarm is None else [alarm]
            self.on_written(JournalEntry(seq=0, task=self._row_of(written, asked=True), alarms=alarms))
        return written

    def change(self, record: TaskRecord) -> TaskRecord:
        """Store the new state of a task, `record`; returns it with the number of the change.

        Raises:
            JournalUnwritable: it is not in the journal, the task is as it was.
            sqlite3.IntegrityError: the task has ended already.

        """
        with self._transaction():
            written = self._write(record)
        self._report(JournalEntry(seq=0, task=self._row_of(written, asked=False)))
        self._ends += record.state.ended
        if self._ends >= PRUNE_EVERY:
            self._ends = 0
            try:
                self._prune()
            except JournalUnwritable as error:  # the change itself is in; there is another time for this
                logger.warning("%s", error)
        return written

    def record_alarm(self, alarm: JournalAlarm) -> None:
        """Store the new state of a rule's source, `alarm`.

        Raises:
            JournalUnwritable: it is as it was.

        """
        self._record(JournalEntry(seq=0, alarms=[alarm]))

    def keep_alarms(self, alarms: Iterable[JournalAlarm]) -> None:
        """Keep these, and no others.

        Raises:
            JournalUnwritable: they are as they were.

        """
        self._record(JournalEntry(seq=0, alarms=list(alarms), only_alarms=True))

    def new_epoch(self, at_least: int = 0) -> int:
        """An epoch that was never given out before, greater than all others of this journal.

        Args:
            at_least: and not less than this.

        Raises:
            JournalUnwritable: no more can be given out.

        """
        epoch = max(self._epoch + 1, at_least)
        if epoch > self._epoch_ceiling:
            ceiling = epoch + EPOCH_BLOCK
            self._record(JournalEntry(seq=0, epoch_ceiling=ceiling), durable=True)
            self._epoch_ceiling = ceiling
        self._epoch = epoch
        return epoch

    @property
    def epoch_ceiling(self) -> int:
        """No epoch above this was issued, or recorded."""
        return self._epoch_ceiling

    @property
    def name(self) -> str:
        """By which witnesses remember this journal; drawn when it is first asked for (JournalUnwritable).

        A copy of another journal has a separate name, and so has a journal salvaged from a damaged one: entries may be
        missing.
        """
        name = str(self._db.execute("SELECT name FROM standing").fetchone()[0])
        return name or self.draw_name()

    def draw_name(self) -> str:
        """Give it another name, under which no witness knows it (JournalUnwritable)."""
        name = self._new_name()
        with self._transaction(durable=True):
            self._db.execute("UPDATE standing SET name = ?", (name,))
        return name

    @property
    def robots(self) -> dict[str, KnownRobot]:
        """The robots of the team, as last received; empty if unreadable."""
        return read_json(self._db, self.path, "robots", KnownRobot)

    @property
    def part_states(self) -> dict[str, dict[str, Any]]:
        """States that parts of the coordinator have stored, by part, as JSON objects; empty if unreadable."""
        return read_json(self._db, self.path, "parts", dict[str, Any])

    def record_part_state(self, part: str, state: msgspec.Struct, alarm: JournalAlarm | None = None) -> None:
        """Store a part's state in place of its last, and the alarm of a rule that changed it (JournalUnwritable)."""
        alarms = [] if alarm is None else [alarm]
        self._record(JournalEntry(seq=0, parts={part: msgspec.to_builtins(state)}, alarms=alarms), durable=True)

    def record_robots(self, robots: Mapping[str, KnownRobot]) -> None:
        """Store the robots of the team; all others are forgotten (JournalUnwritable)."""
        self._record(JournalEntry(seq=0, robots=dict(robots)))

    def when_on_disk(self, on_synced: Callable[[JournalUnwritable | None], None]) -> None:
        """Call `on_synced` once all changes up to now are on the disk, or with the reason why they may not be.

        On a thread of the journal's own; at once if the journal is in memory, or cannot be written after a failed sync.
        """
        if self._disk is None:
            on_synced(None)
            return
        try:
            self._mend_disk()
        except JournalUnwritable as error:
            on_synced(error)
            return

        def synced(error: OSError | None) -> None:
            on_synced(None if error is None else JournalUnwritable(self.path, f"cannot be put on the disk: {error}"))

        self._disk.after(synced)

    def close(self) -> None:
        """Leave the file, once all callbacks that wait for the disk have been called."""
        if self._disk is not None:
            self._disk.close()
        self._db.close()

    # -- reading --------------------------------------------------------------------------------------------

    def open_records(self) -> list[TaskRecord]:
        """The tasks that have not ended, in the order in which they were accepted."""
        return self._records(f"SELECT record FROM task WHERE state NOT IN {ENDED} ORDER BY number")

    def find(self, task_id: str) -> TaskRecord | None:
        """A task as it stands; None if there is none of that id."""
        return next(iter(self._records("SELECT record FROM task WHERE id = ?", task_id)), None)

    def asked(self, task_id: str) -> bytes:
        """The request at the acceptance of the task, word by word but for its form, which is today's."""
        row = self._db.execute("SELECT asked FROM task WHERE id = ?", (task_id,)).fetchone()
        return b"" if row is None else upgraded_json(str(row[0]).encode())

    def select(self, wanted: TaskFilter) -> list[TaskRecord]:
        """The last tasks that match, in the order in which they were accepted."""
        where, values = ["1"], list[str]()
        for column, given in (("state", wanted.states), ("kind", wanted.kinds), ("robot", [wanted.robot])):
            texts = [str(text) for text in given if text]
            if texts:
                where.append(f"{column} IN ({', '.join('?' * len(texts))})")
                values += texts
        if wanted.by:
            where.append("json_extract(record, '$.by') = ?")
            values.append(wanted.by)
        if wanted.prefix:
            where.append("substr(id, 1, length(?)) = ?")
            values += [wanted.prefix, wanted.prefix]
        if not wanted.own:
            where.append("own = 0")
        text = f"SELECT record FROM task WHERE {' AND '.join(where)} ORDER BY number DESC LIMIT {max(0, wanted.limit)}"
        return self._records(text, *values)[::-1]

    def history(self, task_id: str, limit: int = 100) -> list[TaskChange]:
        """The last changes of a task, oldest first."""
        rows = self._db.execute(
            f"SELECT number, {CHANGE_COLUMNS} FROM change WHERE task = ? ORDER BY number DESC LIMIT ?",
            (task_id, limit),
        ).fetchall()
        return [
            TaskChange(number=number, stamp_ns=stamp_ns, state=TaskState(state), robot=robot, epoch=epoch, why=text,
                       reason=read_reason(reason))
            for number, _, stamp_ns, state, robot, epoch, text, reason in reversed(rows)
        ]  # fmt: skip

    def when_offered(self, task_id: str, robot: str, epoch: int) -> int:
        """Number of the change with which a task was offered to a robot with that epoch; 0 if it never was."""
        found = self._db.execute(
            "SELECT max(number) FROM change WHERE task = ? AND robot = ? AND epoch = ? AND state = ?",
            (task_id, robot, epoch, TaskState.OFFERED),
        ).fetchone()
        return found[0] or 0

    def last_changed(self, count: int) -> list[TaskRecord]:
        """The tasks that changed last, each as it stands, the latest change at the end."""
        rows = self._db.execute(
            "SELECT task FROM change GROUP BY task ORDER BY max(number) DESC LIMIT ?", (count,)
        ).fetchall()
        return [record for (task_id,) in reversed(rows) if (record := self.find(task_id)) is not None]

    def last_change(self) -> int:
        """The number of the last change; 0 if there was none."""
        return int(self._db.execute("SELECT coalesce(max(number), 0) FROM change").fetchone()[0])

    def count(self, state: TaskState) -> int:
        """How many tasks are in a state."""
        (found,) = self._db.execute("SELECT count(*) FROM task WHERE state = ?", (state,)).fetchone()
        return int(found)

    def alarms(self) -> list[JournalAlarm]:
        """Sources for which rules have made tasks."""
        rows = self._db.execute("SELECT rule, source, taken_ns, fired_ns, is_armed FROM alarm ORDER BY rule, source")
        return [
            JournalAlarm(rule=rule, source=source, measured_ns=measured_ns, fired_ns=fired_ns, is_armed=bool(armed))
            for rule, source, measured_ns, fired_ns, armed in rows
        ]

    def _records(self, statement: str, *values: str) -> list[TaskRecord]:
        records = []
        for (text,) in self._db.execute(statement, values):
            try:
                record, wrong = read_record(text)
            except (msgspec.DecodeError, UnicodeDecodeError) as error:
                logger.warning("%s: a task in it cannot be read and is left as it is: %s: %.200s",
                               self.path, error, text)  # fmt: skip
                continue
            if wrong and not record.state.ended:
                self.wrong[record.task.id] = wrong
            records.append(record)
        return records

    # -- copies ---------------------------------------------------------------------------------------------

    @property
    def copied(self) -> str:
        """`partial` or `whole` if this is a copy of another coordinator's journal; empty if it is not a copy."""
        return str(self._db.execute("SELECT state FROM copy").fetchone()[0])

    def own(self) -> None:
        """Turn this copy into an ordinary journal (JournalError if it is incomplete, JournalUnwritable)."""
        if self.copied == "partial":
            raise JournalError(self.path, "is an incomplete copy: no coordinator can continue from it")
        if self.copied:
            with self._transaction(durable=True):
                self._db.execute("UPDATE copy SET state = ''")

    def page(self, after: int, limit: int, term: int, seq: int) -> JournalPage:
        """The tasks with the next `limit` numbers after one, for a copy; see JournalPage."""
        tasks = [
            replace(self._row_of(record, asked=True), earlier=self.history(record.task.id)[:-1])
            for record in self._records(
                "SELECT record FROM task WHERE number > CAST(? AS INTEGER) ORDER BY number LIMIT CAST(? AS INTEGER)",
                str(after),
                str(limit),
            )
        ]
        page = JournalPage(term=term, seq=seq, tasks=tasks, epoch_ceiling=self._epoch_ceiling)
        return page if tasks else replace(page, alarms=self.alarms(), robots=self.robots, parts=self.part_states)

    def begin_copy(self) -> None:
        """Remove everything but the epochs: a copy of another journal replaces it, page by page.

        The previous contents of a file stay beside it as `FILE.before-N`.

        Raises:
            JournalUnwritable: nothing was removed.

        """
        has_tasks = self._db.execute("SELECT 1 FROM task LIMIT 1").fetchone() is not None
        if self.path is not None and has_tasks and self.copied != "partial":
            self.opening_report.append(put_aside(self._db, self.path))
        with self._transaction(durable=True):
            self._db.execute("UPDATE copy SET state = 'partial'")
            self._db.execute("UPDATE standing SET name = '', robots = '{}', parts = '{}'")
            for table in ("task", "change", "alarm"):
                self._db.execute(f"DELETE FROM {table}")

    def put_page(self, page: JournalPage) -> None:
        """Write a page of a copy (JournalUnwritable if it cannot be); with the last one the copy is whole."""
        with self._transaction(durable=not page.tasks):
            for task in page.tasks:
                self._put_task(task)
            self._db.execute("UPDATE epoch SET ceiling = max(ceiling, ?)", (page.epoch_ceiling,))
            if not page.tasks:
                self._put_alarms(page.alarms)
                self._put_json("robots", page.robots)
                self._put_json("parts", page.parts)
                self._db.execute("UPDATE copy SET state = 'whole'")

    def follow(self, entries: Iterable[JournalEntry]) -> None:
        """Write all later changes of the copied journal, all or nothing (JournalUnwritable)."""
        self._mend_disk()
        with self._transaction():
            for entry in entries:
                self._put_entry(entry)
                self._ends += entry.task is not None and entry.task.record.state.ended
        if self._ends >= PRUNE_EVERY:
            self._ends = 0
            self._prune()

    def _row_of(self, record: TaskRecord, *, asked: bool) -> JournalTask:
        number, word = self._db.execute("SELECT number, asked FROM task WHERE id = ?", (record.task.id,)).fetchone()
        return JournalTask(number=number, record=record, asked=str(word) if asked else "")

    @property
    def database(self) -> sqlite3.Connection:
        """The open connection, for backups, which read it on a separate thread."""
        return self._db

    # -- within ---------------------------------------------------------------------------------------------

    def _put_alarms(self, alarms: Iterable[JournalAlarm]) -> None:
        self._db.executemany(PUT_ALARM, map(astuple, alarms))

    def _record(self, entry: JournalEntry, *, durable: bool = False) -> None:
        """Write an entry, and report it."""
        with self._transaction(durable=durable):
            self._put_entry(entry)
        self._report(entry)

    def _report(self, entry: JournalEntry) -> None:
        if self.on_written is not None:
            self.on_written(entry)

    def _put_json(self, column: str, values: Mapping[str, Any]) -> None:
        self._db.execute(f"UPDATE standing SET {column} = ?", (msgspec.json.encode(values).decode(),))

    def _put_entry(self, entry: JournalEntry) -> None:
        """Write the changes of another journal's entry. An entry that is there already changes nothing."""
        if entry.task is not None:
            self._put_task(entry.task)
        if entry.only_alarms:
            self._db.execute("DELETE FROM alarm")
        self._put_alarms(entry.alarms)
        if entry.robots is not None:
            self._put_json("robots", entry.robots)
        if entry.parts:
            self._put_json("parts", self.part_states | entry.parts)
        if entry.epoch_ceiling:
            self._db.execute("UPDATE epoch SET ceiling = max(ceiling, ?)", (entry.epoch_ceiling,))

    def _put_task(self, task: JournalTask) -> None:
        """Write a task of another journal and its changes, unless a later change of it is there already."""
        record = task.record
        for change in (*task.earlier, last_change_of(record)):
            self._db.execute(PUT_CHANGE, (change.number, *change_values(record.task.id, change)))
        encoded = msgspec.json.encode(record).decode()
        row = (task.number, record.task.id, record.state, record.robot, encoded, record.task.kind, record.own)
        self._db.execute(
            "INSERT OR IGNORE INTO task (number, id, state, robot, record, kind, own, asked)"
            " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (*row, task.asked),
        )
        self._db.execute(
            "UPDATE task SET state = ?, robot = ?, record = ?"
            " WHERE id = ? AND coalesce(json_extract(record, '$.change'), 0) <= ?",
            (record.state, record.robot, encoded, record.task.id, record.change),
        )

    def _write(self, record: TaskRecord) -> TaskRecord:
        task_id = record.task.id
        cursor = self._db.execute(
            f"INSERT INTO change ({CHANGE_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?)",
            change_values(task_id, last_change_of(record)),
        )
        written = replace(record, change=cursor.lastrowid or 0)
        self._db.execute(
            "UPDATE task SET state = ?, robot = ?, record = ? WHERE id = ?",
            (record.state, record.robot, msgspec.json.encode(written).decode(), task_id),
        )
        return written

    @contextmanager
    def _transaction(self, *, durable: bool = False) -> Iterator[None]:
        try:
            self._db.execute(f"PRAGMA synchronous = {'FULL' if durable else 'NORMAL'}")
            self._db.execute("BEGIN IMMEDIATE")
            yield
            self._db.execute("COMMIT")
            self.failing = ""
        except sqlite3.OperationalError as error:
            self._roll_back()
            unwritable = JournalUnwritable(self.path, f"cannot be written: {error}")
            self.failing = str(unwritable)
            raise unwritable from error
        except BaseException:  # the block's own error, or Ctrl-C: no transaction may stay open
            self._roll_back()
            raise

    def _mend_disk(self) -> None:
        """After a failed sync, write all changes to the main file: the contents of the other one are unknown."""
        if self._disk is None or not self._disk.has_failed:
            return
        try:
            self._db.execute("PRAGMA synchronous = FULL")
            self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        except sqlite3.OperationalError as error:
            raise JournalUnwritable(self.path, f"cannot be put on the disk: {error}") from error
        self._disk.has_failed = False

    def _roll_back(self) -> None:
        if self._db.in_transaction:
            self._db.execute("ROLLBACK")

    def _prune(self) -> None:
        with self._transaction():
            for own, kept in ((1, KEPT_OWN), (0, KEPT_ASKED)):
                self._db.execute(
                    f"CREATE TEMP TABLE old AS SELECT id FROM task WHERE own = ? AND state IN {ENDED}"
                    " ORDER BY number DESC LIMIT -1 OFFSET ?",
                    (own, kept),
                )
                self._db.execute("DELETE FROM change WHERE task IN (SELECT id FROM old)")
                self._db.execute("DELETE FROM task WHERE id IN (SELECT id FROM old)")
                self._db.execute("DROP TABLE old")

    # -- opening --------------------------------------------------------------------------------------------

    def _open_or_salvage(self) -> sqlite3.Connection:
        try:
            return self._open()
        except sqlite3.DatabaseError as error:
            if self.path is None or not is_damage(error):
                raise JournalError(self.path, f"cannot be opened: {error}") from error
            damage = str(error)
        salvaged = read_readable_rows(self.path)
        write_new_journal(salvaged, new_path(self.path))
        aside = move_aside(self.path)
        replace_journal(self.path)
        self.opening_report.append(f"{self.path} was damaged ({damage}) and is now {aside}; {salvaged.summary()}")
        return self._open()

    def _open(self) -> sqlite3.Connection:
        where = ":memory:" if self.path is None else str(self.path)
        try:
            if self.path is not None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                if not self.path.exists():
                    replace_journal(self.path)
            connection = sqlite3.connect(
                where,
                timeout=self._lock_timeout_s,
                isolation_level=None,
                factory=self._factory,
                check_same_thread=False,  # a backup reads beside the coordinator's loop, page by page
            )
        except (OSError, sqlite3.OperationalError) as error:
            text = f"cannot be opened: {error}; is the folder there, and may it be written?"
            raise JournalError(self.path, text) from error
        try:
            connection.execute("PRAGMA locking_mode = EXCLUSIVE")
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            migrate(connection, self.path)
            connection.execute("BEGIN IMMEDIATE")  # from here on the lock is held
            connection.execute("COMMIT")
            (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
            if verdict != "ok":
                raise Malformed(verdict)
            connection.execute("SELECT ceiling FROM epoch").fetchone()[0]
        except BaseException as error:  # also Ctrl-C: the file must not stay locked
            connection.close()
            if isinstance(error, TypeError):  # the row of the epochs has gone
                raise Malformed("it has lost its epochs") from error
            if isinstance(error, sqlite3.OperationalError) and is_locked(error):
                text = "is locked: another coordinator writes it; stop that one, or give another file with --journal"
                raise JournalLocked(self.path, text) from error
            raise
        return connection
