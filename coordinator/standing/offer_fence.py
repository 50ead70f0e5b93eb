"""Whether a coordinator may offer tasks, or most of its robots may be at them already, out of its reach.

A coordinator that stood by leads on the operator's word, who has seen that the first is silent. If the first has only
lost its link, with a few robots on its side, both would offer the tasks that were queued, and one might be done twice.
So it offers none while it hears neither the one that stands by nor more than half of its robots.

Robots that continue without a coordinator allocate the queued tasks once more than half of the team hear each other and
no coordinator. A coordinator offers no task while more than half of its robots could be doing that.
"""

import logging

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
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
REPORT_NS = to_ns(1.0)
"""Reconnected robots report their tasks within this time; a restarted coordinator hears every reachable robot."""
WRITE_NS = to_ns(60.0)
"""Period for storing when those robots were last heard; a change of the set is stored at once."""


class OfferFence:
    """Holds offers back while another coordinator may be leading, or robots may be allocating tasks.

    Args:
        roster: the robots that were ever heard.
        journal: stores the robots that continue without a coordinator, so that a restarted coordinator knows them.

    """

    def __init__(self, roster: Roster, journal: Journal) -> None:
        self.reason: MinorityHeard | None = None
        """Why nothing is offered; None if it may be."""
        self._roster = roster
        self._left: dict[str, int] = {}
        """Robots that do not count, with when they were heard last: they have ended, or the operator said so."""
        self._counted: frozenset[str] = frozenset()
        """Robots that count while offers are held back."""
        self._journal = journal
        self._before = journal.on_their_own
        """Robots that continue without a coordinator and were not heard since the start, with the time last heard."""
        self._written: frozenset[str] = frozenset(self._before)
        self._write_ns = self._apart_ns = 0
        self._held_since_ns: int | None = None
        self._is_told = False

    def note_gone(self, gone: list[Robot], now_ns: int) -> None:
        """The tokens of robots have gone; those that ended do not count, if others are still there.

        If all go at once the coordinator has lost its own connection.
        """
        if not any(robot.has_token for robot in self._roster.robots.values()):
            return
        for robot in gone:
            if robot.heard_ns is not None and now_ns - robot.heard_ns <= FAREWELL_NS:
                self._left[robot.name] = robot.heard_ns

    def step(self, feed: JournalFeed | None, now_ns: int) -> None:
        """Look at who is heard.

        Args:
            feed: to the one that stands by; None if none was ever heard.
            now_ns: the time.

        """
        if feed is None and not self._roster.some_go_on and not self._before:
            return
        known = self._roster.robots
        for name, heard_ns in list(self._left.items()):
            if name not in known or known[name].heard_ns != heard_ns:
                del self._left[name]  # it is back
        self._before = {
            name: heard_ns
            for name, heard_ns in self._before.items()
            if name not in known or known[name].heard_ns is None
        }
        robots = [robot for robot in known.values() if robot.was_there and robot.heard_ns is not None]
        counted = {robot.name for robot in robots if self._counts(robot.name, robot.heard_ns, now_ns)}
        missed = {name for name, heard_ns in self._before.items() if self._counts(name, heard_ns, now_ns)}
        self._write(robots, now_ns)
        heard = sum(robot.is_up(now_ns) for robot in robots if robot.name in counted)
        apart = len(missed) + sum(
            robot.goes_on and not robot.hears_back(now_ns) for robot in robots if robot.name in counted
        )
        counted |= missed
        process = "" if feed is None else feed.silent_copy(now_ns, STAND_BY_SILENT_NS)
        if 2 * heard > len(counted):
            process = ""
        if process or 2 * apart > len(counted):
            self._counted, self._apart_ns = frozenset(counted), now_ns
            self.reason = MinorityHeard(heard, len(counted), process)
            self._tell(now_ns)
        elif now_ns - self._apart_ns > REPORT_NS:
            self._end()

    def heard_by_most(self, now_ns: int) -> int:
        """Number of the latest task change that at least one robot of every possible majority has heard of.

        Call it only while offers are held back.
        """
        robots = [robot for robot in self._roster.by_name if self._counts(robot.name, robot.heard_ns, now_ns)]
        missed = sum(self._counts(name, heard_ns, now_ns) for name, heard_ns in self._before.items())
        heard = sorted([0] * missed + [robot.changes_heard for robot in robots if robot.goes_on])
        may_miss_it = (len(robots) + missed) // 2
        return heard[may_miss_it]

    def lead(self, now_ns: int) -> list[str]:
        """The operator says that robots which are not heard do no tasks: they count no more; returns their names."""
        silent = [name for name in sorted(self._counted) if not self._is_up(name, now_ns)]
        for name in silent:
            robot = self._roster.robots.get(name)
            if robot is not None and robot.heard_ns is not None:
                self._left[name] = robot.heard_ns
        self._before = {}
        self._end()
        return silent

    def _counts(self, name: str, heard_ns: int | None, now_ns: int) -> bool:
        if name in self._left or heard_ns is None:
            return False
        return name in self._counted or now_ns - heard_ns <= HEARD_NS

    def _write(self, robots: list[Robot], now_ns: int) -> None:
        """Store the robots that continue without a coordinator, so that a restarted coordinator knows them."""
        there = {
            robot.name: robot.heard_ns
            for robot in robots
            if robot.goes_on and robot.heard_ns is not None and robot.name not in self._left
        }
        names = frozenset(there) | frozenset(self._before)
        if names == self._written and now_ns < self._write_ns:
            return
        self._written, self._write_ns = names, now_ns + WRITE_NS
        try:
            self._journal.note_on_their_own({**self._before, **there})
        except JournalUnwritable:
            logger.debug("robots that continue without a coordinator are not stored: the journal cannot be written")

    def _tell(self, now_ns: int) -> None:
        reason = self.reason
        if self._held_since_ns is None:
            self._held_since_ns = now_ns
        if self._is_told or reason is None or now_ns - self._held_since_ns < REPORT_NS:
            return  # at the start, robots need a moment to hear the coordinator
        self._is_told = True
        others = "the others go on by themselves"
        if reason.stand_by:
            others = f"{reason.stand_by}, which has a copy of the journal, is not"
        logger.error(
            "no task is offered: %d of %d robots are heard, and %s; if none of them does any task, "
            "say so with `robrain lead`",
            reason.heard, reason.robots, others,
        )  # fmt: skip

    def _is_up(self, name: str, now_ns: int) -> bool:
        robot = self._roster.robots.get(name)
        return robot is not None and robot.is_up(now_ns)

    def _end(self) -> None:
        if self._is_told:
            logger.warning("tasks are offered again")
        self.reason, self._counted = None, frozenset()
        self._held_since_ns, self._is_told = None, False
