"""No task is done twice: it ends once, and no robot works on it when it was done."""

from collections.abc import Mapping

from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.model.tasks.task import FREE_AFTER_S, TaskState
from robrain.recording.invariants.findings import DoneAgain, Invariant, MissingEvidence, Reopened, StillAtDone
from robrain.recording.invariants.invariant_judge import Handler, InvariantJudge, Surroundings
from robrain.recording.invariants.task_changes import ChangeKind, TaskChanges

STILL_AT_NS = to_ns(FREE_AFTER_S)
"""For as long a robot may go on with a task that was done: until it hears of it, or its lease ends."""
SILENT_NS = to_ns(1.0)


class _StillAt:
    """A robot at a task that was done."""

    __slots__ = ("is_told", "last_ns", "since_ns", "task")

    def __init__(self, task: str, now_ns: int) -> None:
        self.task = task
        self.since_ns = self.last_ns = now_ns
        self.is_told = False


class TaskOnce(InvariantJudge):
    """Counts the ends of tasks, by the numbers of the changes, and follows what robots do after."""

    invariant = Invariant.TASK_ONCE

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._changes = TaskChanges()
        self._still: dict[str, _StillAt] = {}
        self._has_received = False
        self._reopened: set[str] = set()

    def handlers(self) -> Mapping[type, Handler]:
        """What is to be called with each type of message."""
        return {TaskEvent: self._handle_event, RobotState: self._handle_state}

    def lacks(self) -> MissingEvidence | None:
        """What the messages lacked."""
        if self._changes.has_gap:
            return MissingEvidence.EVENTS
        return None if self._has_received or self._changes.tasks else MissingEvidence.TASKS

    def _handle_event(self, event: TaskEvent, time_ns: int) -> None:
        task = event.task.id
        before = self._changes.ended.get(task)
        if self._changes.take(event, time_ns) is not ChangeKind.AFTER_END:
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
        if for_ns > STILL_AT_NS and not still.is_told:
            still.is_told = True
            for_s = round(to_seconds(for_ns), 3)
            self.break_(time_ns, StillAtDone(task=at, robot=robot, done_s=self.time_s(done_ns), for_s=for_s))
