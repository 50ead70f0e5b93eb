"""The changes of tasks as they were made: without repeats and late copies, and whether some are missing."""

from enum import Enum, auto

from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.model.tasks.task import TaskState

ENDED_KEPT = 100_000
"""Ended tasks that are remembered (chosen: some 20 MB)."""


class ChangeKind(Enum):
    """What an event is."""

    NEWS = auto()
    """A change of a task that has not ended, or is new."""
    AFTER_END = auto()
    """A change of a task that had ended."""
    REPEAT = auto()
    """A change that was told before, or one before it."""


class TaskChanges:
    """Follows `task/event`.

    The coordinator numbers its changes without gaps, repeats the last ones after a restart, and starts again at 1 with
    an empty journal.
    """

    def __init__(self) -> None:
        self.open: dict[str, TaskEvent] = {}
        """The last change of each task that has not ended."""
        self.ended: dict[str, tuple[TaskEvent, int]] = {}
        """How tasks ended first, and when that was recorded, ns; the oldest are forgotten."""
        self.is_from_start = False
        """Whether the first change of all was heard."""
        self.has_gap = False
        """Whether changes in between were not heard."""
        self._last_change = 0
        self._tasks = 0

    @property
    def tasks(self) -> int:
        """Tasks heard of."""
        return self._tasks

    def take(self, event: TaskEvent, time_ns: int) -> ChangeKind:
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
        """When a task was done first; None if it was not."""
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
