"""Five bugs to plant in the coordination code, to show that a soak finds such bugs.

Each is a patch of real code, in force for the duration of a block, as a developer might make it by mistake.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import msgspec
import pytest

from robrain.agent.robot_tasks import RobotTasks
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.team.halts import TeamHalts
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.messages.team.standing_messages import JournalAlarm
from robrain.protocol.model.tasks.task import TaskState

Patch = tuple[object, str, object]
"""Object, attribute, and planted value."""


def _lease_not_kept() -> list[Patch]:
    return [(RobotTasks, "check_lease", lambda self, now_ns: None)]


def _journal_late() -> list[Patch]:
    accept, change = Journal.accept, Journal.change

    def accept_later(
        self: Journal, record: TaskRecord, asked: bytes = b"", alarm: JournalAlarm | None = None
    ) -> TaskRecord:
        waiting: list[tuple[TaskRecord, bytes, JournalAlarm | None]] = self.__dict__.setdefault("waiting", [])
        waiting.append((record, asked, alarm))
        return msgspec.structs.replace(record, change=0)

    def change_after(self: Journal, record: TaskRecord) -> TaskRecord:
        waiting: list[tuple[TaskRecord, bytes, JournalAlarm | None]] = self.__dict__.setdefault("waiting", [])
        for late, asked, alarm in waiting:
            accept(self, late, asked, alarm)
        waiting.clear()
        return change(self, record)

    return [(Journal, "accept", accept_later), (Journal, "change", change_after)]


def _halt_forgotten() -> list[Patch]:
    return [(TeamHalts, "status", lambda self, now_ns: None)]


def _strays_stay() -> list[Patch]:
    return [(TaskLifecycle, "withdraw_strays", lambda self, now_ns: None)]


def _cancelled_forgotten() -> list[Patch]:
    change = Journal.change

    def lossy(self: Journal, record: TaskRecord) -> TaskRecord:
        if record.state is TaskState.CANCELLED and not record.own:
            return msgspec.structs.replace(record, change=record.change + 1)
        return change(self, record)

    return [(Journal, "change", lossy)]


BUGS: Mapping[str, Callable[[], list[Patch]]] = {
    "lease_not_kept": _lease_not_kept,
    "journal_late": _journal_late,
    "halt_forgotten": _halt_forgotten,
    "strays_stay": _strays_stay,
    "cancelled_forgotten": _cancelled_forgotten,
}
"""By the names in docs/how-to/soak.md."""


@contextmanager
def planted(name: str) -> Iterator[None]:
    """Have a bug in the product for the duration of the block."""
    with pytest.MonkeyPatch.context() as patch:
        for owner, attribute, value in BUGS[name]():
            patch.setattr(owner, attribute, value)
        yield
