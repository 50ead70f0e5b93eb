"""No task is lost: each that was accepted ends, or is still known to the coordinator, at a robot that has it.

Two things are judged whenever the coordinator says how many tasks are open:

- It counts as many as there are by the changes that it has published.
- A task that stands at a robot is reported by that robot, or is given back.
"""

from collections.abc import Mapping

from robrain.coordinator.motes.mote_registry import MEMBER_PREFIX
from robrain.coordinator.recording.invariants.findings import Invariant, Missing, TaskAbandoned, TasksForgotten
from robrain.coordinator.recording.invariants.invariant_judge import Handler, InvariantJudge, Surroundings
from robrain.coordinator.recording.invariants.task_changes import TaskChanges
from robrain.coordinator.team.roster import LOST_AFTER_S
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.clock import to_ns, to_seconds
from robrain.protocol.wire.messages.robots.robot_messages import RobotState
from robrain.protocol.wire.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.wire.messages.team.team_messages import TeamState

FORGOTTEN_AFTER_NS = to_ns(1.0)
"""A count that is too small for this long is no change on its way (chosen: two summaries)."""
ABANDONED_AFTER_NS = to_ns(10.0)
"""A coordinator gives a task back after 2 s at the latest (chosen: five times that)."""
AWAY_AFTER_NS = to_ns(2.0)
"""A coordinator that is silent for this long is not there, and begins to listen anew."""
NAMED_MAX = 5

_Given = tuple[str, str, int]
"""Task, robot and epoch."""


class TaskKept(InvariantJudge):
    """Compares the coordinator's counts with its changes, and the robots' reports with both."""

    invariant = Invariant.TASK_KEPT

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._changes = TaskChanges()
        self._changed_ns: dict[str, int] = {}
        self._begins_empty: bool | None = None
        self._summary_ns: int | None = None
        self._summary_seq: int | None = None
        self._may_lack = False
        """Whether summaries are missing since the last change, so that changes may be as well."""
        self._too_few: tuple[int, int] | None = None
        """Tasks that are missing, and since when."""
        self._agreed_ns = start_ns
        self._told_missing = 0
        self._since_ns: dict[_Given, int] = {}
        """Since when a task has been at its robot without a report of it."""
        self._told: set[_Given] = set()
        self._heard_ns: dict[str, int] = {}

    def handlers(self) -> Mapping[type, Handler]:
        """What is to be called with each type of message."""
        return {TaskEvent: self._take_event, RobotState: self._take_state, TeamState: self._take_summary}

    def lacks(self) -> Missing | None:
        """What the messages lacked."""
        changes = self._changes
        if self._summary_ns is None:
            return Missing.SUMMARIES
        if not self._is_complete:
            return Missing.START
        return Missing.EVENTS if changes.has_gap or self._may_lack else None

    @property
    def _is_complete(self) -> bool:
        """Whether all tasks that are open can be known."""
        return self._changes.is_from_start or bool(self._begins_empty)

    def _take_event(self, event: TaskEvent, time_ns: int) -> None:
        self._changes.take(event, time_ns)
        self._may_lack = False  # the number of this one tells
        self.cases = self._changes.tasks
        self._changed_ns[event.task.id] = time_ns
        if event.state.ended:
            self._changed_ns.pop(event.task.id)

    def _take_state(self, state: RobotState, time_ns: int) -> None:
        self._heard_ns[state.robot] = time_ns
        for status in (state.task, state.next_task, state.task_before):
            if status is not None and not status.state.ended:
                given = (status.id, state.robot, status.epoch)
                if given in self._since_ns:
                    self._since_ns[given] = time_ns

    def _take_summary(self, summary: TeamState, time_ns: int) -> None:
        if self._begins_empty is None:
            self._begins_empty = summary.tasks_open == 0 and self._changes.tasks == 0
        if self._summary_ns is None or time_ns - self._summary_ns > AWAY_AFTER_NS:
            self._since_ns.clear()
        self._summary_ns = time_ns
        self._may_lack |= self._summary_seq is not None and summary.seq not in (self._summary_seq + 1, 0)
        self._summary_seq = summary.seq
        if self._changes.has_gap or self._may_lack:  # what is open, and at whom, is not known
            self._since_ns.clear()
            return
        if summary.unwritable:  # it may change nothing that it cannot write
            self._since_ns.clear()
        if self._is_complete:
            self._compare_counts(summary, time_ns)
        self._look_for_abandoned(summary, time_ns)

    def _compare_counts(self, summary: TeamState, time_ns: int) -> None:
        missing = len(self._changes.open) - summary.tasks_open
        if missing <= self._told_missing:
            self._told_missing = max(0, missing)
            self._too_few, self._agreed_ns = None, time_ns
            return
        if self._too_few is None or self._too_few[0] != missing:
            self._too_few = missing, time_ns
        if time_ns - self._too_few[1] < FORGOTTEN_AFTER_NS:
            return
        named = self._candidates(missing - self._told_missing)
        self.break_(
            time_ns,
            TasksForgotten(missing=missing - self._told_missing, tasks=tuple(named[:NAMED_MAX]), of=len(named)),
        )
        self._told_missing, self._too_few, self._agreed_ns = missing, None, time_ns

    def _candidates(self, missing: int) -> list[str]:
        """Open tasks that the coordinator may have lost: those that changed since its count was right, if enough."""
        latest = sorted(self._changes.open, key=lambda task: -self._changed_ns.get(task, 0))
        lately = [task for task in latest if self._changed_ns.get(task, 0) >= self._agreed_ns]
        return lately if len(lately) >= missing else latest

    def _look_for_abandoned(self, summary: TeamState, time_ns: int) -> None:
        up = {robot.name for robot in summary.robots if robot.up}
        since: dict[_Given, int] = {}
        for task, event in self._changes.open.items():
            robot = event.robot
            if not robot or robot.startswith(MEMBER_PREFIX) or event.state is TaskState.QUEUED:
                continue
            given = (task, robot, event.epoch)
            since[given] = self._since_ns.get(given, time_ns)
            silent_ns = time_ns - self._heard_ns.get(robot, self._start_ns)
            if robot in up and silent_ns > to_ns(LOST_AFTER_S):
                since[given] = time_ns  # the coordinator hears a robot that is not heard here
            elif time_ns - since[given] > ABANDONED_AFTER_NS and given not in self._told:
                self._told.add(given)
                for_s = round(to_seconds(time_ns - since[given]), 3)
                self.break_(time_ns, TaskAbandoned(task=task, robot=robot, state=event.state, for_s=for_s))
        self._since_ns = since
        self._told &= since.keys()
