"""The task that a robot wants to begin: it begins it once more than half of the team is known to have heard so.

Any group that allocates tasks without a coordinator is more than half of the team, so one of it knows of each task that
was begun before, also by a robot that was cut off in the moment after.
"""

from collections.abc import Iterable, Set

from robrain.protocol.model.consensus.ballot import Heard

NUMBERS_MAX = 64
"""Ballots with the claim whose echo counts, the last ones (chosen: 6 s and more)."""


class TaskClaim:
    """One task at a time.

    Args:
        robot: who claims.

    """

    def __init__(self, robot: str) -> None:
        self.task = ""
        """Id of the task; empty if the robot wants to begin none."""
        self._robot = robot
        self._numbers: list[int] = []
        """Of this robot's ballots that told of the claim."""
        self._heard_by: set[str] = set()

    def want(self, task: str) -> bool:
        """Say which task the robot wants to begin; empty for none. Whether that is new and has to be told."""
        if task == self.task:
            return False
        self.task, self._numbers, self._heard_by = task, [], set()
        return bool(task)

    def note_sent(self, number: int) -> None:
        """A ballot with the claim was sent."""
        if self.task:
            self._numbers = [*self._numbers[1 - NUMBERS_MAX :], number]

    def note_echo(self, mate: str, heard: Iterable[Heard]) -> None:
        """A mate says whose ballots it has heard last."""
        if any(one.robot == self._robot and one.number in self._numbers for one in heard):
            self._heard_by.add(mate)

    def is_heard(self, mates: Set[str], team: int) -> bool:
        """Whether, with the robot itself, more than half of the team knows of the claim.

        Args:
            mates: the robots that are heard now.
            team: number of robots of the team.

        """
        return bool(self.task) and 2 * (1 + len(self._heard_by & mates)) > team
