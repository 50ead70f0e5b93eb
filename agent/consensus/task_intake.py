"""Tasks that are submitted to a robot, or cancelled at it, because there is no coordinator.

The robot reports to the others in its ballots. The client repeats the request until more than half of the team knows of
it: then some robot of any group that allocates tasks does.
"""

from collections.abc import Mapping, Sequence, Set

import msgspec

from robrain.agent.consensus.known_tasks import OWN_KINDS, KnownTasks
from robrain.agent.robot_tasks import RobotTasks
from robrain.protocol.clock import to_seconds
from robrain.protocol.errors import BadName, CallError, ErrorCode
from robrain.protocol.keys import check_name
from robrain.protocol.messages.tasks.consensus_messages import (
    ASKED_BYTES_MAX,
    ASKED_REPORTED,
    CANCELLED_MAX,
    CANCELLED_TEXT_MAX,
    CancelAcceptance,
    TaskAcceptance,
    TaskAsked,
    TaskDropped,
    TaskKnown,
)
from robrain.protocol.messages.tasks.task_messages import TaskRequest, TaskSubmission
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.stock_kinds import check_parameters
from robrain.protocol.model.tasks.task import BadParameters, Task

Known = Mapping[str, Sequence[TaskKnown]]
"""Tasks that each of the other robots has reported as its own."""


Dropped = Mapping[str, Set[str]]
"""Ids of the tasks that each of the other robots has reported as cancelled."""


class TaskIntake:
    """Accepts tasks, and knows which robots have them.

    Args:
        robot: the robot's name.
        known: the tasks that it knows.
        desk: of its behaviors.

    """

    def __init__(self, robot: str, known: KnownTasks, desk: RobotTasks) -> None:
        self._robot, self._known, self._desk = robot, known, desk
        self._reported = 0

    def accept(self, asked: TaskSubmission, now_ns: int, teammates: Known, team: int) -> TaskAcceptance:
        """Accept a task, and report which robots have it.

        Args:
            asked: the submission; the same as before changes nothing.
            now_ns: the time.
            teammates: the others' tasks.
            team: number of robots of the team.

        Raises:
            CallError: it is refused, in words.

        """
        task_id = asked.task.id
        if task_id in self._known.dropped:
            raise CallError(ErrorCode.REFUSED, f"task {task_id} is refused: it was cancelled", "it was cancelled")
        before = self._known.asked.get(task_id)
        if before is None:
            self._check(asked, now_ns)
            before = TaskAsked(submission=asked, at_ns=now_ns)
            self._known.ask(before)
        elif differs := asked.differs_from(before.submission.word):
            raise CallError(ErrorCode.REFUSED, f"there is another task {task_id}: {differs}", differs)
        name = TaskKnown(id=task_id, at_ns=before.at_ns)
        known_to = sorted([self._robot, *(teammate for teammate, known in teammates.items() if name in known)])
        task = before.submission.task_at(before.at_ns)
        return TaskAcceptance(task=task, known_to=known_to, is_kept=2 * len(known_to) > team)

    def drop(self, asked: TaskRequest, teammates: Dropped, team: int, holder: str = "") -> CancelAcceptance:
        """Accept a cancellation, and report which robots know of it.

        Args:
            asked: which task; the same again changes nothing.
            teammates: the cancellations that the others know.
            team: number of robots of the team.
            holder: the robot that has the task; if it is reachable it must know too, as it may just have done it.

        Raises:
            CallError: it is refused, in words.

        """
        known = self._known
        found = known.open.get(asked.id)
        if found is None:
            raise CallError(ErrorCode.REFUSED, f"{self._robot} knows of no open task {asked.id}")
        if known.is_done(asked.id):
            raise CallError(ErrorCode.REFUSED, f"task {asked.id} has ended already: it is done", "done")
        if asked.id not in known.dropped:
            if len(known.dropped) >= CANCELLED_MAX:
                reason = "robots remember no more cancellations until a coordinator records them"
                raise CallError(ErrorCode.REFUSED, f"task {asked.id} is not cancelled: {reason}", reason)
            by, reason = cut(asked.by, CANCELLED_TEXT_MAX), cut(asked.why, CANCELLED_TEXT_MAX)
            known.drop([TaskDropped(id=asked.id, by=by, why=reason)])
        known_to = sorted([self._robot, *(teammate for teammate, dropped in teammates.items() if asked.id in dropped)])
        is_kept = 2 * len(known_to) > team and (holder not in teammates or holder in known_to)
        return CancelAcceptance(task=found.task, known_to=known_to, is_kept=is_kept)

    def to_report(self, teammates: Known, *, everything: bool) -> list[TaskAsked]:
        """The tasks to report in full in the next ballot: those that some robot has not, or all, some at a time."""
        asked = self._known.asked
        if not asked:
            return []
        there = [{(one.id, one.at_ns) for one in known} for known in teammates.values()]
        missing = [
            one
            for task_id, one in asked.items()
            if everything or not all((task_id, one.at_ns) in known for known in there)
        ]
        begin = self._reported % len(missing) if missing else 0
        self._reported = begin + ASKED_REPORTED
        return [*missing[begin:], *missing[:begin]][:ASKED_REPORTED]

    def _check(self, asked: TaskSubmission, now_ns: int) -> None:
        task_id = asked.task.id
        try:
            check_name("task", task_id)
            task = asked.task_at(now_ns)
            check_parameters(task)
        except (ValueError, BadName, BadParameters, msgspec.ValidationError) as error:
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"task {task_id}: {error}") from error
        if len(asked.word) > ASKED_BYTES_MAX:
            text = f"task {task_id}: expected at most {ASKED_BYTES_MAX} bytes of JSON, got {len(asked.word)}"
            raise CallError(ErrorCode.BAD_ARGUMENTS, text)
        if reason := self._refusal(task, now_ns):
            raise CallError(ErrorCode.REFUSED, f"task {task_id} is refused: {reason}", reason)

    def _refusal(self, task: Task, now_ns: int) -> str:
        if task.id in self._known.open:
            return "there is a task of that name"
        if self._known.has_ended(task.id):
            return "there was a task of that name"
        if task.kind in OWN_KINDS:
            return f"only a coordinator makes tasks to {task.kind}"
        if task.robots > 1:
            return f"it takes {task.robots} robots at a time, which only a coordinator brings together"
        if not self._desk.has_behavior(task.kind):
            return f"{self._robot} has no behavior for tasks to {task.kind}"
        if task.deadline_ns is not None and task.deadline_ns <= now_ns:
            return f"its deadline was {to_seconds(now_ns - task.deadline_ns):.1f} s ago"
        if not self._known.may_be_asked:
            return "robots remember no more tasks until a coordinator records them"
        return ""
