"""Whether a coordinator may offer tasks, or another one may be leading most of its robots.

A coordinator that stood by leads on the operator's word, who has seen that the first is silent. If the first has only
lost its link, with a few robots on its side, both would offer the tasks that were queued, and one might be done twice.
So it offers none while it hears neither the one that stands by nor more than half of its robots.
"""

import logging

from robrain.coordinator.standing.journal_feed import JournalFeed
from robrain.coordinator.team.roster import Robot, Roster
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.reasons.tasks import MinorityHeard

logger = logging.getLogger(__name__)

HEARD_NS = to_ns(600.0)
"""Robots count that were heard within this time (chosen). While offers are held back, those count that did before."""
STAND_BY_SILENT_NS = to_ns(2.0)
"""Silence after which the one that stands by may be leading (chosen: no operator is that fast)."""
FAREWELL_NS = to_ns(0.5)
"""A robot whose token goes this soon after its last state has ended; a cut link is silent for longer before."""


class OfferFence:
    """Holds offers back while another coordinator may be leading.

    Args:
        roster: the robots that were ever heard.

    """

    def __init__(self, roster: Roster) -> None:
        self.reason: MinorityHeard | None = None
        """Why nothing is offered; None if it may be."""
        self._roster = roster
        self._left: dict[str, int] = {}
        """Robots that do not count, with when they were heard last: they have ended, or the operator said so."""
        self._counted: frozenset[str] = frozenset()
        """Robots that count while offers are held back."""

    def note_gone(self, gone: list[Robot], now_ns: int) -> None:
        """The tokens of robots have gone; those that ended do not count, if others are still there.

        If all go at once the coordinator has lost its own connection.
        """
        if not any(robot.has_token for robot in self._roster.robots.values()):
            return
        for robot in gone:
            if robot.heard_ns is not None and now_ns - robot.heard_ns <= FAREWELL_NS:
                self._left[robot.name] = robot.heard_ns

    def step(self, feed: JournalFeed, now_ns: int) -> None:
        """Look at who is heard."""
        for name, heard_ns in list(self._left.items()):
            robot = self._roster.robots.get(name)
            if robot is None or robot.heard_ns != heard_ns:
                del self._left[name]  # it is back
        robots = [robot for robot in self._roster.robots.values() if robot.was_there and robot.heard_ns is not None]
        counted = {robot.name for robot in robots if self._counts(robot, now_ns)}
        heard = sum(robot.is_up(now_ns) for robot in robots if robot.name in counted)
        process = feed.silent_copy(now_ns, STAND_BY_SILENT_NS)
        if not process or 2 * heard > len(counted):
            self._end()
            return
        if self.reason is None:
            logger.error(
                "no task is offered: %d of %d robots are heard, and %s, which has a copy of the journal, is not; "
                "if no other coordinator leads, say so with `robrain lead`",
                heard, len(counted), process,
            )  # fmt: skip
        self._counted = frozenset(counted)
        self.reason = MinorityHeard(heard, len(counted), process)

    def lead(self, now_ns: int) -> list[str]:
        """The operator says that no other coordinator leads: who is silent counts no more; returns their names."""
        silent = [name for name in sorted(self._counted) if not self._is_up(name, now_ns)]
        for name in silent:
            heard_ns = self._roster.robots[name].heard_ns
            if heard_ns is not None:
                self._left[name] = heard_ns
        self._end()
        return silent

    def clock_set_back(self, now_ns: int) -> None:
        """Nobody was heard later than now, as in the roster."""
        self._left = {name: min(heard_ns, now_ns) for name, heard_ns in self._left.items()}

    def _counts(self, robot: Robot, now_ns: int) -> bool:
        if robot.name in self._left or robot.heard_ns is None:
            return False
        return robot.name in self._counted or now_ns - robot.heard_ns <= HEARD_NS

    def _is_up(self, name: str, now_ns: int) -> bool:
        robot = self._roster.robots.get(name)
        return robot is not None and robot.is_up(now_ns)

    def _end(self) -> None:
        if self.reason is not None:
            logger.warning("tasks are offered again")
        self.reason, self._counted = None, frozenset()
