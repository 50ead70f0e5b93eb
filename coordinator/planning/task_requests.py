"""Answers queries about tasks: submit, dry run, change, cancel, list, get, why."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import msgspec

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.planning.task_explanation import TaskExplainer
from robrain.coordinator.tasks.admission import impossibility, unknown_names
from robrain.coordinator.tasks.eligibility import PAUSED
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.team.chargers import KnownChargers
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.task_messages import (
    TASK_CANCEL,
    TASK_CHANGE,
    TASK_DRY_RUN,
    TASK_EXPLAIN,
    TASK_GET,
    TASK_KINDS,
    TASK_LIST,
    TASK_SUBMIT,
    TaskDryRun,
    TaskExplanation,
    TaskFilter,
    TaskRecord,
    TaskRequest,
    TaskSubmission,
    TaskUpdate,
)
from robrain.protocol.messages.team.standing_messages import JournalAlarm
from robrain.protocol.model.ranges import TEXT_MAX, cut
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import TaskReason, cancelled, operated
from robrain.protocol.wire.endpoint import Deferred, Request, Serve

REPLY_MAX = 10_000
"""Tasks in one reply to `list`."""
NAMED_MAX = 8
"""Tasks that an error names."""
CHANGED, RESUMED = "changed", "resumed"
"""Kinds of reasons of tasks that were changed."""


A = TypeVar("A")


class TaskRequests:
    """Answers the queries `task/…`, in the coordinator's own step.

    Args:
        lifecycle: of the tasks, with the book and the robots.
        explanation: why a task stands as it does, and how a new one would.
        chargers: those that robots know.

    """

    def __init__(self, lifecycle: TaskLifecycle, explanation: TaskExplainer, chargers: KnownChargers) -> None:
        wire = lifecycle.wire
        self.has_changed = False
        """Whether a task was submitted or cancelled since the reader last set it to False."""
        self._clock = wire.clock
        self._roster = lifecycle.roster
        self._book, self._capabilities, self._map = lifecycle.book, lifecycle.capabilities, lifecycle.team_map
        self._explanation, self._chargers, self._gate = explanation, chargers, lifecycle.gate
        wire.answer(TASK_SUBMIT, self._submit, serve=Serve.IN_STEP)
        wire.answer(TASK_DRY_RUN, self._dry_run, serve=Serve.IN_STEP)
        wire.answer(TASK_CANCEL, self._cancel, serve=Serve.IN_STEP)
        wire.answer(TASK_CHANGE, self._change, serve=Serve.IN_STEP)
        wire.answer(TASK_LIST, self._list, serve=Serve.IN_STEP)
        wire.answer(TASK_GET, self._get, serve=Serve.IN_STEP)
        wire.answer(TASK_KINDS, lambda _: self._capabilities.known_kinds(), serve=Serve.IN_STEP)
        wire.answer(TASK_EXPLAIN, self._explain, serve=Serve.IN_STEP)

    def _submit(self, request: Request[TaskSubmission]) -> Deferred[TaskRecord]:
        """Accept a task. It is planned and offered at once; only the answer waits for the disk."""
        asked = request.asked
        if refusal := self._gate.request_refusal():
            raise CallError(ErrorCode.REFUSED, f"task {asked.task.id} is refused: {refusal}", refusal)
        known = self._book.find(asked.task.id)
        if known is not None:
            if (text := self._another(asked, known)) is not None:
                raise CallError(ErrorCode.REFUSED, *text)
            return self._once_on_disk(known, known.task.id)
        record = self.admit(asked, asked.by or request.by, asked.word)
        return self._once_on_disk(record, record.task.id)

    def _another(self, asked: TaskSubmission, known: TaskRecord) -> tuple[str, str] | None:
        """Words and differences if the known task of a submission's id is another one; None if it is the same."""
        differs = asked.differs_from(self._book.journal.asked(asked.task.id))
        if not (differs or known.own):
            return None
        return f"there is another task {asked.task.id}: {differs or 'one of the coordinator itself'}", differs

    def _dry_run(self, request: Request[TaskSubmission]) -> TaskDryRun | Deferred[TaskDryRun]:
        """Result of a submission of a task now. Changes nothing, and is not written down."""
        asked = request.asked
        known = self._book.find(asked.task.id)
        if known is not None:
            another = self._another(asked, known)
            return TaskDryRun(
                task=known.task, known=known.state, refused="" if another is None else cut(another[0], TEXT_MAX)
            )
        task = self._stamped(asked)
        if refusal := self._refusal(task):
            return TaskDryRun(task=task, refused=cut(refusal, TEXT_MAX))
        return Deferred(partial(self._explanation.dry_run, task, asked.by or request.by, self._clock.now_ns()))

    def _stamped(self, asked: TaskSubmission) -> Task:
        """The task with stamps in place of times that count from now (CallError if that is impossible)."""
        try:
            return asked.task_at(self._clock.now_ns())
        except (ValueError, msgspec.ValidationError) as error:
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"task {asked.task.id}: {error}") from error

    def admit(
        self,
        asked: TaskSubmission,
        by: str,
        word: bytes = b"",
        *,
        reason: TaskReason | None = None,
        alarm: JournalAlarm | None = None,
    ) -> TaskRecord:
        """Put a new task into the book, unless it can never be done.

        Args:
            asked: the submission; there is no task with its id.
            by: name of the requester.
            word: the submission as it was received.
            reason: why there is such a task; None if a client has submitted it.
            alarm: source for which a rule has made it.

        Raises:
            CallError: it is refused, in words.

        """
        task = self._stamped(asked)
        if refusal := self._refusal(task):
            raise CallError(ErrorCode.REFUSED, f"task {task.id} is refused: {refusal}", refusal)
        try:
            record = self._book.add(task, by=by, asked=word, reason=reason, alarm=alarm)
        except JournalUnwritable as error:
            raise CallError(ErrorCode.REFUSED, f"task {task.id} is refused: {error}", str(error)) from error
        self.has_changed = True
        return record

    def _once_on_disk(self, reply: A, name: str) -> Deferred[A]:
        journal = self._book.journal

        def when(answer: Callable[[A | CallError], None]) -> None:
            def synced(error: JournalUnwritable | None) -> None:
                text = f"task {name} is accepted, but a power cut may lose it: {error}"
                answer(reply if error is None else CallError(ErrorCode.FAILED, text, str(error)))

            def not_kept(reason: str) -> None:
                answer(CallError(ErrorCode.FAILED, f"task {name} may get lost: {reason}; ask again", reason))

            self._gate.when_kept(lambda: journal.when_on_disk(synced), not_kept)

        return Deferred(when)

    def _refusal(self, task: Task) -> str:
        """Why a task is refused at its submission, in words; empty if it is accepted."""
        known = [name for name in task.others if self._book.find(name) is not None]
        return self.impossibility(task) or unknown_names(task, known, self._gate.mote_quantities, self._chargers.places)

    def impossibility(self, task: Task) -> str:
        """Why a task can never be done, in words; empty if it may be possible."""
        others: dict[str, TaskRecord] = {}
        waiting = list(task.others)
        while waiting:
            name = waiting.pop()
            record = None if name in others else self._book.find(name)
            if record is not None:
                others[name] = record
                waiting += record.task.others
        return impossibility(
            task,
            self._clock.now_ns(),
            team_map=self._map,
            robots=[robot.state for robot in self._roster.robots.values() if robot.state is not None],
            plugins=self._capabilities.plugins,
            others=others,
            schemas=self._capabilities.schemas(),
        )

    def _cancel(self, request: Request[TaskRequest]) -> Deferred[TaskRecord]:
        asked = request.asked
        update = TaskUpdate(ids=[asked.id], by=asked.by, why=asked.why, cancels=True)
        return self._once_on_disk(self._updated(update, request)[0], asked.id)

    def _change(self, request: Request[TaskUpdate]) -> Deferred[list[TaskRecord]]:
        records = self._updated(request.asked, request)
        return self._once_on_disk(records, ", ".join(record.task.id for record in records[:NAMED_MAX]))

    def _updated(self, asked: TaskUpdate, request: Request[Any]) -> list[TaskRecord]:
        """Change or cancel tasks; returns their records."""
        verb, by = "cancelled" if asked.cancels else "changed", asked.by or request.by
        what = f"task {', '.join(asked.ids[:NAMED_MAX])} is" if asked.which is None else "no task is"
        if refusal := self._gate.request_refusal():
            raise CallError(ErrorCode.REFUSED, f"{what} not {verb}: {refusal}", refusal)
        records = self._selected(asked)
        for record in records:
            if request.asker is not None and not request.asker.is_operator and record.by != by:
                text = (
                    f"task {record.task.id} is not {verb}: it is {record.by or 'somebody'}'s, and {by} is no operator"
                )
                raise CallError(ErrorCode.FORBIDDEN, text)
        tasks = [self._changed(record, asked) for record in records]
        try:
            for task in tasks:
                self._update(task, asked, by)
        except JournalUnwritable as error:
            raise CallError(ErrorCode.REFUSED, f"{what} not {verb}: {error}", str(error)) from error
        self.has_changed = True  # robots get their orders in the same step
        return [self._known(task.id) for task in tasks]

    def _selected(self, asked: TaskUpdate) -> list[TaskRecord]:
        """The tasks that an update is for."""
        if asked.which is not None:
            states = [state for state in asked.which.states or TaskState if not state.ended]
            wanted = msgspec.structs.replace(asked.which, states=states, own=False, limit=REPLY_MAX)
            return self._book.journal.select(wanted) if states else []
        records = [self._known(task_id) for task_id in asked.ids]
        for record in records:
            if record.state.ended and not (asked.cancels and record.state is TaskState.CANCELLED):
                text = f"task {record.task.id} has ended already: it is {record.state}"
                raise CallError(ErrorCode.REFUSED, text, record.state)
            if record.own and not asked.cancels:
                raise CallError(ErrorCode.REFUSED, f"task {record.task.id} is one of the coordinator itself")
        return records

    def _changed(self, record: TaskRecord, asked: TaskUpdate) -> Task:
        """A task as an update makes it (CallError if it could not be done then)."""
        task, robots = record.task, self._roster.robots
        for name in filter(None, (asked.robot, asked.excluded)):
            if name not in robots:
                known = ", ".join(sorted(robots)) or "none"
                raise CallError(ErrorCode.REFUSED, f"task {task.id}: no robot {name} is known; there are: {known}")
        fields: dict[str, Any] = {}
        if asked.priority is not None:
            fields["priority"] = asked.priority
        if asked.paused is not None:
            fields["paused"] = asked.paused
        if asked.robot:
            fields["needs"] = (*(name for name in task.needs if name not in robots), asked.robot)
            fields["excluded"] = tuple(name for name in task.excluded if name != asked.robot)
        if asked.excluded:
            fields["needs"] = tuple(name for name in fields.get("needs", task.needs) if name != asked.excluded)
            fields["excluded"] = tuple(dict.fromkeys((*fields.get("excluded", task.excluded), asked.excluded)))
        task = msgspec.structs.replace(task, **fields)
        task = self._stamped(
            TaskSubmission(task=task, earliest_in_s=asked.earliest_in_s, deadline_in_s=asked.deadline_in_s)
        )
        is_same = (_times(task), _robots(task)) == (_times(record.task), _robots(record.task))
        if not is_same and (refusal := self.impossibility(task)):
            raise CallError(ErrorCode.REFUSED, f"task {task.id} is not changed: {refusal}", refusal)
        return task

    def _update(self, task: Task, asked: TaskUpdate, by: str) -> None:
        record = self._known(task.id)
        if asked.cancels:
            if not record.state.ended:
                self._book.move(task.id, TaskState.CANCELLED, cancelled(by, asked.why))
        elif task != record.task:
            kind = CHANGED if task.paused == record.task.paused else PAUSED if task.paused else RESUMED
            fits = bool(record.robot) and asked.robot in ("", record.robot) and record.robot != asked.excluded
            is_recalled = task.paused or (_times(task) != _times(record.task))
            is_recalled |= not fits and _robots(task) != _robots(record.task)
            recalls = is_recalled and record.state is not TaskState.QUEUED
            self._book.update(task, operated(kind, by, asked.why), recalls=recalls)

    def _list(self, request: Request[TaskFilter]) -> list[TaskRecord]:
        wanted = request.asked
        found = self._book.journal.select(msgspec.structs.replace(wanted, limit=min(wanted.limit, REPLY_MAX)))
        now_ns = self._clock.now_ns()
        return [self._explanation.estimated(record, now_ns) for record in found]

    def _get(self, request: Request[TaskRequest]) -> TaskRecord:
        return self._explanation.estimated(self._known(request.asked.id), self._clock.now_ns())

    def _explain(self, request: Request[TaskRequest]) -> Deferred[TaskExplanation]:
        return Deferred(partial(self._explanation.explain, self._known(request.asked.id), self._clock.now_ns()))

    def _known(self, task_id: str) -> TaskRecord:
        record = self._book.find(task_id)
        if record is None:
            raise CallError(ErrorCode.REFUSED, f"there is no task {task_id}")
        return record


def _times(task: Task) -> tuple[int, int | None]:
    return task.earliest_ns, task.deadline_ns


def _robots(task: Task) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return task.needs, task.excluded
