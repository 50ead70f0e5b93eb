"""Pauses for robots that cannot be reached, and for robots that keep refusing tasks.

When a link recovers, a robot's token and states arrive before its queryables. Without a pause, the coordinator would
follow each unanswered offer at once with another task of its own.
"""

from typing import NamedTuple

from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.reasons.offers import OfferRefusal
from robrain.protocol.wire.reasons.robots import RefusedOften, RobotReason, Unreachable

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 8.0
"""Each pause is twice as long as the one before (chosen)."""
REFUSALS_FREE = 3
"""Consecutive refusals of frontiers without a pause (chosen); the next frontier may be reachable."""


class _Pause(NamedTuple):
    until_ns: int
    pause_s: float
    reason: RobotReason


class RobotPauses:
    """Keeps the current pauses of each robot."""

    def __init__(self) -> None:
        self._unreached: dict[str, _Pause] = {}
        self._tired: dict[str, _Pause] = {}
        self._refusals: dict[str, int] = {}

    def unreached(self, robot: str, reason: Unreachable, now_ns: int) -> None:
        """Record that an offer did not reach a robot."""
        _lengthen(self._unreached, robot, reason, now_ns)

    def refused(self, robot: str, refusal: OfferRefusal, now_ns: int) -> None:
        """Record that a robot refused one of the coordinator's own tasks."""
        self._unreached.pop(robot, None)
        self._refusals[robot] = self._refusals.get(robot, 0) + 1
        if self._refusals[robot] > REFUSALS_FREE:
            _lengthen(self._tired, robot, RefusedOften(self._refusals[robot], refusal), now_ns)

    def answered(self, robot: str) -> None:
        """Record that a robot refused a submitted task: it can be reached."""
        self._unreached.pop(robot, None)

    def accepted(self, robot: str) -> None:
        """Record that a robot accepted a task; this ends its pauses."""
        for kept in (self._unreached, self._tired, self._refusals):
            kept.pop(robot, None)

    def why_unreached(self, robot: str, now_ns: int) -> RobotReason | None:
        """Why a robot must not be offered anything now; None if it may."""
        return _why(self._unreached, robot, now_ns)

    def why(self, robot: str, now_ns: int) -> RobotReason | None:
        """Why a robot must not be offered one of the coordinator's own tasks now; None if it may."""
        return _why(self._unreached, robot, now_ns) or _why(self._tired, robot, now_ns)


def _lengthen(pauses: dict[str, _Pause], robot: str, reason: RobotReason, now_ns: int) -> None:
    before = pauses.get(robot)
    pause_s = FIRST_PAUSE_S if before is None else min(2.0 * before.pause_s, LONGEST_PAUSE_S)
    pauses[robot] = _Pause(now_ns + to_ns(pause_s), pause_s, reason)


def _why(pauses: dict[str, _Pause], robot: str, now_ns: int) -> RobotReason | None:
    pause = pauses.get(robot)
    return pause.reason if pause is not None and now_ns < pause.until_ns else None
