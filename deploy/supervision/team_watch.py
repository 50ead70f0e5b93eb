"""What `robrain up` and `robrain top` hear of a team: who is there, how robots are, how much members say."""

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from robrain.coordinator.team.roster import Roster
from robrain.deploy.supervision.part import ARENA, COORDINATOR, RECORDER
from robrain.deploy.supervision.team_status import RobotCondition, robot_status
from robrain.protocol.clock import NS_PER_S
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ArenaTruth
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.map_frame import ARENA as ARENA_FRAME
from robrain.protocol.reasons.reason import told
from robrain.protocol.table.topics import (
    ARENA_TRUTH,
    COORDINATOR_ALIVE,
    COORDINATOR_STATE,
    RECORDER_STATE,
    ROBOT_ALIVE,
    ROBOT_STATE,
)
from robrain.protocol.wire.endpoint import Endpoint

STATES, HEARD, TRUTHS = "states", "heard", "truths"
OVER_NS = 3 * NS_PER_S
"""Time over which rates are averaged."""
MEMBERS_MAX = 4096
"""Members whose rates are kept."""


class Rate:
    """How fast a count grows."""

    def __init__(self, what: str) -> None:
        self.what = what
        self._counts: deque[tuple[int, int]] = deque(maxlen=256)

    def note(self, now_ns: int, count: int) -> None:
        """The count at a moment; one that has become less belongs to another process."""
        if self._counts and count < self._counts[-1][1]:
            self._counts.clear()
        self._counts.append((now_ns, count))

    def per_s(self, now_ns: int) -> float | None:
        """Per second over the last three; None with less than two counts in that time."""
        while self._counts and self._counts[0][0] < now_ns - OVER_NS:
            self._counts.popleft()
        if len(self._counts) < 2:
            return None
        (from_ns, first), (to_ns, last) = self._counts[0], self._counts[-1]
        return (last - first) * NS_PER_S / (to_ns - from_ns) if to_ns > from_ns else None


class RobotSeen(NamedTuple):
    """A robot at one moment."""

    name: str
    words: str
    is_up: bool


class TeamWatch:
    """Follows a team.

    Args:
        wire: what it listens by.
        expected: robots that are named although nothing was heard of them.

    """

    def __init__(self, wire: Endpoint, expected: Iterable[str] = ()) -> None:
        self.truth: ArenaTruth | None = None
        self.team_state: TeamState | None = None
        self.has_coordinator = False
        self._expected = list(expected)
        self._clock = wire.clock
        self._roster = Roster()
        self._presence = wire.watch(ROBOT_ALIVE)
        self._coordinator = wire.watch(COORDINATOR_ALIVE)
        self._inbox = Inbox()
        self._states: dict[str, int] = {}
        self._rates: dict[str, Rate] = {}
        self._truths = 0
        self._sim_time_s = self._before_s = 0.0
        for topic in (ARENA_TRUTH, ROBOT_STATE, COORDINATOR_STATE, RECORDER_STATE):
            wire.subscribe(self._inbox, topic)

    def look(self) -> None:
        """Take in what has arrived."""
        now_ns = self._clock.now_ns()
        for change in self._presence.changes():
            self._roster.record_presence(change)
        for received in self._inbox.drain():
            message = received.message
            if received.topic is ARENA_TRUTH:
                self._record_truth(message)
                self._record_rate(ARENA, TRUTHS, now_ns, self._truths)
            elif received.topic is ROBOT_STATE:
                self._roster.record_state(message, now_ns)
                self._states[message.robot] = self._states.get(message.robot, 0) + 1
                self._record_rate(message.robot, STATES, now_ns, self._states[message.robot])
            elif received.topic is COORDINATOR_STATE:
                self.team_state = message
                self._record_rate(COORDINATOR, HEARD, now_ns, message.messages)
            else:
                self._record_rate(RECORDER, HEARD, now_ns, message.messages)
        self._coordinator.changes()
        self.has_coordinator = bool(self._coordinator.present)

    @property
    def sim_time_s(self) -> float:
        """Simulated time of all arenas, one after the other."""
        return self._before_s + self._sim_time_s

    def robots(self) -> list[RobotSeen]:
        """The expected robots, and those that are there, by name."""
        now_ns = self._clock.now_ns()
        names = [*self._expected, *sorted(set(self._roster.robots) - set(self._expected))]
        return [self._seen(name, now_ns) for name in names]

    def messages(self, member: str) -> str:
        """Rate of a member's messages, in words; empty if unknown."""
        rate = self._rates.get(member)
        per_s = rate.per_s(self._clock.now_ns()) if rate is not None else None
        return "" if rate is None or per_s is None else f"{per_s:.1f} {rate.what}/s"

    def last_pose(self, robot: str) -> Pose2D | None:
        """Where a robot said that it is, arena frame; None if it has not said so, or has lost its place."""
        found = self._roster.robots.get(robot)
        state = found.state if found is not None else None
        if state is None or state.lost or state.frame != ARENA_FRAME:
            return None
        return state.pose

    def _seen(self, name: str, now_ns: int) -> RobotSeen:
        robot = self._roster.robots.get(name)
        if robot is None:
            return RobotSeen(name, "starting", is_up=False)
        if robot.is_up(now_ns):
            standing = robot_status(name, robot.state)
            behavior = standing.behavior if standing.condition is RobotCondition.UP else ""
            return RobotSeen(name, behavior or standing.condition, is_up=True)
        return RobotSeen(name, told(robot.down_reason(now_ns)), is_up=False)

    def _record_truth(self, truth: ArenaTruth) -> None:
        if truth.sim_time_s < self._sim_time_s:  # of another arena, which starts again
            self._before_s += self._sim_time_s
        self.truth, self._sim_time_s = truth, truth.sim_time_s
        self._truths += 1

    def _record_rate(self, member: str, what: str, now_ns: int, count: int) -> None:
        if member not in self._rates and len(self._rates) < MEMBERS_MAX:
            self._rates[member] = Rate(what)
        if member in self._rates:
            self._rates[member].note(now_ns, count)
