"""Tasks that other robots do, hold or are about to begin, by their last reports: a cut-off robot continues them."""

from collections.abc import Container

from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.tasks.consensus_messages import ABSENT_MAX, TaskHeldBy, TeamBallot

GOES_ON_S = 120.0
"""Time for which a robot continues its work while it receives neither a coordinator nor half of the team. Its tasks are
assigned to others 2 s later."""
GIVEN_UP_NS = to_ns(GOES_ON_S + 2.0)
"""Silence after which a robot has released its tasks."""
HOLDERS_MAX = 1024
"""Tasks whose holders are remembered (chosen: four times the open tasks that a robot knows)."""


class Holders:
    """Holder of each task, and the end of its hold.

    Args:
        robot: owner of the memory; it knows its own tasks itself.

    """

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._until: dict[str, tuple[str, int]] = {}
        """By task: its holder, and the time at which that robot has released it if it stays silent."""

    def receive(self, report: TeamBallot, present: Container[str], now_ns: int) -> bool:
        """Record a robot's report on itself, and on robots that this one does not receive; whether a task is new.

        Args:
            report: the robot's ballot.
            present: robots that speak for themselves.
            now_ns: the time.

        """
        before = self._until
        mine = {held.id for held in report.held} | ({report.wants} if report.wants else set())
        self._until = {task: one for task, one in before.items() if one[0] != report.robot and one[1] > now_ns}
        for task in mine:
            self._record(task, report.robot, now_ns + GIVEN_UP_NS)
        for other in report.absent:
            if other.robot not in (self._robot, report.robot) and other.robot not in present:
                self._record(other.id, other.robot, now_ns + min(to_ns(other.remaining_s), GIVEN_UP_NS))
        return not self._until.keys() <= before.keys()

    def of(self, task_id: str, now_ns: int) -> str:
        """Holder of a task; empty if none is known."""
        robot, until_ns = self._until.get(task_id, ("", now_ns))
        return robot if until_ns > now_ns else ""

    def to_report(self, present: Container[str], now_ns: int) -> list[TaskHeldBy]:
        """The tasks of robots that are not there to report them."""
        reported = [
            TaskHeldBy(id=task, robot=robot, remaining_s=to_seconds(until_ns - now_ns))
            for task, (robot, until_ns) in sorted(self._until.items())
            if robot not in present and until_ns > now_ns
        ]
        return reported[:ABSENT_MAX]

    def _record(self, task: str, robot: str, until_ns: int) -> None:
        known = self._until.get(task)
        if known is None and len(self._until) >= HOLDERS_MAX:
            return
        if known is None or until_ns > known[1]:
            self._until[task] = (robot, until_ns)
