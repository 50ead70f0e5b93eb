"""The tasks that a robot knows to be open: a bounded copy of the coordinator's, kept by listening.

Without a coordinator, tasks that robots have accepted are among them.
"""

from collections.abc import Iterable
from typing import NamedTuple

import msgspec

from robrain.protocol.answers.later import Later
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.messages.tasks.consensus_messages import (
    ASKED_BYTES_MAX,
    ASKED_MAX,
    CANCELLED_MAX,
    ENDS_MAX,
    TaskAsked,
    TaskDone,
    TaskDropped,
    TaskKnown,
)
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.task_messages import TASK_LIST, TaskFilter, TaskRecord
from robrain.protocol.model.tasks.stock_kinds import EXPLORE, RECHARGE
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.endpoint import Endpoint

TASKS_MAX = 256
"""Open tasks that a robot remembers (chosen: the number allocated at a time)."""
ENDED_MAX = 1024
"""Ended tasks that a robot remembers, the last ones (chosen: four times the maximum of open ones)."""
OWN_KINDS = frozenset({EXPLORE, RECHARGE})
"""Kinds that a coordinator makes by itself as the team needs them; no robot begins them without it."""


class KnownTask(NamedTuple):
    """An open task by the coordinator's last report."""

    task: Task
    robot: str
    """Its robot at that time; empty if none."""
    received_ns: int = 0
    """Time of the robot's last report about it."""


class KnownTasks:
    """Open tasks, and tasks that no coordinator is known to have recorded: those done or accepted by robots."""

    def __init__(self) -> None:
        self.open: dict[str, KnownTask] = {}
        self.done: dict[str, TaskDone] = {}
        self.asked: dict[str, TaskAsked] = {}
        self.dropped: dict[str, TaskDropped] = {}
        """Tasks that were cancelled and that no coordinator is known to have recorded as ended."""
        self._ended: dict[str, bool] = {}
        """Tasks that a coordinator reported as ended, and whether they were not done, by the reports received."""

    @property
    def is_full(self) -> bool:
        """Whether no further task may be done, as its end might be forgotten."""
        return len(self.done) >= ENDS_MAX

    @property
    def may_be_asked(self) -> bool:
        """Whether there is room for a task that a robot accepts."""
        return len(self.asked) < ASKED_MAX and len(self.open) < TASKS_MAX

    def receive(self, event: TaskEvent, now_ns: int = 0) -> None:
        """Record a coordinator's report of a task."""
        task = event.task
        self.asked.pop(task.id, None)
        if event.state.ended:
            self.record_ended([task.id])
            self._ended[task.id] = event.state is not TaskState.DONE
            self.done.pop(task.id, None)
            self.dropped.pop(task.id, None)
        elif task.kind not in OWN_KINDS and (task.id in self.open or len(self.open) < TASKS_MAX):
            self._ended.pop(task.id, None)
            robot = "" if event.state is TaskState.QUEUED else event.robot
            self.open[task.id] = KnownTask(task, robot, now_ns)

    def adopt_open_tasks(self, events: Iterable[TaskEvent], asked_ns: int, now_ns: int) -> None:
        """Adopt all tasks that a coordinator has open; tasks known before and not among these have ended.

        Args:
            events: the last change of each; if they are as many as a robot remembers, there may be more.
            asked_ns: when it was asked.
            now_ns: the time.

        """
        there = {event.task.id: event for event in events}
        ended = [name for name, one in self.open.items() if name not in there and one.received_ns < asked_ns]
        for name in ended if len(there) < TASKS_MAX else ():
            if name not in self.asked:  # it may not know yet which tasks robots have accepted
                self.record_ended([name])
                self.done.pop(name, None)
                self.dropped.pop(name, None)
        for name, event in there.items():
            known = self.open.get(name)
            if known is None or known.received_ns < asked_ns:
                self.receive(event, now_ns)

    def ask(self, asked: TaskAsked, ahead_ns: int = 0) -> None:
        """Remember a task that a robot has accepted, whose clock is `ahead_ns` ahead; the first of an id stays."""
        task_id = asked.submission.task.id
        if (
            task_id in self.open
            or self.has_ended(task_id)
            or not self.may_be_asked
            or len(asked.submission.word) > ASKED_BYTES_MAX
        ):
            return
        try:
            task = asked.submission.task_at(asked.at_ns - ahead_ns)
        except (ValueError, msgspec.ValidationError):
            return  # the robot that is asked refuses it with a reason
        if task.kind not in OWN_KINDS:
            self.open[task_id] = KnownTask(task, "")
            self.asked[task_id] = asked

    def known(self) -> list[TaskKnown]:
        """Names of the tasks that robots have accepted."""
        return [TaskKnown(id=task_id, at_ns=one.at_ns) for task_id, one in self.asked.items()]

    def record_done(self, done: Iterable[TaskDone]) -> None:
        """Tasks were done; of two robots that did one the first received counts."""
        for one in done:
            if one.id in self.open and one.id not in self.done and not self.is_full:
                self.done[one.id] = one

    def record_ended(self, tasks: Iterable[str]) -> None:
        """A coordinator has reported to this robot or a teammate that tasks have ended."""
        for task_id in tasks:
            self.open.pop(task_id, None)
            self.asked.pop(task_id, None)
            self._ended[task_id] = self._ended.pop(task_id, False)
            if len(self._ended) > ENDED_MAX:
                del self._ended[next(iter(self._ended))]

    def has_ended(self, task_id: str) -> bool:
        """Whether a coordinator is known to have reported that a task has ended; of the last ones only."""
        return task_id in self._ended

    def drop(self, dropped: Iterable[TaskDropped]) -> None:
        """Tasks were cancelled; of two cancellations the first received counts, none once the task is done."""
        for one in dropped:
            if one.id not in self.dropped and one.id not in self.done and len(self.dropped) < CANCELLED_MAX:
                self.dropped[one.id] = one

    def is_done(self, task_id: str) -> bool:
        """Whether a task is known to be done."""
        return task_id in self.done

    def ready(self, now_ns: int) -> list[Task]:
        """Tasks for any one robot that may begin now: their predecessors have ended, and are not known as not done.

        A coordinator fails the tasks that wait for one that was not done; its report of that may be lost.
        """
        return [
            known.task
            for task_id, known in sorted(self.open.items())
            if task_id not in self.done
            and task_id not in self.dropped
            and known.task.robots == 1
            and not (known.task.same_robot_as or known.task.excluded or known.task.paused)
            and known.task.earliest_ns <= now_ns
            and (known.task.deadline_ns is None or now_ns < known.task.deadline_ns)
            and all(other in self.done or self._ended.get(other) is False for other in known.task.after)
        ]


GRACE_NS = to_ns(0.3)
"""An event may be in flight for this long after the summary that counts it (chosen)."""
ASK_AGAIN_NS = to_ns(1.0)
"""A request is repeated after this (chosen)."""
TIMEOUT_S = 2.0
AHEAD_MAX = 1024
"""Numbers remembered that came before those that precede them."""
OPEN = [state for state in TaskState if not state.ended]


class TaskSync:
    """Keeps a robot's known tasks complete while a coordinator is received.

    Args:
        wire: the robot's Zenoh endpoint.
        known: the tasks that it knows.

    """

    def __init__(self, wire: Endpoint, known: KnownTasks) -> None:
        self.behind_since_ns: int | None = None
        """Time at which a missed change was noticed; None if there is none."""
        self.last = 0
        """All changes up to this number were received."""
        self._wire, self._known = wire, known
        self._reported = 0
        self._ahead: set[int] = set()
        self._asked: Later[list[TaskRecord]] | None = None
        self._asked_ns = self._due_ns = self._published_then = 0

    def receive(self, event: TaskEvent, now_ns: int) -> None:
        """Record a change."""
        if event.change > self.last and len(self._ahead) < AHEAD_MAX:
            self._ahead.add(event.change)
            self._count()
        self._record(max(event.change, self._reported), now_ns)

    def receive_summary(self, last_change: int, now_ns: int) -> None:
        """Record the number of the last change; a smaller one than before is that of another journal."""
        if last_change < self._reported:
            self.last = 0
            self._ahead.clear()
        self._reported = last_change
        self._record(last_change, now_ns)

    def step(self, now_ns: int) -> None:
        """Ask for missing changes, and record them."""
        if self._asked is None:
            if self.behind_since_ns is None or now_ns < max(self._due_ns, self.behind_since_ns + GRACE_NS):
                return
            self._asked_ns, self._due_ns, self._published_then = now_ns, now_ns + ASK_AGAIN_NS, self._reported
            wanted = TaskFilter(states=OPEN, limit=TASKS_MAX)
            self._asked = self._wire.ask_later(TASK_LIST, wanted, timeout_s=TIMEOUT_S)
        try:
            records = self._asked.poll()
        except (CallError, NobodyThere):
            self._asked = None
            return
        if records is None:
            return
        self._asked = None
        self._known.adopt_open_tasks([record.event for record in records], self._asked_ns, now_ns)
        self.last = max(self.last, self._published_then)
        self._count()
        self._record(self._reported, now_ns)

    def _count(self) -> None:
        while self.last + 1 in self._ahead:
            self.last += 1
        self._ahead = {number for number in self._ahead if number > self.last}

    def _record(self, last_change: int, now_ns: int) -> None:
        if last_change <= self.last:
            self.behind_since_ns = None
        elif self.behind_since_ns is None:
            self.behind_since_ns = now_ns
