"""The book of tasks: their states, their robots, their ends.

`queued → offered → running → done | failed | cancelled`, with `lost_contact` apart, and back to `queued` when a robot
gives a task back. A change is written to the journal first, then to the book, then published. An ended task never
changes, which the journal enforces too: a task ends once, however often robots and coordinators restart.
"""

from collections.abc import Callable
from typing import Any

import msgspec

from robrain.coordinator.journal.journal import Journal
from robrain.protocol.clock import Clock
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.messages.team.standing_messages import JournalAlarm
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.task import ENDED, MEMBER_PREFIX, Task, TaskState
from robrain.protocol.reasons import Refused, RobotOut, TaskReason, plain, reason_from, sentence_of

ATTEMPTS = 3
"""Robots that must fail at a submitted task before it counts as failed (chosen)."""

KEPT_ENDED = 1000
"""Ended tasks kept in memory; older ones are read from the journal."""

LEGAL: dict[TaskState | None, frozenset[TaskState]] = {
    None: frozenset({TaskState.QUEUED}),
    # A task may be published again with another reason or as changed; if an earlier robot finished it, it is done.
    TaskState.QUEUED: ENDED | {TaskState.QUEUED, TaskState.OFFERED},
    TaskState.OFFERED: ENDED | {TaskState.QUEUED, TaskState.OFFERED, TaskState.RUNNING},
    TaskState.RUNNING: ENDED | {TaskState.QUEUED, TaskState.RUNNING, TaskState.LOST_CONTACT},
    TaskState.LOST_CONTACT: ENDED | {TaskState.QUEUED, TaskState.RUNNING, TaskState.LOST_CONTACT},
    TaskState.DONE: frozenset(),
    TaskState.FAILED: frozenset(),
    TaskState.CANCELLED: frozenset(),
}
"""States that may follow each state; `None` is before the first."""

NS_PER_MS = 1_000_000
OUTBID_MAX = 48 * 3600 * 1000
"""In ms. Robots accept epochs up to a day ahead of their clocks; twice that allows for clock differences."""


class TaskBook:
    """Keeps the records and publishes each change.

    Methods that change a task raise JournalUnwritable, and leave the task as it was, if the journal cannot be written.

    Args:
        clock: the run's clock.
        first_epoch: epochs are greater than this; the journal may require still greater ones.
        publish: called with each change, once it is in the journal.
        journal: the book's journal, from which it continues; None for an empty one in memory.

    """

    def __init__(
        self, clock: Clock, first_epoch: int, publish: Callable[[TaskEvent], None], journal: Journal | None = None
    ) -> None:
        self.journal = journal if journal is not None else Journal()
        self._clock = clock
        self._first_epoch = first_epoch
        self._publish = publish
        self._open = {record.task.id: record for record in self.journal.open_records()}
        self._ended: dict[str, TaskRecord] = {}
        self._of_robot: dict[str, list[str]] = {}
        """Open tasks of each robot, the running one first: later offers have greater epochs."""
        for record in self._open.values():
            self._bind(record)
        self.done_count = self.journal.count(TaskState.DONE)
        self.version = 0
        """Increases with each change."""
        self.last_change = self.journal.last_change()
        """The number of the last change."""

    @property
    def open(self) -> list[TaskRecord]:
        """Tasks that have not ended, in the order in which they were added."""
        return list(self._open.values())

    def find(self, task_id: str) -> TaskRecord | None:
        """A task by id, ended or not; None if there is none."""
        record = self._open.get(task_id) or self._ended.get(task_id)
        if record is None and (record := self.journal.find(task_id)) is not None:
            self._keep(record)
        return record

    def is_open(self, task_id: str) -> bool:
        """Whether a task is known and has not ended."""
        return task_id in self._open

    def of_robot(self, robot: str) -> TaskRecord | None:
        """The task that a robot is doing, or was asked to begin."""
        bound = self._of_robot.get(robot)
        return self._open[bound[0]] if bound else None

    def next_of(self, robot: str) -> TaskRecord | None:
        """The task that it will begin after that one; offered, whether accepted or not."""
        bound = self._of_robot.get(robot, ())
        return self._open[bound[1]] if len(bound) > 1 else None

    def bound_to(self, robot: str) -> list[TaskRecord]:
        """Both of these."""
        return [self._open[task_id] for task_id in self._of_robot.get(robot, ())]

    def fail_unreadable(self) -> None:
        """Fail the open tasks that the journal could only read in part."""
        for task_id, problem in self.journal.wrong.items():
            if task_id in self._open:
                self.move(
                    task_id,
                    TaskState.FAILED,
                    plain("unreadable", f"it cannot be carried out as requested: {cut(problem)}"),
                )
        self.journal.wrong.clear()

    def republish(self, count: int) -> None:
        """Publish the last change of the `count` most recently changed tasks; receivers recognise repeats by number.

        For a restarted coordinator, because the latest changes in its journal may not have been published.
        """
        for record in self.journal.last_changed(count):
            self._publish(record.event)

    def republish_change(self, record: TaskRecord) -> None:
        """Publish a task's last change again, for robots that have missed it."""
        self._publish(record.event)

    # -- changing -------------------------------------------------------------------------------------------

    def add(
        self,
        task: Task,
        *,
        by: str = "",
        own: bool = False,
        asked: bytes = b"",
        reason: TaskReason | None = None,
        alarm: JournalAlarm | None = None,
    ) -> TaskRecord:
        """Add a task, queued.

        Args:
            task: with an unused id.
            by: name of the client that submitted it.
            own: whether it is the coordinator's own, which is never retried.
            asked: the submission as it was received.
            reason: why there is such a task; None if a client has submitted it.
            alarm: source for which a rule has made it.

        """
        now_ns = self._clock.now_ns()
        record = TaskRecord(
            task=task,
            state=TaskState.QUEUED,
            why=sentence_of(reason),
            changed_ns=now_ns,
            submitted_ns=now_ns,
            by=by,
            own=own,
            reason=reason,
        )
        return self._keep_change(self.journal.accept(record, asked, alarm))

    def offered(self, task_id: str, robot: str, reason: TaskReason | None = None) -> TaskRecord:
        """Record an offer to a robot, which may still do another task; the record gets a new epoch."""
        epoch = self.journal.new_epoch(self._first_epoch + 1)
        return self._change(self._open[task_id], TaskState.OFFERED, reason, robot=robot, epoch=epoch)

    def begin_together(self, task_id: str, reason: TaskReason) -> TaskRecord:
        """Record that several robots set out for a task together; its record names no robot."""
        epoch = self.journal.new_epoch(self._first_epoch + 1)
        self._change(self._open[task_id], TaskState.OFFERED, reason, epoch=epoch)
        return self._change(self._open[task_id], TaskState.RUNNING, reason)

    def is_possible(self, epoch: int) -> bool:
        """Whether a coordinator may have given out an epoch that a robot reports."""
        return epoch - self._clock.now_ns() // NS_PER_MS <= OUTBID_MAX

    def exceed(self, epoch: int) -> None:
        """Another coordinator has given this epoch out: from now on use greater ones (JournalUnwritable)."""
        if epoch > self.journal.epoch_ceiling:
            self.outbid(epoch)

    def outbid(self, epoch: int) -> None:
        """From now on use epochs greater than this one, which a robot accepted from another sender."""
        self.journal.new_epoch(epoch + 1)

    def move(
        self, task_id: str, state: TaskState, reason: TaskReason | None = None, result: dict[str, Any] | None = None
    ) -> TaskRecord:
        """Change the state of a task."""
        record = self._open[task_id]
        return self._change(record, state, reason, robot=record.robot, result=result or record.result)

    def update(self, task: Task, reason: TaskReason, *, recalls: bool) -> TaskRecord:
        """Replace an open task by one with the same id.

        Args:
            task: the new one.
            reason: why.
            recalls: whether its robot has to give it back. The task stays with the robot until it has; several robots,
                or a mote, have lost it at once.

        """
        record = self._open[task.id]
        if recalls and (not record.robot or record.robot.startswith(MEMBER_PREFIX)):
            return self._change(record, TaskState.QUEUED, reason, task=task)
        recalled = record.recalled or recalls
        return self._change(record, record.state, reason, task=task, robot=record.robot, recalled=recalled)

    def give_back(self, task_id: str, reason: TaskReason | None, *, failed: bool = False) -> TaskRecord:
        """A robot does not do its task: queue it again, or end it if it is the coordinator's own.

        Args:
            task_id: of an open task.
            reason: why.
            failed: whether the robot tried; after 3 such failures the task has failed.

        """
        record = self._open[task_id]
        attempts = record.attempts + failed
        if record.own or attempts >= ATTEMPTS:
            state = TaskState.FAILED if failed else TaskState.CANCELLED
            return self._change(record, state, reason, robot=record.robot, attempts=attempts)
        if failed:
            out = (
                reason
                if isinstance(reason, RobotOut)
                else RobotOut(record.robot, plain("failed", f"failed: {cut(sentence_of(reason))}"))
            )
            reason = msgspec.structs.replace(out, attempt=attempts, attempts=ATTEMPTS)
        return self._change(record, TaskState.QUEUED, reason, attempts=attempts)

    def record_status(self, robot: str, status: TaskStatus) -> TaskRecord | None:
        """Process a robot's report on a task; it counts only for how the task ended.

        A finished task counts, also with an older epoch, unless another robot has finished it: no task is done twice.

        Returns:
            The record before the change; None if nothing changed.

        """
        record = self._open.get(status.id)
        if record is None or not status.state.ended:
            return None
        if record.robot != robot or record.epoch != status.epoch:
            done = status.state is TaskState.DONE
            if not done or not self.journal.when_offered(status.id, robot, status.epoch):
                return None
            reason = (
                plain("done_before", f"{robot} had done it before it was given to another", robot=robot)
                if record.robot
                else reason_from(status.why)
            )
            self._change(record, TaskState.DONE, reason, robot=robot, epoch=status.epoch, result=status.result)
        elif status.state is TaskState.DONE:
            self.move(status.id, TaskState.DONE, reason_from(status.why), status.result)
        else:
            refusal = None if status.reason is None else RobotOut(robot, Refused(status.reason))
            has_failed = status.state is TaskState.FAILED
            is_as_asked = record.recalled and not has_failed
            why = record.reason if is_as_asked else refusal or reason_from(status.why)
            self.give_back(status.id, why, failed=has_failed)
        return record

    def record_done_by_team(self, task_id: str, robot: str, epoch: int, reason: TaskReason) -> None:
        """A robot did a task that no coordinator had given it; nothing changes if it has ended, or is unknown."""
        if task_id in self._open:
            self._change(self._open[task_id], TaskState.DONE, reason, robot=robot, epoch=epoch)

    def adopt(self, task_id: str, robot: str, epoch: int, reason: TaskReason) -> None:
        """Assign a queued task to the robot that already works at it, although no coordinator offered it."""
        record = self._change(self._open[task_id], TaskState.OFFERED, reason, robot=robot, epoch=epoch)
        self._change(record, TaskState.RUNNING, reason, robot=robot, epoch=epoch)

    def _change(
        self, record: TaskRecord, state: TaskState, reason: TaskReason | None = None, **fields: Any
    ) -> TaskRecord:
        if state not in LEGAL[record.state]:
            raise ValueError(f"task {record.task.id}: {state} cannot follow {record.state}")
        fields = {"robot": "", **fields}  # no robot unless one is given
        fields.setdefault("recalled", record.recalled and bool(fields["robot"]) and not state.ended)
        changed = msgspec.structs.replace(
            record, state=state, why=sentence_of(reason), reason=reason, changed_ns=self._clock.now_ns(), **fields
        )
        return self._keep_change(self.journal.change(changed))

    def _keep_change(self, record: TaskRecord) -> TaskRecord:
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
        self.last_change = max(self.last_change, record.change)
        self._publish(record.event)
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
