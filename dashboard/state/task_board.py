"""The known tasks of the team: open ones, ended ones, and the times in which robots worked on them."""

from collections import deque
from dataclasses import dataclass, field

from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.plan_messages import TaskEstimates
from robrain.protocol.model.tasks.task import TaskState

OPEN_TASKS = 1000
ENDED_TASKS = 200
SPANS = 60
"""Number of spans that are kept for each robot."""


@dataclass
class Span:
    """A time in which a robot worked on a task, run's clock."""

    task: str
    kind: str
    start_ns: int
    end_ns: int | None = None
    state: TaskState = TaskState.RUNNING


@dataclass
class TaskBoard:
    """Tracks tasks by their events; all its memory is bounded."""

    open: dict[str, TaskEvent] = field(default_factory=dict)
    """The last event of every task that has not ended, oldest change first."""
    ended: deque[TaskEvent] = field(default_factory=lambda: deque(maxlen=ENDED_TASKS))
    """The last event of the tasks that have ended, oldest first."""
    spans: dict[str, deque[Span]] = field(default_factory=dict)
    """By robot."""
    estimates: TaskEstimates = field(default_factory=TaskEstimates)
    """The last estimates of the open tasks."""
    newest_ns: int = 0
    """The latest stamp of all events."""
    _running: dict[str, tuple[str, Span]] = field(default_factory=dict)

    def handle(self, event: TaskEvent) -> None:
        """Process an event; a repeated one changes nothing."""
        task = event.task.id
        known = self.open.pop(task, None)
        if event.state.ended:
            if any(other.task.id == task and other.change == event.change for other in self.ended):
                return
            self.ended.append(event)
        elif known is not None and known.change > event.change > 0:
            self.open[task] = known
            return
        else:
            self.open[task] = event
            while len(self.open) > OPEN_TASKS:
                del self.open[next(iter(self.open))]
        self.newest_ns = max(self.newest_ns, event.stamp_ns)
        self._follow(event)

    def _follow(self, event: TaskEvent) -> None:
        task, running = event.task.id, event.state in (TaskState.RUNNING, TaskState.LOST_CONTACT)
        robot, span = self._running.get(task, ("", None))
        if span is not None and not (running and robot == event.robot):
            span.end_ns, span.state = event.stamp_ns, event.state
            del self._running[task]
            span = None
        if not running or not event.robot:
            return
        if span is None:
            span = Span(task, event.task.kind, event.stamp_ns)
            self._running[task] = event.robot, span
            self.spans.setdefault(event.robot, deque(maxlen=SPANS)).append(span)
        span.state = event.state
