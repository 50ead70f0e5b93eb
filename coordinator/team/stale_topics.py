"""Names the stale topics: a robot is present, and its messages at a fixed rate do not come."""

import logging

from robrain.coordinator.team.roster import Roster
from robrain.protocol.clock import to_ns
from robrain.protocol.reasons import TopicStale
from robrain.protocol.table.topics import ROBOT_STATE

logger = logging.getLogger(__name__)

CHECK_NS = to_ns(0.1)
LOGGED_NS = to_ns(10.0)
"""Changes within this are logged as one line, so that a link that comes and goes does not fill the log."""


class StaleTopics:
    """Checks the last messages of robots that are present.

    Args:
        roster: the robots.

    """

    def __init__(self, roster: Roster) -> None:
        self.found: list[TopicStale] = []
        """Stale topics as of the last look, by sender."""
        self._roster = roster
        self._gone: set[str] = set()
        """Of their senders, those that are not counted on any more."""
        self._due_ns = 0
        self._logged_ns: int | None = None

    def look(self, now_ns: int) -> bool:
        """Look again, at most ten times a second; whether others are stale or gone than before."""
        if 0 < self._due_ns - now_ns <= CHECK_NS:
            return False
        self._due_ns = now_ns + CHECK_NS
        before = {found.sender for found in self.found}
        self.found = self._find(now_ns)
        fresh = [found for found in self.found if found.sender not in before]
        if fresh and (self._logged_ns is None or not 0 <= now_ns - self._logged_ns < LOGGED_NS):
            self._logged_ns = now_ns
            logger.warning("stale: %s", "; ".join(map(str, fresh)))
        gone, robots = self._gone, self._roster.robots
        self._gone = {found.sender for found in self.found if not robots[found.sender].is_up(now_ns)}
        return bool(fresh) or len(self.found) < len(before) or self._gone != gone

    def _find(self, now_ns: int) -> list[TopicStale]:
        deadline_s = ROBOT_STATE.deadline_s
        assert deadline_s is not None
        return [
            TopicStale(ROBOT_STATE.name, robot.name, round(age_s, 3), deadline_s)
            for robot in self._roster.by_name
            if robot.has_token and robot.heard_ns is not None and (age_s := robot.age_s(now_ns)) > deadline_s
        ]
