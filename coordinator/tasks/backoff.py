"""Which tasks are not offered to which robots for a while: a robot that refused or failed a task is asked later."""

from typing import NamedTuple

from robrain.coordinator.tasks.robot_pauses import RobotPauses
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.reasons.robots import RobotReason

FIRST_PAUSE_S = 2.0
LONGEST_PAUSE_S = 60.0
"""Each refusal doubles the pause from the first up to the longest (chosen): a map grows, a battery fills, and what can
never be done is not asked for all the time."""
REFUSALS_MAX = 6
"""After so many refusals, a minute by these pauses, a robot's no to a task is taken for good (chosen)."""
KEPT = 4096


class _Shunned(NamedTuple):
    until_ns: int
    pause_s: float
    times: int
    reason: RobotReason


class Shunning:
    """Remembers refusals and failures, task by task and robot by robot; the oldest go when there are too many."""

    def __init__(self) -> None:
        self._shunned: dict[tuple[str, str], _Shunned] = {}
        self.robots = RobotPauses()
        """Robots that are offered nothing for a while, or none of the coordinator's own tasks."""

    def note(self, task_id: str, robot: str, reason: RobotReason, now_ns: int) -> None:
        """A robot refused a task or failed at it."""
        before = self._shunned.pop((task_id, robot), None)
        pause_s = FIRST_PAUSE_S if before is None else min(2.0 * before.pause_s, LONGEST_PAUSE_S)
        times = 1 if before is None else before.times + 1
        self._shunned[task_id, robot] = _Shunned(now_ns + to_ns(pause_s), pause_s, times, reason)
        if len(self._shunned) > KEPT:
            del self._shunned[next(iter(self._shunned))]

    def why(self, task_id: str, robot: str, now_ns: int) -> RobotReason | None:
        """Why a robot is not to be offered a task now; None if it may be."""
        shunned = self._shunned.get((task_id, robot))
        if shunned is not None and now_ns < shunned.until_ns:
            return shunned.reason
        return self.robots.why_unreached(robot, now_ns)

    def pauses(self, now_ns: int) -> dict[tuple[str, str], RobotReason]:
        """Which task is not to be offered to which robot now, and why."""
        return {pair: shunned.reason for pair, shunned in self._shunned.items() if now_ns < shunned.until_ns}

    def last_word(self, task_id: str, robot: str) -> RobotReason | None:
        """What a robot said that is not asked again; None if it may be."""
        shunned = self._shunned.get((task_id, robot))
        return shunned.reason if shunned is not None and shunned.times >= REFUSALS_MAX else None
