"""Holds offers back while robots out of the coordinator's reach may be allocating the tasks among themselves.

Robots that continue without a coordinator allocate the queued tasks once more than half of the team hear each other and
no coordinator. A coordinator offers no task while more than half of its robots could be doing that.
"""

import logging
from collections.abc import Sequence

from robrain.coordinator.team.roster import Robot, Roster
from robrain.protocol.clock import to_ns
from robrain.protocol.reasons import MinorityHeard

logger = logging.getLogger(__name__)

HEARD_NS = to_ns(600.0)
"""Robots count that were heard within this time (chosen). While offers are held back, those count that did before."""
FAREWELL_NS = to_ns(0.5)
"""A robot whose token goes this soon after its last state has ended; a cut link is silent for longer before."""
REPORT_NS = to_ns(1.0)
"""Reconnected robots report their tasks within this time; a restarted coordinator hears every reachable robot."""


class OfferFence:
    """Holds offers back while robots may be allocating tasks.

    Args:
        roster: the robots that were ever heard, also by a coordinator before this one.

    """

    def __init__(self, roster: Roster) -> None:
        self.reason: MinorityHeard | None = None
        """Why nothing is offered; None if it may be."""
        self._roster = roster
        self._counted: frozenset[str] = frozenset()
        """Robots that count while offers are held back."""
        self._apart_ns = 0
        self._held_since_ns: int | None = None
        self._is_reported = False

    def record_gone(self, gone: Sequence[Robot], now_ns: int) -> None:
        """The tokens of robots have gone; those that ended do not count, if others are still there.

        If all go at once the coordinator has lost its own connection.
        """
        if not any(robot.has_token for robot in self._roster.robots.values()):
            return
        for robot in gone:
            if robot.heard_ns is not None and now_ns - robot.heard_ns <= FAREWELL_NS:
                robot.left_ns = robot.heard_ns

    def step(self, now_ns: int) -> None:
        """Check which robots are heard."""
        if not self._roster.some_go_on:
            return
        counted = [robot for robot in self._roster.by_name if self._counts(robot, now_ns)]
        heard = sum(robot.is_up(now_ns) for robot in counted)
        apart = sum(robot.goes_on and not robot.hears_back(now_ns) for robot in counted)
        if 2 * apart > len(counted):
            self._counted, self._apart_ns = frozenset(robot.name for robot in counted), now_ns
            self.reason = MinorityHeard(heard, len(counted))
            self._log(now_ns)
        elif now_ns - self._apart_ns > REPORT_NS:
            self._end()

    def received_by_most(self, now_ns: int) -> int:
        """Number of the latest task change that at least one robot of every possible majority has heard of.

        Call it only while offers are held back.
        """
        robots = [robot for robot in self._roster.by_name if self._counts(robot, now_ns)]
        heard = sorted(robot.changes_heard for robot in robots if robot.goes_on)
        may_miss_it = len(robots) // 2
        return heard[may_miss_it]

    def force(self, now_ns: int) -> list[str]:
        """The operator says that silent robots do no tasks: they do not count any more; returns their names."""
        silent = [robot for robot in self._roster.by_name if robot.name in self._counted and not robot.is_up(now_ns)]
        for robot in silent:
            robot.left_ns = robot.last_seen_ns
        self._end()
        return [robot.name for robot in silent]

    def _counts(self, robot: Robot, now_ns: int) -> bool:
        heard_ns = robot.last_seen_ns
        if not robot.was_there or robot.has_left or heard_ns is None:
            return False
        return robot.name in self._counted or now_ns - heard_ns <= HEARD_NS

    def _log(self, now_ns: int) -> None:
        reason = self.reason
        if self._held_since_ns is None:
            self._held_since_ns = now_ns
        if self._is_reported or reason is None or now_ns - self._held_since_ns < REPORT_NS:
            return  # at the start, robots need a moment to hear the coordinator
        self._is_reported = True
        logger.error(
            "no task is offered: %d of %d robots are heard, and the others go on by themselves; if none of them does "
            "any task, say so with `robrain lead`",
            reason.heard, reason.robots,
        )  # fmt: skip

    def _end(self) -> None:
        if self._is_reported:
            logger.warning("tasks are offered again")
        self.reason, self._counted = None, frozenset()
        self._held_since_ns, self._is_reported = None, False
