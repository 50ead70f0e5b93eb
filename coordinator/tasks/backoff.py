"""Pauses: which tasks are not offered to which robots for a while, and which robots are offered nothing for a while.

A robot that refused a task or failed at it is asked again later. An unreachable robot also gets a pause. When a link
recovers, its token and states arrive before its queryables. Without a pause the next task would follow each unanswered
offer at once.
"""

from typing import NamedTuple

from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.reasons import (
    DoneJustNow,
    NeedsEnergy,
    Occupied,
    OfferRefusal,
    OutOfReach,
    PlainReason,
    PositionLost,
    Refused,
    RobotHalted,
    RobotReason,
    StoodStill,
    plain,
)

FIRST_PAUSE_S = 2.0
LONGEST_PAUSE_S = 60.0
"""Longest pause. Each refusal doubles the pause up to this (chosen). Maps grow and batteries charge, but a task that is
impossible must not be offered all the time."""
REFUSALS_MAX = 6
"""Refusals after which a robot's answer to a task is final (chosen); with these pauses, after a minute."""
PASSING = (DoneJustNow, Occupied, PositionLost, RobotHalted, StoodStill)
"""Refusals for a robot's present state, which do not concern the task. The robot charges, is lost or halted, or its
process was paused."""
CHARGED_SOC = 0.9
"""State of charge from which a robot's want of energy is no passing one (chosen: below where charging ends)."""
KEPT = 4096

FIRST_ROBOT_PAUSE_S = 0.5
LONGEST_ROBOT_PAUSE_S = 8.0
"""Longest pause of a robot; each is twice the previous one (chosen)."""
REFUSALS_FREE = 3
"""Consecutive refusals of frontiers without a pause (chosen); the next frontier may be reachable."""


class _Avoided(NamedTuple):
    until_ns: int
    pause_s: float
    times: int
    reason: RobotReason


class TaskBackoff:
    """Remembers refusals and failures for each task and robot; drops the oldest beyond a limit."""

    def __init__(self) -> None:
        self._avoided: dict[tuple[str, str], _Avoided] = {}
        self.robots = RobotPauses()
        """Robots that are offered nothing for a while, or none of the coordinator's own tasks."""

    def record(
        self, task_id: str, robot: str, reason: RobotReason, now_ns: int, battery: BatteryState | None = None
    ) -> None:
        """Record that a robot refused a task or failed at it.

        A refusal for the robot's present state makes a pause, and does not count towards its final answer. Nor does a
        refusal for lack of energy by a robot that has more after a charge. A task out of reach has the longest
        pause at once: each try takes the robot out of contact.

        Args:
            task_id: the task.
            robot: robot that refused it.
            reason: why.
            now_ns: the time.
            battery: of a robot that can charge.

        """
        before = self._avoided.pop((task_id, robot), None)
        pause_s = FIRST_PAUSE_S if before is None else min(2.0 * before.pause_s, LONGEST_PAUSE_S)
        if isinstance(reason, OutOfReach):
            pause_s = LONGEST_PAUSE_S
        is_passing = isinstance(reason, Refused) and (
            isinstance(reason.because, PASSING) or _is_enough_once_charged(reason.because, battery)
        )
        times = (0 if before is None else before.times) + (not is_passing)
        self._avoided[task_id, robot] = _Avoided(now_ns + to_ns(pause_s), pause_s, times, reason)
        if len(self._avoided) > KEPT:
            del self._avoided[next(iter(self._avoided))]

    def pause_reason(self, task_id: str, robot: str, now_ns: int) -> RobotReason | None:
        """Why a robot must not be offered a task now; None if it may."""
        avoided = self._avoided.get((task_id, robot))
        if avoided is not None and now_ns < avoided.until_ns:
            return avoided.reason
        return self.robots.backoff_reason(robot, now_ns)

    def pauses(self, now_ns: int) -> dict[tuple[str, str], RobotReason]:
        """Which task must not be offered to which robot now, and why."""
        return {pair: avoided.reason for pair, avoided in self._avoided.items() if now_ns < avoided.until_ns}

    def last_word(self, task_id: str, robot: str) -> RobotReason | None:
        """The answer of a robot that is not asked again; None if it may be."""
        avoided = self._avoided.get((task_id, robot))
        return avoided.reason if avoided is not None and avoided.times >= REFUSALS_MAX else None


def _is_enough_once_charged(refusal: OfferRefusal, battery: BatteryState | None) -> bool:
    """Whether a robot refuses for lack of energy that its full battery has."""
    if battery is None or not isinstance(refusal, NeedsEnergy) or battery.soc >= CHARGED_SOC:
        return False
    return refusal.needed_j * battery.soc <= battery.remaining_j


class _Pause(NamedTuple):
    until_ns: int
    pause_s: float
    reason: RobotReason


class RobotPauses:
    """The present pauses of each robot."""

    def __init__(self) -> None:
        self._unreached: dict[str, _Pause] = {}
        self._tired: dict[str, _Pause] = {}
        self._refusals: dict[str, int] = {}

    def unreached(self, robot: str, reason: PlainReason, now_ns: int) -> None:
        """Record that an offer did not reach a robot."""
        _lengthen(self._unreached, robot, reason, now_ns)

    def refused(self, robot: str, refusal: OfferRefusal, now_ns: int) -> None:
        """Record that a robot refused one of the coordinator's own tasks."""
        self._unreached.pop(robot, None)
        self._refusals[robot] = self._refusals.get(robot, 0) + 1
        if self._refusals[robot] > REFUSALS_FREE:
            times = self._refusals[robot]
            reason = plain("refused_often", f"refused {times} times: {refusal}", times=times, because=refusal.code)
            _lengthen(self._tired, robot, reason, now_ns)

    def answered(self, robot: str) -> None:
        """Record that a robot refused a submitted task: it can be reached."""
        self._unreached.pop(robot, None)

    def accepted(self, robot: str) -> None:
        """Record that a robot accepted a task; this ends its pauses."""
        for kept in (self._unreached, self._tired, self._refusals):
            kept.pop(robot, None)

    def backoff_reason(self, robot: str, now_ns: int) -> RobotReason | None:
        """Why a robot must not be offered anything now; None if it may."""
        return _reason(self._unreached, robot, now_ns)

    def pause_reason(self, robot: str, now_ns: int) -> RobotReason | None:
        """Why a robot must not be offered one of the coordinator's own tasks now; None if it may."""
        return _reason(self._unreached, robot, now_ns) or _reason(self._tired, robot, now_ns)


def _lengthen(pauses: dict[str, _Pause], robot: str, reason: RobotReason, now_ns: int) -> None:
    before = pauses.get(robot)
    pause_s = FIRST_ROBOT_PAUSE_S if before is None else min(2.0 * before.pause_s, LONGEST_ROBOT_PAUSE_S)
    pauses[robot] = _Pause(now_ns + to_ns(pause_s), pause_s, reason)


def _reason(pauses: dict[str, _Pause], robot: str, now_ns: int) -> RobotReason | None:
    pause = pauses.get(robot)
    return pause.reason if pause is not None and now_ns < pause.until_ns else None
