"""Ten bugs planted in the product's coordination code, to show that a soak finds such bugs.

Each is a patch of real code, in force for the duration of a block, as a developer might make it by mistake.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any, NamedTuple

import msgspec

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


class Bug(NamedTuple):
    """A planted bug."""

    doc: str
    patches: Callable[[], list[Patch]]


def _epoch_not_raised() -> list[Patch]:
    def offered(self: TaskBook, task_id: str, robot: str, reason: Any = None) -> TaskRecord:
        record = self._open[task_id]
        epoch = record.epoch or self.journal.new_epoch(self._first_epoch + 1)
        return self._change(record, TaskState.OFFERED, reason, robot=robot, epoch=epoch)

    return [(TaskBook, "offered", offered)]


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


def _halt_forgotten() -> list[Patch]:
    return [(TeamHalts, "status", lambda self, now_ns: None)]


def _offer_never_free() -> list[Patch]:
    honest = reconciling.reconcile

    def trusting(record: TaskRecord, *given: Any) -> Any:
        return None if record.state is TaskState.OFFERED else honest(record, *given)

    return [(task_lifecycle, "reconcile", trusting)]


def _strays_stay() -> list[Patch]:
    return [(TaskLifecycle, "withdraw_strays", lambda self, now_ns: None)]


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


BUGS: Mapping[str, Bug] = MappingProxyType(
    {
        "epoch_not_raised": Bug("A task that goes to another robot keeps its epoch.", _epoch_not_raised),
        "lease_not_kept": Bug("A robot works on when its coordinator is silent.", _lease_not_kept),
        "journal_late": Bug("A task is acknowledged first and journalled with the next change.", _journal_late),
        "requeued_without_order": Bug(
            "A task that is given back loses its priority and what it waits for.", _requeued_without_order
        ),
        "any_report_counts": Bug("Reports count whatever their robot and epoch.", _any_report_counts),
        "halt_forgotten": Bug("The coordinator's summary tells late robots of no halt.", _halt_forgotten),
        "offer_never_free": Bug("A task whose robot dies while it is offered stays offered.", _offer_never_free),
        "strays_stay": Bug("Robots are not told to drop tasks that have ended or moved.", _strays_stay),
        "backoff_without_end": Bug("A pause after a refusal or an unanswered offer never ends.", _backoff_without_end),
        "cancelled_forgotten": Bug("Cancellations are not in the journal.", _cancelled_forgotten),
    }
)
"""By name."""


@contextmanager
def planted(name: str) -> Iterator[None]:
    """Have a bug in the product for the duration of the block (KeyError if there is none of that name)."""
    patches = BUGS[name].patches()
    before = [(owner, attribute, getattr(owner, attribute)) for owner, attribute, _ in patches]
    try:
        for owner, attribute, value in patches:
            setattr(owner, attribute, value)
        yield
    finally:
        for owner, attribute, value in before:
            setattr(owner, attribute, value)
