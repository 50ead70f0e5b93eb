"""Whether a robot has heard of all changes of tasks; what it has missed it asks the coordinator for.

The coordinator numbers the changes without gaps, and its summary has the last number. A robot that began later, or lost
an event, asks for the open tasks: else it would know less than the coordinator has published, and might do a task again
once it works without one.
"""

from robrain.agent.consensus.known_tasks import TASKS_MAX, KnownTasks
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.answers.later import Later
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.errors import CallError, NobodyThere
from robrain.protocol.wire.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.wire.messages.tasks.task_messages import TaskFilter, TaskRecord
from robrain.protocol.wire.topics import TASK_LIST

GRACE_NS = to_ns(0.3)
"""An event may be under way for so long after the summary that counts it (chosen)."""
AGAIN_NS = to_ns(1.0)
"""A request is repeated after this (chosen)."""
TIMEOUT_S = 2.0
AHEAD_MAX = 1024
"""Numbers remembered that came before those that precede them."""
OPEN = [state for state in TaskState if not state.ended]


class TaskLook:
    """Keeps a robot's known tasks complete while a coordinator is heard.

    Args:
        wire: the robot's Zenoh endpoint.
        known: the tasks that it knows.

    """

    def __init__(self, wire: Endpoint, known: KnownTasks) -> None:
        self.behind_since_ns: int | None = None
        """When it was noticed that a change was not heard of; None if all were."""
        self.last = 0
        """All changes up to this number were heard of."""
        self._wire, self._known = wire, known
        self._said = 0
        self._ahead: set[int] = set()
        self._asked: Later[list[TaskRecord]] | None = None
        self._asked_ns = self._due_ns = self._said_then = 0

    def hear(self, event: TaskEvent, now_ns: int) -> None:
        """Take in a change."""
        if event.change > self.last and len(self._ahead) < AHEAD_MAX:
            self._ahead.add(event.change)
            self._count()
        self._note(max(event.change, self._said), now_ns)

    def hear_summary(self, last_change: int, now_ns: int) -> None:
        """Take in the number of the last change; a smaller one than before is that of another journal."""
        if last_change < self._said:
            self.last = 0
            self._ahead.clear()
        self._said = last_change
        self._note(last_change, now_ns)

    def step(self, now_ns: int) -> None:
        """Ask for what is missing, and take it in."""
        if self._asked is None:
            if self.behind_since_ns is None or now_ns < max(self._due_ns, self.behind_since_ns + GRACE_NS):
                return
            self._asked_ns, self._due_ns, self._said_then = now_ns, now_ns + AGAIN_NS, self._said
            wanted = TaskFilter(states=OPEN, limit=TASKS_MAX)
            self._asked = self._wire.ask_later(TASK_LIST, wanted, timeout_s=TIMEOUT_S)
        try:
            records = self._asked.take()
        except (CallError, NobodyThere):
            self._asked = None
            return
        if records is None:
            return
        self._asked = None
        self._known.take_open([record.event for record in records], self._asked_ns, now_ns)
        self.last = max(self.last, self._said_then)
        self._count()
        self._note(self._said, now_ns)

    def _count(self) -> None:
        while self.last + 1 in self._ahead:
            self.last += 1
        self._ahead = {number for number in self._ahead if number > self.last}

    def _note(self, last_change: int, now_ns: int) -> None:
        if last_change <= self.last:
            self.behind_since_ns = None
        elif self.behind_since_ns is None:
            self.behind_since_ns = now_ns
