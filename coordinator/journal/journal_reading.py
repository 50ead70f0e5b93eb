"""Contents of a journal: tasks, their changes, and alarms."""

import logging
import sqlite3
from pathlib import Path

import msgspec

from robrain.coordinator.journal.alarm import Alarm
from robrain.coordinator.journal.mending import read_reason, read_record
from robrain.coordinator.journal.schema import CHANGE_COLUMNS, ENDED
from robrain.protocol.messages.tasks.task_messages import TaskChange, TaskFilter, TaskRecord
from robrain.protocol.model.tasks.old_form import upgraded_json
from robrain.protocol.model.tasks.task import TaskState

logger = logging.getLogger(__name__)


class JournalReading:
    """Reads a journal from its open database."""

    _db: sqlite3.Connection

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.wrong: dict[str, str] = {}
        """Open tasks that could be read only in part, by id, with the reason; they cannot be done as requested."""

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
        if not wanted.own:
            where.append("own = 0")
        text = f"SELECT record FROM task WHERE {' AND '.join(where)} ORDER BY number DESC LIMIT {max(0, wanted.limit)}"
        return self._records(text, *values)[::-1]

    def history(self, task_id: str, limit: int = 100) -> list[TaskChange]:
        """The last changes of a task, oldest first."""
        rows = self._db.execute(
            f"SELECT number, {CHANGE_COLUMNS} FROM change WHERE task = ? ORDER BY number DESC LIMIT ?", (task_id, limit)
        ).fetchall()
        return [
            TaskChange(number=number, stamp_ns=stamp_ns, state=TaskState(state), robot=robot, epoch=epoch, why=why,
                       reason=read_reason(reason))
            for number, _, stamp_ns, state, robot, epoch, why, reason in reversed(rows)
        ]  # fmt: skip

    def was_offered(self, task_id: str, robot: str, epoch: int) -> bool:
        """Whether this task was ever offered to that robot with that epoch."""
        found = self._db.execute(
            "SELECT 1 FROM change WHERE task = ? AND robot = ? AND epoch = ? AND state = ?",
            (task_id, robot, epoch, TaskState.OFFERED),
        ).fetchone()
        return found is not None

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

    def alarms(self) -> list[Alarm]:
        """Sources for which rules have made tasks."""
        rows = self._db.execute("SELECT rule, source, taken_ns, fired_ns, is_armed FROM alarm ORDER BY rule, source")
        return [
            Alarm(rule, source, measured_ns, fired_ns, bool(armed))
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
