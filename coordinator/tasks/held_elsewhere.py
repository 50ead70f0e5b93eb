"""Queued tasks that a robot may be at which the coordinator does not hear: others say that it began without one."""

from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.team.roster import Roster
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.messages.tasks.consensus_messages import TeamBallot


class HeldElsewhere:
    """Who may be at which queued task, and until when.

    Args:
        book: of the tasks.
        roster: the robots of the team.

    """

    def __init__(self, book: TaskBook, roster: Roster) -> None:
        self._book, self._roster = book, roster
        self._until: dict[str, tuple[str, int]] = {}

    def hear(self, said: TeamBallot, now_ns: int) -> None:
        """Take in what a robot says of itself and of others."""
        self._until = {task: one for task, one in self._until.items() if one[0] != said.robot and one[1] > now_ns}
        for other in said.absent:
            record, known = self._book.find(other.id), self._until.get(other.id)
            until_ns = now_ns + to_ns(other.left_s)
            is_queued = record is not None and record.state is TaskState.QUEUED
            if is_queued and other.robot != said.robot and (known is None or known[1] < until_ns):
                self._until[other.id] = (other.robot, until_ns)

    def by(self, task_id: str, now_ns: int) -> str:
        """The robot that may be at a task; empty if there is none. One that is heard says itself what it is at."""
        robot, until_ns = self._until.get(task_id, ("", now_ns))
        known = self._roster.robots.get(robot)
        if until_ns <= now_ns or known is None or known.state is None or not known.is_up(now_ns):
            return robot if until_ns > now_ns else ""
        statuses = (known.state.task, known.state.next_task)
        return robot if any(one is not None and one.id == task_id for one in statuses) else ""
