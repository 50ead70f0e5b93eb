"""Invariants of tasks: none is lost, none is at two robots, none is done twice.

A task ends once, and no robot works on it afterwards. No two robots do it for longer than a lease.
"""

from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.tasks.task import FREE_AFTER_S, LOST_AFTER_S, MEMBER_PREFIX, TaskState
from robrain.recording.invariants.invariant import Invariant, InvariantJudge, MissingEvidence, Surroundings

LEASE_NS = to_ns(FREE_AFTER_S)
"""For this long two robots may be at a task, or a robot at a task that was done: the lease and its guard time."""
SILENT_NS = to_ns(1.0)
"""A robot that is silent for this long is not counted as being at its task; its time starts again."""

ENDED_KEPT = 100_000
"""Ended tasks that are remembered (chosen: some 20 MB)."""


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
        self.tasks = 0
        """Number of tasks in the messages."""
        self._last_change = 0

    def handle(self, event: TaskEvent, time_ns: int) -> bool:
        """The next event; returns whether it is a change of a task that had ended. Repeated changes have no effect."""
        ended = self.ended.get(event.task.id)
        known = ended[0] if ended is not None else self.open.get(event.task.id)
        if known is not None and not _is_later(event, known):
            return False
        self._count(event.change)
        self.tasks += known is None
        if ended is not None:
            if event.state.ended:
                self.ended[event.task.id] = event, ended[1]
            return True
        if event.state.ended:
            self.open.pop(event.task.id, None)
            self.ended[event.task.id] = event, time_ns
            if len(self.ended) > ENDED_KEPT:
                del self.ended[next(iter(self.ended))]
        else:
            self.open[event.task.id] = event
        return False

    def done_ns(self, task: str) -> int | None:
        """Time at which a task was done first; None if it was not."""
        ended = self.ended.get(task)
        return ended[1] if ended is not None and ended[0].state is TaskState.DONE else None

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


FORGOTTEN_AFTER_NS = to_ns(1.0)
"""A count that is too small for this long is not a change in transit (chosen: two summaries)."""
ABANDONED_AFTER_NS = to_ns(10.0)
"""A coordinator gives a task back after 2 s at the latest (chosen: five times that)."""
AWAY_AFTER_NS = to_ns(2.0)
"""A coordinator that is silent for this long is absent, and starts to listen again."""
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
        self._reported_missing = 0
        self._since_ns: dict[_Given, int] = {}
        """Since when a task has been at its robot without a report of it."""
        self._reported: set[_Given] = set()
        self._received_ns: dict[str, int] = {}

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing."""
        if self._summary_ns is None:
            return MissingEvidence.SUMMARIES
        if not self._is_complete:
            return MissingEvidence.START
        return MissingEvidence.EVENTS if self._changes.has_gap or self._may_lack else None

    @property
    def _is_complete(self) -> bool:
        """Whether all tasks that are open can be known."""
        return self._changes.is_from_start or bool(self._begins_empty)

    def handle_event(self, event: TaskEvent, time_ns: int) -> None:
        """Follow the changes of tasks."""
        self._changes.handle(event, time_ns)
        self._may_lack = False  # the number of this one shows it
        self.cases = self._changes.tasks
        self._changed_ns[event.task.id] = time_ns
        if event.state.ended:
            self._changed_ns.pop(event.task.id)

    def handle_state(self, state: RobotState, time_ns: int) -> None:
        """Record the robot's report of its tasks."""
        self._received_ns[state.robot] = time_ns
        for status in (state.task, state.next_task, state.task_before):
            if status is not None and not status.state.ended:
                given = (status.id, state.robot, status.epoch)
                if given in self._since_ns:
                    self._since_ns[given] = time_ns

    def handle_summary(self, summary: TeamState, time_ns: int) -> None:
        """Compare the number of open tasks, and find tasks that no robot has."""
        if self._begins_empty is None:
            self._begins_empty = summary.tasks_open == 0 and self._changes.tasks == 0
        if self._summary_ns is None or time_ns - self._summary_ns > AWAY_AFTER_NS:
            self._since_ns.clear()
        self._summary_ns = time_ns
        self._may_lack |= self._summary_seq is not None and summary.seq not in (self._summary_seq + 1, 0)
        self._summary_seq = summary.seq
        if self._changes.has_gap or self._may_lack:  # open tasks, and their robots, are unknown
            self._since_ns.clear()
            return
        if summary.unwritable:  # it must not change tasks that it cannot write
            self._since_ns.clear()
        if self._is_complete:
            self._compare_counts(summary, time_ns)
        self._find_abandoned(summary, time_ns)

    def _compare_counts(self, summary: TeamState, time_ns: int) -> None:
        missing = len(self._changes.open) - summary.tasks_open
        if missing <= self._reported_missing:
            self._reported_missing = max(0, missing)
            self._too_few, self._agreed_ns = None, time_ns
            return
        if self._too_few is None or self._too_few[0] != missing:
            self._too_few = missing, time_ns
        if time_ns - self._too_few[1] < FORGOTTEN_AFTER_NS:
            return
        lost = missing - self._reported_missing
        candidates = self._candidates(lost)
        tasks = candidates[:NAMED_MAX]
        names = ", ".join(tasks) + (" …" if len(candidates) > NAMED_MAX else "")
        which = names if len(candidates) == lost else f"{lost} of {names}"
        text = f"the coordinator no longer knows {which}, which {'has' if lost == 1 else 'have'} not ended"
        self.break_(time_ns, "tasks_forgotten", text, {"missing": lost, "tasks": tasks, "of": len(candidates)})
        self._reported_missing, self._too_few, self._agreed_ns = missing, None, time_ns

    def _candidates(self, missing: int) -> list[str]:
        """Open tasks that the coordinator may have lost: those that changed since its count was right, if enough."""
        latest = sorted(self._changes.open, key=lambda task: -self._changed_ns.get(task, 0))
        lately = [task for task in latest if self._changed_ns.get(task, 0) >= self._agreed_ns]
        return lately if len(lately) >= missing else latest

    def _find_abandoned(self, summary: TeamState, time_ns: int) -> None:
        up = {robot.name for robot in summary.robots if robot.up}
        since: dict[_Given, int] = {}
        for task, event in self._changes.open.items():
            robot = event.robot
            if not robot or robot.startswith(MEMBER_PREFIX) or event.state is TaskState.QUEUED:
                continue
            given = (task, robot, event.epoch)
            since[given] = self._since_ns.get(given, time_ns)
            silent_ns = time_ns - self._received_ns.get(robot, self._start_ns)
            if robot in up and silent_ns > to_ns(LOST_AFTER_S):
                since[given] = time_ns  # the coordinator receives a robot whose messages are missing here
            elif time_ns - since[given] > ABANDONED_AFTER_NS and given not in self._reported:
                self._reported.add(given)
                for_s = round(to_seconds(time_ns - since[given]), 3)
                text = f"{task} is still {event.state} at {robot}, which has not reported it for {for_s:.1f} s"
                values = {"task": task, "robot": robot, "state": event.state, "for_s": for_s}
                self.break_(time_ns, "task_abandoned", text, values)
        self._since_ns = since
        self._reported &= since.keys()


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

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing."""
        if self._changes.has_gap:
            return MissingEvidence.EVENTS
        return None if self._has_received or self._changes.tasks else MissingEvidence.TASKS

    def handle_event(self, event: TaskEvent, time_ns: int) -> None:
        """Judge a change of a task that had ended."""
        task = event.task.id
        before = self._changes.ended.get(task)
        if not self._changes.handle(event, time_ns):
            self.cases += event.state is TaskState.DONE and before is None
            return
        assert before is not None  # it had ended
        ended, ended_ns = before
        was_reopened = task in self._reopened
        (self._reopened.discard if event.state.ended else self._reopened.add)(task)
        if event.state is TaskState.DONE and ended.state is TaskState.DONE:
            changes, first_s = (ended.change, event.change), self.time_s(ended_ns)
            by = f", by {event.robot}" if event.robot else ""
            again = f"{task} is done again{by} (change {event.change})"
            text = f"{again}, after it was done at {first_s:g} s (change {ended.change})"
            values = {"task": task, "robot": event.robot, "changes": changes, "first_s": first_s}
            self.break_(time_ns, "done_again", text, values)
        elif not was_reopened:
            text = f"{task} becomes {event.state}, after it had ended as {ended.state}"
            self.break_(time_ns, "reopened", text, {"task": task, "ended": ended.state, "state": event.state})

    def handle_state(self, state: RobotState, time_ns: int) -> None:
        """Judge whether the robot works on a task that was done."""
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
        if for_ns > LEASE_NS and not still.is_reported:
            still.is_reported = True
            done_s, for_s = self.time_s(done_ns), round(to_seconds(for_ns), 3)
            text = f"{robot} has been at {at} for {for_s:.1f} s, although it was done at {done_s:g} s"
            self.break_(time_ns, "still_at_done", text, {"task": at, "robot": robot, "done_s": done_s, "for_s": for_s})


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

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing."""
        return None if self._has_received else MissingEvidence.ROBOTS

    def handle_state(self, state: RobotState, time_ns: int) -> None:
        """Judge whether another robot is at the same task."""
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
            self._reported = {pair for pair in self._reported if pair[0] != task}

    def _compare(self, task: str, robot: str, at: _At, time_ns: int) -> None:
        for other, other_at in self._at[task].items():
            if other == robot or time_ns - other_at.last_ns > SILENT_NS:
                continue
            both_ns = time_ns - max(at.since_ns, other_at.since_ns)
            one, two = sorted((robot, other))
            if both_ns <= LEASE_NS or (task, one, two) in self._reported:
                continue
            self._reported.add((task, one, two))
            epochs = (self._at[task][one].epoch, self._at[task][two].epoch)
            for_s = round(to_seconds(both_ns), 3)
            robots = f"{one} (epoch {epochs[0]}) and {two} (epoch {epochs[1]})"
            text = f"{robots} have both been at {task} for {for_s:.1f} s"
            values = {"task": task, "robots": (one, two), "epochs": epochs, "for_s": for_s}
            self.break_(time_ns, "task_at_two", text, values)
