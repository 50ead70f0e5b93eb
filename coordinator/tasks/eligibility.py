"""Which tasks may be offered now, and to which robots."""

from typing import Protocol

from robrain.coordinator.tasks.admission import capability_refusal, needed_plugins
from robrain.coordinator.tasks.backoff import TaskBackoff
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.team.capabilities import Capabilities
from robrain.coordinator.team.roster import Robot, Roster
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.tasks.consensus_messages import TeamBallot
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.reasons import (
    OfferRefusal,
    PlainReason,
    RobotOut,
    RobotReason,
    TaskReason,
    halted,
    holder_out,
    lacks_plugins,
    plain,
)

REPORTED_MAX = 8
"""Most robots that a reason names."""
NOBODY_THERE = plain("nobody_there", "no robot is there")


class TaskGate(Protocol):
    """Parts that may hold offers back; refusals are reported to them."""

    def offer_refusal(self) -> TaskReason | None:
        """Why no task is offered at all; None if tasks are."""

    def task_refused(self, record: TaskRecord, robot: str, refusal: OfferRefusal, now_ns: int) -> None:
        """A robot has refused one of the coordinator's own tasks."""


class HeldElsewhere:
    """Which robot may be doing which queued task, and until when.

    Args:
        book: of the tasks.
        roster: the robots of the team.

    """

    def __init__(self, book: TaskBook, roster: Roster) -> None:
        self._book, self._roster = book, roster
        self._until: dict[str, tuple[str, int]] = {}

    def receive(self, ballot: TeamBallot, now_ns: int) -> None:
        """Read a robot's reports on itself and on others."""
        self._until = {task: one for task, one in self._until.items() if one[0] != ballot.robot and one[1] > now_ns}
        for other in ballot.absent:
            record, known = self._book.find(other.id), self._until.get(other.id)
            until_ns = now_ns + to_ns(other.remaining_s)
            is_queued = record is not None and record.state is TaskState.QUEUED
            if is_queued and other.robot != ballot.robot and (known is None or known[1] < until_ns):
                self._until[other.id] = (other.robot, until_ns)

    def by(self, task_id: str, now_ns: int) -> str:
        """The robot that may be doing a task; empty if there is none. A robot in contact reports its task itself."""
        robot, until_ns = self._until.get(task_id, ("", now_ns))
        known = self._roster.robots.get(robot)
        if until_ns <= now_ns or known is None or known.state is None or not known.is_up(now_ns):
            return robot if until_ns > now_ns else ""
        statuses = (known.state.task, known.state.next_task)
        return robot if any(one is not None and one.id == task_id for one in statuses) else ""


class Eligibility:
    """Decides which tasks may be offered now, and which robots they exclude.

    Args:
        book: of the tasks.
        roster: the robots of the team.
        capabilities: plugins and kinds of task of the robots.
        backoff: tasks that robots refused or failed at, and until when they are not offered again.
        gate: parts that may hold offers back.

    """

    def __init__(
        self, book: TaskBook, roster: Roster, capabilities: Capabilities, backoff: TaskBackoff, gate: TaskGate
    ) -> None:
        self._book, self._roster, self._capabilities = book, roster, capabilities
        self._backoff = backoff
        self.offer_refusal = gate.offer_refusal
        """Why no task is offered at all; None if tasks are."""
        self.held_elsewhere = HeldElsewhere(book, roster)
        """Robots that may be doing queued tasks that no coordinator gave them."""

    def wait_reason(self, record: TaskRecord, now_ns: int, travel_s: float = 0.0) -> TaskReason | None:
        """Why a task cannot be offered to any robot yet; None if it can.

        Args:
            record: of the task.
            now_ns: the time.
            travel_s: travel time of its robot, which may set out before the task's earliest time.

        """
        task = record.task
        if record.state is not TaskState.QUEUED:
            return plain("is_state", f"it is {record.state}", state=record.state)
        if record.own:
            return plain("is_own", "it is one of the coordinator itself")
        if (refusal := self.offer_refusal()) is not None:
            return refusal
        if holder := self.held_elsewhere.by(task.id, now_ns):
            return holder_out(holder)
        if now_ns + to_ns(travel_s) < task.earliest_ns:
            in_s = to_seconds(task.earliest_ns - now_ns)
            return plain("not_before", f"it may begin in {in_s:.1f} s", in_s=in_s)
        for name in task.after:
            other = self._book.find(name)
            if other is None:
                return plain("after_unknown", f"{name}, which it waits for, is not known yet", task=name)
            if other.state is not TaskState.DONE:
                text = f"{name}, which it waits for, is {other.state}"
                return plain("after_open", text, task=name, state=other.state)
        return None

    def new_task_state(self, record: TaskRecord, now_ns: int) -> TaskReason | None:
        """Conditions for a task that is not in the book before any robot could begin it; None if there are none."""
        reason = self.wait_reason(record, now_ns) or self.nobody_can(record)
        return reason or (None if self._roster.up(now_ns) else NOBODY_THERE)

    def nobody_can(self, record: TaskRecord) -> TaskReason | None:
        """Why no robot of the team can do the task; None if one can, or may."""
        return capability_refusal(record.task, self._capabilities.plugins)

    def hopeless(self, record: TaskRecord, now_ns: int) -> PlainReason | None:
        """The answers of all present and able robots, if none of them will be asked again; else None.

        A task with a deadline is kept until then.
        """
        if record.task.deadline_ns is not None:
            return None
        outs = []
        for robot in self._roster.up(now_ns):
            if self.lacks(record, robot):
                continue
            reason = self._backoff.last_word(record.task.id, robot.name)
            if reason is None:
                return None
            outs.append(RobotOut(robot.name, reason))
        if not outs:
            return None
        listed, more = outs[:REPORTED_MAX], len(outs[REPORTED_MAX:])
        text = f"nobody does it: {'; '.join(map(str, listed))}{f' and {more} more' if more else ''}"
        return plain("nobody_does", text, robots=tuple(one.robot for one in listed), more=more)

    def refusal(self, record: TaskRecord, robot: Robot, now_ns: int) -> RobotReason | None:
        """Why a task is not offered to a robot; None if it may be."""
        if missing := self.lacks(record, robot):
            return lacks_plugins(missing)
        if (out := robot.down_reason(now_ns)) is not None:
            return out
        if robot.state is not None and robot.state.halted:
            return halted()
        if other := self._book.of_robot(robot.name):
            return plain("at_task", f"is at {other.task.id}", task=other.task.id)
        return self._backoff.pause_reason(record.task.id, robot.name, now_ns)

    def lacks(self, record: TaskRecord, robot: Robot) -> tuple[str, ...]:
        """Plugins that a task needs and a robot lacks."""
        plugins = self._capabilities.plugins.get(robot.name)
        return tuple(name for name in needed_plugins(record.task) if plugins is not None and name not in plugins)
