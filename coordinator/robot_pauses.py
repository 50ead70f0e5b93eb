"""Robots that are left in peace for a while: those that cannot be asked, and those that refuse one thing after another.

A link that comes back brings a robot's token and states before its queryables. Without a pause each answer that nobody
is there would be followed at once by the next task of the coordinator's own.
"""

from typing import NamedTuple

from robrain.protocol.wire.clock import to_ns

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 8.0
"""Each pause is twice as long as the last (chosen)."""
REFUSALS_FREE = 3
"""So many frontiers may a robot refuse one after another before it pauses (chosen): the next one may be reachable."""


class _Pause(NamedTuple):
    until_ns: int
    pause_s: float
    why: str


class RobotPauses:
    """Remembers pauses, robot by robot."""

    def __init__(self) -> None:
        self._unreached: dict[str, _Pause] = {}
        self._tired: dict[str, _Pause] = {}
        self._refusals: dict[str, int] = {}

    def unreached(self, robot: str, why: str, now_ns: int) -> None:
        """An offer has not reached a robot."""
        _lengthen(self._unreached, robot, f"could not be asked: {why}", now_ns)

    def refused(self, robot: str, why: str, now_ns: int) -> None:
        """A robot has refused a task of the coordinator's own."""
        self._unreached.pop(robot, None)
        self._refusals[robot] = self._refusals.get(robot, 0) + 1
        if self._refusals[robot] > REFUSALS_FREE:
            _lengthen(self._tired, robot, f"refused {self._refusals[robot]} times: {why}", now_ns)

    def answered(self, robot: str) -> None:
        """A robot has refused a task that somebody asked for; it can be asked."""
        self._unreached.pop(robot, None)

    def accepted(self, robot: str) -> None:
        """A robot has accepted a task."""
        for kept in (self._unreached, self._tired, self._refusals):
            kept.pop(robot, None)

    def why_unreached(self, robot: str, now_ns: int) -> str:
        """Why a robot is not to be offered anything now; empty if it may be."""
        return _why(self._unreached, robot, now_ns)

    def why(self, robot: str, now_ns: int) -> str:
        """Why a robot is not to be offered a task of the coordinator's own now; empty if it may be."""
        return _why(self._unreached, robot, now_ns) or _why(self._tired, robot, now_ns)


def _lengthen(pauses: dict[str, _Pause], robot: str, why: str, now_ns: int) -> None:
    before = pauses.get(robot)
    pause_s = FIRST_PAUSE_S if before is None else min(2.0 * before.pause_s, LONGEST_PAUSE_S)
    pauses[robot] = _Pause(now_ns + to_ns(pause_s), pause_s, why)


def _why(pauses: dict[str, _Pause], robot: str, now_ns: int) -> str:
    pause = pauses.get(robot)
    return pause.why if pause is not None and now_ns < pause.until_ns else ""
