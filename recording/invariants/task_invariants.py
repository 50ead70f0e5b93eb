"""No task is done twice, and none is at two robots: invariants of tasks, and the changes of tasks as they were made.

A task ends once, and no robot works on it afterwards. No two robots do it for longer than a lease.
"""

from collections.abc import Mapping
from enum import Enum, auto

from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.model.tasks.task import FREE_AFTER_S, TaskState
from robrain.recording.invariants.findings import (
    DoneAgain,
    Invariant,
    MissingEvidence,
    Reopened,
    StillAtDone,
    TaskAtTwo,
)
from robrain.recording.invariants.invariant_judge import Handler, InvariantJudge, Surroundings

ENDED_KEPT = 100_000
"""Ended tasks that are remembered (chosen: some 20 MB)."""


class ChangeKind(Enum):
    """The kind of an event."""

    NEWS = auto()
    """A change of a task that has not ended, or is new."""
    AFTER_END = auto()
    """A change of a task that had ended."""
    REPEAT = auto()
    """A change that was reported before, or one before it."""


class TaskChanges:
    """Follows `task/event`.

    The coordinator numbers its changes without gaps, repeats the last ones after a restart, and starts again at 1 with
    an empty journal.
    """

    def __init__(self) -> None:
        self.open: dict[str, TaskEvent] = {}
        """The last change of each task that has not ended."""
        self.ended: dict[str, tuple[TaskEvent, int]] = {}
        """First end of each task, and its recording time, ns; the oldest are forgotten."""
        self.is_from_start = False
        """Whether the first change of all was received."""
        self.has_gap = False
        """Whether changes in between are missing."""
        self._last_change = 0
        self._tasks = 0

    @property
    def tasks(self) -> int:
        """Number of tasks in the messages."""
        return self._tasks

    def handle(self, event: TaskEvent, time_ns: int) -> ChangeKind:
        """The next event."""
        known = self._known(event.task.id)
        if known is not None and not _is_later(event, known):
            return ChangeKind.REPEAT
        self._count(event.change)
        self._tasks += known is None
        if event.task.id in self.ended:
            if event.state.ended:
                self.ended[event.task.id] = event, self.ended[event.task.id][1]
            return ChangeKind.AFTER_END
        if event.state.ended:
            self.open.pop(event.task.id, None)
            self.ended[event.task.id] = event, time_ns
            if len(self.ended) > ENDED_KEPT:
                del self.ended[next(iter(self.ended))]
        else:
            self.open[event.task.id] = event
        return ChangeKind.NEWS

    def done_ns(self, task: str) -> int | None:
        """Time at which a task was done first; None if it was not."""
        ended = self.ended.get(task)
        return ended[1] if ended is not None and ended[0].state is TaskState.DONE else None

    def _known(self, task: str) -> TaskEvent | None:
        ended = self.ended.get(task)
        return ended[0] if ended is not None else self.open.get(task)

    def _count(self, change: int) -> None:
        if change == 0:  # an older coordinator, which did not number them
            return
        if self._last_change == 0:
            self.is_from_start = change == 1
        elif change > self._last_change + 1:
            self.has_gap = True
        self._last_change = change


def _is_later(event: TaskEvent, known: TaskEvent) -> bool:
    """Whether it is a change after the known one, also of a coordinator that counts from the start."""
    if event.change > known.change:
        return True
    return (event.change, event.epoch, event.state) != (known.change, known.epoch, known.state) and (
        event.stamp_ns > known.stamp_ns
    )


STILL_AT_NS = to_ns(FREE_AFTER_S)
"""A robot may continue with a task that was done for this long: until it learns of it, or its lease ends."""
SILENT_NS = to_ns(1.0)


class _StillAt:
    """A robot at a task that was done."""

    __slots__ = ("is_reported", "last_ns", "since_ns", "task")

    def __init__(self, task: str, now_ns: int) -> None:
        self.task = task
        self.since_ns = self.last_ns = now_ns
        self.is_reported = False


class TaskOnce(InvariantJudge):
    """Counts the ends of tasks, by the numbers of the changes, and judges robots' work after them."""

    invariant = Invariant.TASK_ONCE

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._changes = TaskChanges()
        self._still: dict[str, _StillAt] = {}
        self._has_received = False
        self._reopened: set[str] = set()

    def handlers(self) -> Mapping[type, Handler]:
        """Handlers by type of message."""
        return {TaskEvent: self._handle_event, RobotState: self._handle_state}

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing."""
        if self._changes.has_gap:
            return MissingEvidence.EVENTS
        return None if self._has_received or self._changes.tasks else MissingEvidence.TASKS

    def _handle_event(self, event: TaskEvent, time_ns: int) -> None:
        task = event.task.id
        before = self._changes.ended.get(task)
        if self._changes.handle(event, time_ns) is not ChangeKind.AFTER_END:
            self.cases += event.state is TaskState.DONE and before is None
            return
        assert before is not None  # it had ended
        ended, ended_ns = before
        was_reopened = task in self._reopened
        (self._reopened.discard if event.state.ended else self._reopened.add)(task)
        if event.state is TaskState.DONE and ended.state is TaskState.DONE:
            changes, first_s = (ended.change, event.change), self.time_s(ended_ns)
            self.break_(time_ns, DoneAgain(task=task, robot=event.robot, changes=changes, first_s=first_s))
        elif not was_reopened:
            self.break_(time_ns, Reopened(task=task, ended=ended.state, state=event.state))

    def _handle_state(self, state: RobotState, time_ns: int) -> None:
        self._has_received = True
        status, robot = state.task, state.robot
        at = status.id if status is not None and status.state is TaskState.RUNNING else ""
        done_ns = self._changes.done_ns(at) if at else None
        if done_ns is None:
            self._still.pop(robot, None)
            return
        still = self._still.get(robot)
        if still is None or still.task != at or time_ns - still.last_ns > SILENT_NS:
            still = self._still[robot] = _StillAt(at, time_ns)
        still.last_ns = time_ns
        for_ns = time_ns - still.since_ns
        if for_ns > STILL_AT_NS and not still.is_reported:
            still.is_reported = True
            for_s = round(to_seconds(for_ns), 3)
            self.break_(time_ns, StillAtDone(task=at, robot=robot, done_s=self.time_s(done_ns), for_s=for_s))


BOTH_NS = to_ns(FREE_AFTER_S)
"""For as long two robots may be at a task: the lease and its guard time."""
SILENT_NS = to_ns(1.0)
"""A robot that is silent for this long is not counted as being at its task; its time starts again."""


class _At:
    """A robot at a task."""

    __slots__ = ("epoch", "last_ns", "since_ns")

    def __init__(self, epoch: int, now_ns: int) -> None:
        self.epoch = epoch
        self.since_ns = self.last_ns = now_ns


class TaskAtOne(InvariantJudge):
    """Follows which robots report that they do a task."""

    invariant = Invariant.TASK_AT_ONE

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._at: dict[str, dict[str, _At]] = {}
        """Robots by task."""
        self._task_of: dict[str, str] = {}
        self._reported: set[tuple[str, str, str]] = set()
        self._has_received = False

    def handlers(self) -> Mapping[type, Handler]:
        """Handlers by type of message."""
        return {RobotState: self._handle_state}

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing."""
        return None if self._has_received else MissingEvidence.ROBOTS

    def _handle_state(self, state: RobotState, time_ns: int) -> None:
        self._has_received = True
        status, robot = state.task, state.robot
        task = status.id if status is not None and status.state is TaskState.RUNNING else ""
        if self._task_of.get(robot, "") != task:
            self._leave(robot)
        if status is None or not task:
            return
        robots = self._at.setdefault(task, {})
        if not robots:
            self.cases += 1
        at = robots.get(robot)
        if at is None or time_ns - at.last_ns > SILENT_NS or at.epoch != status.epoch:
            at = robots[robot] = _At(status.epoch, time_ns)
            self._task_of[robot] = task
        at.last_ns = time_ns
        if len(robots) > 1:
            self._compare(task, robot, at, time_ns)

    def _leave(self, robot: str) -> None:
        task = self._task_of.pop(robot, "")
        robots = self._at.get(task)
        if robots is None:
            return
        robots.pop(robot, None)
        if not robots:
            del self._at[task]
            self._reported = {told for told in self._reported if told[0] != task}

    def _compare(self, task: str, robot: str, at: _At, time_ns: int) -> None:
        for other, mate in self._at[task].items():
            if other == robot or time_ns - mate.last_ns > SILENT_NS:
                continue
            both_ns = time_ns - max(at.since_ns, mate.since_ns)
            one, two = sorted((robot, other))
            if both_ns <= BOTH_NS or (task, one, two) in self._reported:
                continue
            self._reported.add((task, one, two))
            epochs = (self._at[task][one].epoch, self._at[task][two].epoch)
            for_s = round(to_seconds(both_ns), 3)
            self.break_(time_ns, TaskAtTwo(task=task, robots=(one, two), epochs=epochs, for_s=for_s))
