"""Ten bugs to plant in the coordination code, to show that a soak finds such bugs.

Each is a patch of real code, in force for the duration of a block, as a developer might make it by mistake.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import msgspec
import pytest

from robrain.agent.robot_tasks import RobotTasks
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.tasks import reconcile as reconciling
from robrain.coordinator.tasks import task_lifecycle
from robrain.coordinator.tasks.eligibility import RobotPauses, TaskPauses
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.team.halts import TeamHalts
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.messages.team.standing_messages import JournalAlarm
from robrain.protocol.model.tasks.task import TaskState

Patch = tuple[object, str, object]
"""Object, attribute, and planted value."""


def _epoch_not_raised() -> list[Patch]:
    def offered(self: TaskBook, task_id: str, robot: str, reason: Any = None) -> TaskRecord:
        record = self._open[task_id]
        epoch = record.epoch or self.journal.new_epoch(self._first_epoch + 1)
        return self._change(record, TaskState.OFFERED, reason, robot=robot, epoch=epoch)

    return [(TaskBook, "offered", offered)]


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


def _requeued_without_order() -> list[Patch]:
    give_back = TaskBook.give_back

    def forgetful(self: TaskBook, task_id: str, reason: Any, *, failed: bool = False) -> TaskRecord:
        record = self._open[task_id]
        task = msgspec.structs.replace(record.task, priority=1.0, after=())
        self._open[task_id] = msgspec.structs.replace(record, task=task)
        return give_back(self, task_id, reason, failed=failed)

    return [(TaskBook, "give_back", forgetful)]


def _any_report_counts() -> list[Patch]:
    def record_status(self: TaskBook, robot: str, status: TaskStatus) -> TaskRecord | None:
        record = self._open.get(status.id)
        if record is None or not status.state.ended:
            return None
        if status.state is TaskState.DONE:
            self.move(status.id, TaskState.DONE)
        else:
            self.give_back(status.id, None, failed=status.state is TaskState.FAILED)
        return record

    return [(TaskBook, "record_status", record_status)]


def _offer_never_free() -> list[Patch]:
    honest = reconciling.reconcile

    def trusting(record: TaskRecord, *given: Any) -> Any:
        return None if record.state is TaskState.OFFERED else honest(record, *given)

    return [(task_lifecycle, "reconcile", trusting)]


def _backoff_without_end() -> list[Patch]:
    def pause_reason(self: TaskPauses, task_id: str, robot: str, now_ns: int) -> Any:
        avoided = self._avoided.get((task_id, robot))
        return avoided.reason if avoided is not None else self.robots.backoff_reason(robot, now_ns)

    def backoff_reason(self: Any, robot: str, now_ns: int) -> Any:
        pause = self._unreached.get(robot)
        return None if pause is None else pause.reason

    return [(TaskPauses, "pause_reason", pause_reason), (RobotPauses, "backoff_reason", backoff_reason)]


def _cancelled_forgotten() -> list[Patch]:
    change = Journal.change

    def lossy(self: Journal, record: TaskRecord) -> TaskRecord:
        if record.state is TaskState.CANCELLED and not record.own:
            return msgspec.structs.replace(record, change=record.change + 1)
        return change(self, record)

    return [(Journal, "change", lossy)]


BUGS: Mapping[str, Callable[[], list[Patch]]] = {
    "epoch_not_raised": _epoch_not_raised,
    "lease_not_kept": lambda: [(RobotTasks, "check_lease", lambda self, now_ns: None)],
    "journal_late": _journal_late,
    "requeued_without_order": _requeued_without_order,
    "any_report_counts": _any_report_counts,
    "halt_forgotten": lambda: [(TeamHalts, "status", lambda self, now_ns: None)],
    "offer_never_free": _offer_never_free,
    "strays_stay": lambda: [(TaskLifecycle, "withdraw_strays", lambda self, now_ns: None)],
    "backoff_without_end": _backoff_without_end,
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
