"""The known tasks of the team: open ones, ended ones, and the times in which robots worked on them."""

from collections import deque
from dataclasses import dataclass, field

from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.plan_messages import TaskDecision
from robrain.protocol.model.tasks.task import TaskState

OPEN_TASKS = 1000
ENDED_TASKS = 200
PLANNED_S = 20.0
"""Drawn length of a planned task whose duration is not known."""
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
    decisions: dict[str, TaskDecision] = field(default_factory=dict)
    """The last decision of the plan on each task, the oldest first."""
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
            self.decisions.pop(task, None)
        elif known is not None and known.change > event.change > 0:
            self.open[task] = known
            return
        else:
            self.open[task] = event
            while len(self.open) > OPEN_TASKS:
                del self.open[next(iter(self.open))]
        self.newest_ns = max(self.newest_ns, event.stamp_ns)
        self._follow(event)

    def decide(self, decision: TaskDecision) -> None:
        """Process a plan's decision on a task."""
        self.decisions.pop(decision.task, None)
        self.decisions[decision.task] = decision
        while len(self.decisions) > OPEN_TASKS:
            del self.decisions[next(iter(self.decisions))]

    def planned(self) -> dict[str, list[Span]]:
        """The planned tasks of each robot that have not begun, with the times of the plan."""
        found: dict[str, list[Span]] = {}
        for task, decision in self.decisions.items():
            event = self.open.get(task)
            if event is None or task in self._running or decision.start_in_s is None:
                continue
            start_ns = decision.stamp_ns + round(decision.start_in_s * 1e9)
            for robot in decision.robots:
                time_s = next((bid.time_s for bid in decision.bids if bid.robot == robot), None) or PLANNED_S
                span = Span(task, event.task.kind, start_ns, start_ns + round(time_s * 1e9), event.state)
                found.setdefault(robot, []).append(span)
        return found

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
