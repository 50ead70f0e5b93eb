"""No task is at two robots for longer than a lease.

A task for several robots has a part for each, with an id of its own; so each id belongs to one robot at a time.
"""

from collections.abc import Mapping

from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.model.tasks.task import FREE_AFTER_S, TaskState
from robrain.recording.invariants.findings import Invariant, MissingEvidence, TaskAtTwo
from robrain.recording.invariants.invariant_judge import Handler, InvariantJudge, Surroundings

BOTH_NS = to_ns(FREE_AFTER_S)
"""For as long two robots may be at a task: the lease and its guard time."""
SILENT_NS = to_ns(1.0)
"""A robot that says nothing for this long is not counted as being at its task; its time starts again."""


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
        self._told: set[tuple[str, str, str]] = set()
        self._has_received = False

    def handlers(self) -> Mapping[type, Handler]:
        """What is to be called with each type of message."""
        return {RobotState: self._handle_state}

    def lacks(self) -> MissingEvidence | None:
        """What the messages lacked."""
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
            self._told = {told for told in self._told if told[0] != task}

    def _compare(self, task: str, robot: str, at: _At, time_ns: int) -> None:
        for other, mate in self._at[task].items():
            if other == robot or time_ns - mate.last_ns > SILENT_NS:
                continue
            both_ns = time_ns - max(at.since_ns, mate.since_ns)
            one, two = sorted((robot, other))
            if both_ns <= BOTH_NS or (task, one, two) in self._told:
                continue
            self._told.add((task, one, two))
            epochs = (self._at[task][one].epoch, self._at[task][two].epoch)
            for_s = round(to_seconds(both_ns), 3)
            self.break_(time_ns, TaskAtTwo(task=task, robots=(one, two), epochs=epochs, for_s=for_s))
