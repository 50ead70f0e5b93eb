"""The book of tasks: which there are, who does them, how they ended.

`queued → offered → running → done | failed | cancelled`, with `lost_contact` apart, and back to `queued` when a robot
gives a task back. A change is in the journal first, then in the book, then told. An ended task changes no more, which
the journal holds as well: however often robots and coordinators end and begin anew, a task ends once.
"""

from collections.abc import Callable
from typing import Any

import msgspec

from robrain.coordinator.journal.journal import Journal
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.clock import Clock
from robrain.protocol.wire.messages.offer_messages import TaskEvent
from robrain.protocol.wire.messages.robot_messages import TaskStatus
from robrain.protocol.wire.messages.task_messages import TaskRecord
from robrain.protocol.wire.reasons.reason import said
from robrain.protocol.wire.reasons.robots import Failed, Refused
from robrain.protocol.wire.reasons.tasks import DoneBefore, RobotOut, TaskReason, Unreadable
from robrain.protocol.wire.reasons.words import told

ATTEMPTS = 3
"""So many robots may fail at a task that somebody asked for, until it counts as failed (chosen)."""

KEPT_ENDED = 1000
"""Ended tasks that are at hand without a look into the journal."""

_ENDS = frozenset({TaskState.DONE, TaskState.FAILED, TaskState.CANCELLED})
LEGAL: dict[TaskState | None, frozenset[TaskState]] = {
    None: frozenset({TaskState.QUEUED}),
    # A queued task may be told again with another reason; one that an earlier robot finished after all is done.
    TaskState.QUEUED: _ENDS | {TaskState.QUEUED, TaskState.OFFERED},
    TaskState.OFFERED: _ENDS | {TaskState.QUEUED, TaskState.RUNNING},
    TaskState.RUNNING: _ENDS | {TaskState.QUEUED, TaskState.LOST_CONTACT},
    TaskState.LOST_CONTACT: _ENDS | {TaskState.QUEUED, TaskState.RUNNING},
    TaskState.DONE: frozenset(),
    TaskState.FAILED: frozenset(),
    TaskState.CANCELLED: frozenset(),
}
"""What may follow each state; `None` is before the first."""


class TaskBook:
    """Keeps the records and tells every change.

    All that changes a task raises JournalUnwritable, and leaves the task as it was, if the journal cannot take it.

    Args:
        clock: of the run.
        first_epoch: no epoch is less than this one or equal; the journal may demand greater ones.
        tell: called with each change, once it is in the journal.
        journal: the book's, from which it goes on; None begins an empty one in memory.

    """

    def __init__(
        self, clock: Clock, first_epoch: int, tell: Callable[[TaskEvent], None], journal: Journal | None = None
    ) -> None:
        self.journal = journal if journal is not None else Journal()
        self._clock = clock
        self._first_epoch = first_epoch
        self._tell = tell
        self._open = {record.task.id: record for record in self.journal.open_records()}
        self._ended: dict[str, TaskRecord] = {}
        self._of_robot: dict[str, list[str]] = {}
        """Of each robot its open tasks, the one that it is at first: later offers have greater epochs."""
        for record in self._open.values():
            self._bind(record)
        self.done_count = self.journal.count(TaskState.DONE)
        self.version = 0
        """Grows with each change."""

    @property
    def open(self) -> list[TaskRecord]:
        """Tasks that have not ended, in the order in which they were added."""
        return list(self._open.values())

    def find(self, task_id: str) -> TaskRecord | None:
        """A task as it stands, whether it has ended or not; None if there is none of that id."""
        record = self._open.get(task_id) or self._ended.get(task_id)
        if record is None and (record := self.journal.find(task_id)) is not None:
            self._keep(record)
        return record

    def of_robot(self, robot: str) -> TaskRecord | None:
        """The task that a robot is at, or is asked to begin."""
        bound = self._of_robot.get(robot)
        return self._open[bound[0]] if bound else None

    def next_of(self, robot: str) -> TaskRecord | None:
        """The task that it is to begin when it is done with that; offered, and accepted or not."""
        bound = self._of_robot.get(robot, ())
        return self._open[bound[1]] if len(bound) > 1 else None

    def bound_to(self, robot: str) -> list[TaskRecord]:
        """Both."""
        return [self._open[task_id] for task_id in self._of_robot.get(robot, ())]

    def end_what_cannot_be_read(self) -> None:
        """Fail the open tasks that the journal could read only in part."""
        for task_id, why in self.journal.wrong.items():
            if task_id in self._open:
                self.move(task_id, TaskState.FAILED, Unreadable(cut(why)))
        self.journal.wrong.clear()

    def tell_again(self, count: int) -> None:
        """Tell the last change of each of the tasks that changed last: whoever was told before knows it by its number.

        For a coordinator that begins anew: what its journal holds may not have been told.
        """
        for record in self.journal.last_changed(count):
            self._tell(record.event)

    # -- changing -------------------------------------------------------------------------------------------

    def add(self, task: Task, *, by: str = "", own: bool = False, asked: bytes = b"") -> TaskRecord:
        """A new task, queued.

        Args:
            task: whose id no other task has.
            by: who asks for it.
            own: the coordinator made it for itself: it is not tried again.
            asked: what was asked for, word by word.

        """
        now_ns = self._clock.now_ns()
        record = TaskRecord(task=task, state=TaskState.QUEUED, changed_ns=now_ns, submitted_ns=now_ns, by=by, own=own)
        return self._take(self.journal.accept(record, asked))

    def offered(self, task_id: str, robot: str, reason: TaskReason | None = None) -> TaskRecord:
        """A task is about to be offered, also to a robot that is still at another; the record has a new epoch."""
        epoch = self.journal.new_epoch(self._first_epoch + 1)
        return self._change(self._open[task_id], TaskState.OFFERED, reason, robot=robot, epoch=epoch)

    def begin_together(self, task_id: str, reason: TaskReason) -> TaskRecord:
        """Several robots set out for a task at once; it is nobody's alone."""
        epoch = self.journal.new_epoch(self._first_epoch + 1)
        self._change(self._open[task_id], TaskState.OFFERED, reason, epoch=epoch)
        return self._change(self._open[task_id], TaskState.RUNNING, reason)

    def outbid(self, epoch: int) -> None:
        """Use greater epochs than this one, which a robot accepted from another sender, from now on."""
        self.journal.new_epoch(epoch + 1)

    def move(
        self, task_id: str, state: TaskState, reason: TaskReason | None = None, result: dict[str, Any] | None = None
    ) -> TaskRecord:
        """A task goes on to another state."""
        record = self._open[task_id]
        return self._change(record, state, reason, robot=record.robot, result=result or record.result)

    def give_back(self, task_id: str, reason: TaskReason | None, *, failed: bool = False) -> TaskRecord:
        """Its robot does not do it: it is queued again, or ends if it is the coordinator's own.

        Args:
            task_id: of an open task.
            reason: why.
            failed: the robot tried; after 3 of these the task has failed.

        """
        record = self._open[task_id]
        attempts = record.attempts + failed
        if record.own or attempts >= ATTEMPTS:
            state = TaskState.FAILED if failed else TaskState.CANCELLED
            return self._change(record, state, reason, robot=record.robot, attempts=attempts)
        if failed:
            out = reason if isinstance(reason, RobotOut) else RobotOut(record.robot, Failed(cut(told(reason))))
            reason = msgspec.structs.replace(out, attempt=attempts, attempts=ATTEMPTS)
        return self._change(record, TaskState.QUEUED, reason, attempts=attempts)

    def note_status(self, robot: str, status: TaskStatus) -> TaskRecord | None:
        """What a robot says of a task; its word counts only for how the task ended.

        What it has done counts, also with an older epoch, as long as nobody else has: to do it again would be wrong.

        Returns:
            The record as it was, if the robot's word has changed it.

        """
        record = self._open.get(status.id)
        if record is None or not status.state.ended:
            return None
        if record.robot != robot or record.epoch != status.epoch:
            done = status.state is TaskState.DONE
            if not done or not self.journal.was_offered(status.id, robot, status.epoch):
                return None
            reason = DoneBefore(robot) if record.robot else said(status.why)
            self._change(record, TaskState.DONE, reason, robot=robot, epoch=status.epoch, result=status.result)
        elif status.state is TaskState.DONE:
            self.move(status.id, TaskState.DONE, said(status.why), status.result)
        else:
            refusal = None if status.reason is None else RobotOut(robot, Refused(status.reason))
            self.give_back(status.id, refusal or said(status.why), failed=status.state is TaskState.FAILED)
        return record

    def _change(
        self, record: TaskRecord, state: TaskState, reason: TaskReason | None = None, **fields: Any
    ) -> TaskRecord:
        if state not in LEGAL[record.state]:
            raise ValueError(f"task {record.task.id}: {state} cannot follow {record.state}")
        fields = {"robot": "", **fields}  # a task that nobody is named for is nobody's
        changed = msgspec.structs.replace(
            record, state=state, why=told(reason), reason=reason, changed_ns=self._clock.now_ns(), **fields
        )
        return self._take(self.journal.change(changed))

    def _take(self, record: TaskRecord) -> TaskRecord:
        self.version += 1
        before = self._open.get(record.task.id)
        if before is not None and before.robot:
            self._of_robot[before.robot].remove(record.task.id)
        if record.state.ended:
            del self._open[record.task.id]
            self._keep(record)
            self.done_count += record.state is TaskState.DONE
        else:
            self._open[record.task.id] = record
            self._bind(record)
        self._tell(record.event)
        return record

    def _bind(self, record: TaskRecord) -> None:
        if record.robot:
            bound = self._of_robot.setdefault(record.robot, [])
            bound.append(record.task.id)
            bound.sort(key=lambda task_id: self._open[task_id].epoch)

    def _keep(self, ended: TaskRecord) -> None:
        self._ended[ended.task.id] = ended
        if len(self._ended) > KEPT_ENDED:
            del self._ended[next(iter(self._ended))]
