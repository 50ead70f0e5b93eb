"""The roster: the known robots, and their last reports."""

import logging
import math
from collections.abc import Mapping, Sequence

from msgspec import UNSET
from msgspec.structs import replace

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.team.service_messages import RobotLabel
from robrain.protocol.messages.team.standing_messages import KnownRobot
from robrain.protocol.messages.team.team_messages import RobotSummary
from robrain.protocol.model.tasks.task import LOST_AFTER_S
from robrain.protocol.reasons import (
    Gone,
    IdleReason,
    NoState,
    OutOfService,
    TopicStale,
    Unavailable,
    plain,
    sentence_of,
)
from robrain.protocol.wire.presence import Change

logger = logging.getLogger(__name__)

ROBOTS_MAX = 4096
"""Maximum number of robots ever seen; further ones are rejected."""
ROBOTS_UNSEEN_MAX = 32
"""Maximum number of names without a token yet (chosen: tokens arrive with the first state)."""
FORGET_UNSEEN_NS = to_ns(10.0)
"""Such a name is forgotten after this much silence (chosen)."""
_LOST_AFTER_NS = to_ns(LOST_AFTER_S)
FOUND_NS = to_ns(1.0)
"""A restarted coordinator finds every robot that is there within this time."""
WRITE_NS = to_ns(60.0)
"""Period for storing the robots' last message times; a robot that comes or goes is stored at once."""


class Robot:
    """One robot of the team."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.state: RobotState | None = None
        self.received_ns: int | None = None
        self.has_token = False
        self.was_there = False
        """Whether it ever had a token."""
        self.alone_ns: int | None = None
        """Time of its last report that it receives no coordinator; None if it has since reported that it does."""
        self.before: KnownRobot | None = None
        """As a coordinator before this one knew it."""
        self.left_ns: int | None = None
        """Its last message before it ended, or before the operator confirmed that it does nothing."""
        self.out_of_service: OutOfService | None = None
        """Why it gets no tasks, by an operator's word; None if it is in service."""

    @property
    def last_seen_ns(self) -> int | None:
        """Time of its last message, also to a coordinator before this one."""
        return self.before.last_seen_ns if self.received_ns is None and self.before is not None else self.received_ns

    @property
    def has_left(self) -> bool:
        """Whether it has ended, or the operator confirmed that it does nothing; False again after its next message."""
        return self.left_ns is not None and self.left_ns == self.last_seen_ns

    @property
    def has_gone(self) -> bool:
        """Whether it has left the network: it had a token, and has none now."""
        return not self.has_token and (self.received_ns is not None or self.before is not None)

    @property
    def continues(self) -> bool:
        """Whether it continues without a coordinator, and allocates tasks with others."""
        if self.state is None:
            return self.before is not None and self.before.continues
        return self.state.changes_received is not UNSET

    @property
    def changes_received(self) -> int:
        """Number of the last change of tasks that it has received; 0 if it does not report it."""
        return 0 if self.state is None else self.state.changes_received or 0

    def is_in_contact(self, now_ns: int) -> bool:
        """Whether the robot is up and has not recently reported that it receives no coordinator."""
        is_alone = self.alone_ns is not None and now_ns - self.alone_ns <= _LOST_AFTER_NS
        return not is_alone and self.is_up(now_ns)

    def age_s(self, now_ns: int) -> float:
        """Time since its last state; infinite before the first."""
        received_ns = self.last_seen_ns
        return float("inf") if received_ns is None else to_seconds(now_ns - received_ns)

    def is_up(self, now_ns: int) -> bool:
        """Whether the robot is present and its last state is recent."""
        return self.has_token and self.received_ns is not None and now_ns - self.received_ns <= _LOST_AFTER_NS

    def down_reason(self, now_ns: int) -> Unavailable | None:
        """The reason why the robot is not up; None if it is."""
        if self.is_up(now_ns):
            return None
        if self.has_gone:
            return Gone()
        if self.received_ns is None:
            return NoState()
        silent_s = round(self.age_s(now_ns), 3)
        return plain("lost_contact", f"lost contact {silent_s:.1f} s ago", silent_s=silent_s)


class Roster:
    """All known robots, by name.

    Args:
        journal: stores the robots, so that a restarted coordinator knows those that have gone.
        tasks: the open task of each robot, by the journal.
        now_ns: the time.

    """

    def __init__(self, journal: Journal | None = None, tasks: Mapping[str, str] | None = None, now_ns: int = 0) -> None:
        self.robots: dict[str, Robot] = {}
        self._by_name: list[Robot] = []
        self._out_of_service: Mapping[str, OutOfService] = {}
        self.labels: Mapping[str, RobotLabel] = {}
        """Labels of renamed robots, by their names."""
        self._up: list[Robot] = []
        self.some_go_on = False
        """Whether any known robot continues without a coordinator."""
        self._unseen = 0
        """Number of robots that never had a token."""
        self._up_at_ns: int | None = None
        """Time of `_up`, a cache: it is used several times a step, and there may be a thousand robots."""
        self._journal, self._found_ns, self._write_ns = journal, now_ns + FOUND_NS, 0
        known = {} if journal is None else journal.robots
        for name, before in known.items():
            robot = self._robot(name)
            task = (tasks or {}).get(name) or before.summary.task
            robot.before = KnownRobot(
                min(before.last_seen_ns, now_ns), before.continues, replace(before.summary, task=task)
            )
            robot.left_ns = None if before.continues else before.last_seen_ns
            robot.was_there = True
            self._unseen -= 1
            self.some_go_on = self.some_go_on or before.continues
        self._written = self._to_write()

    @property
    def by_name(self) -> list[Robot]:
        """All robots, by name; not to be changed."""
        return self._by_name

    def is_complete(self, now_ns: int) -> bool:
        """Whether robots that are there have been found; not just after the start."""
        return now_ns >= self._found_ns

    def set_out_of_service(self, reasons: Mapping[str, OutOfService]) -> None:
        """Give these robots no tasks, for a reason each, also if they come later; all others are in service."""
        self._out_of_service = reasons
        for robot in self._by_name:
            robot.out_of_service = reasons.get(robot.name)

    def rejection(self, name: str, now_ns: int) -> str:
        """Why a state from this name is rejected, as text; empty if the robot is known, or there is room for it."""
        if name in self.robots:
            return ""
        if len(self.robots) >= ROBOTS_MAX:
            return f"there are {ROBOTS_MAX} robots already"
        if self._unseen >= ROBOTS_UNSEEN_MAX:
            self.forget_unseen(now_ns)
        return f"there are {self._unseen} without a token already" if self._unseen >= ROBOTS_UNSEEN_MAX else ""

    def forget_unseen(self, now_ns: int) -> None:
        """Forget names that never had a token and have been silent for a while."""
        if not self._unseen:
            return
        for robot in self._by_name:
            if not robot.was_there and (robot.received_ns is None or now_ns - robot.received_ns > FORGET_UNSEEN_NS):
                self.remove(robot)

    def remove_gone(self, name: str, tasks: Sequence[str]) -> None:
        """Forget a robot that has gone.

        Args:
            name: the robot's name.
            tasks: that it may still do.

        Raises:
            CallError: it is unknown, is there, or may still do a task.

        """
        robot = self.robots.get(name)
        if robot is None:
            refusal = f"no such robot is known; there are: {', '.join(self.robots) or 'none'}"
        elif robot.has_token:
            refusal = "it is there"
        elif tasks:
            refusal = f"task {tasks[0]} may still run on it; ask again in a few seconds"
        else:
            self.remove(robot)
            return
        raise CallError(ErrorCode.REFUSED, f"{name} is not removed: {refusal}", refusal)

    def remove(self, robot: Robot) -> None:
        """Forget a robot without a token."""
        del self.robots[robot.name]
        self._unseen -= not robot.was_there
        self._by_name = [self.robots[known] for known in sorted(self.robots)]
        self._up_at_ns = None

    def record_state(self, state: RobotState, now_ns: int) -> None:
        """A robot's state has arrived."""
        robot = self._robot(state.robot)
        robot.state = state
        robot.received_ns = now_ns
        self.some_go_on = self.some_go_on or state.changes_received is not UNSET
        self._up_at_ns = None

    def record_contact(self, name: str, now_ns: int, *, receives_coordinator: bool) -> None:
        """A robot has reported whether it receives a coordinator."""
        if name in self.robots:
            self.robots[name].alone_ns = None if receives_coordinator else now_ns

    def record_presence(self, change: Change) -> Robot:
        """A robot's token came or went."""
        robot = self._robot(change.names["robot"])
        robot.has_token = change.present
        if not robot.was_there:
            robot.was_there = True
            self._unseen -= 1
        self._up_at_ns = None
        return robot

    def restart_silence(self, paused_ns: int) -> None:
        """The coordinator itself was paused for this time: no robot was silent meanwhile."""
        for robot in self._by_name:
            if robot.received_ns is not None:
                robot.received_ns += paused_ns
        self._up_at_ns = None

    def up(self, now_ns: int) -> list[Robot]:
        """The robots that are up, sorted by name; do not modify the list."""
        if self._up_at_ns != now_ns:
            since_ns = now_ns - _LOST_AFTER_NS
            self._up = [
                robot
                for robot in self._by_name
                if robot.has_token and robot.received_ns is not None and robot.received_ns >= since_ns
            ]
            self._up_at_ns = now_ns
        return self._up

    def continues_for_s(self) -> float:
        """The longest time for which a known robot continues without a coordinator; 0 if none does."""
        states = [robot.state for robot in self._by_name if robot.state is not None]
        return max((0.0, *(state.continues_for_s for state in states if state.continues_for_s is not UNSET)))

    def write(self, now_ns: int) -> None:
        """Store the robots when one came, went or was removed, and every minute."""
        found = self._to_write()
        if self._journal is None or (found == self._written and now_ns < self._write_ns):
            return
        self._written, self._write_ns = found, now_ns + WRITE_NS
        robots = {}
        for summary in self.summaries(now_ns, all_robots=True):
            robot = self.robots[summary.name]
            if robot.last_seen_ns is not None and robot.was_there:
                continues = robot.continues and not robot.has_left
                stored = replace(summary, task="") if robot.has_token else summary
                robots[robot.name] = KnownRobot(robot.last_seen_ns, continues, stored)
        try:
            self._journal.record_robots(robots)
        except JournalUnwritable:
            logger.debug("the robots of the team are not stored: the journal cannot be written")

    def _to_write(self) -> list[tuple[str, bool, bool, int | None]]:
        return [
            (robot.name, robot.has_token, robot.last_seen_ns is None, robot.left_ns)
            for robot in self._by_name
            if robot.was_there
        ]

    def summaries(
        self, now_ns: int, idle: Mapping[str, IdleReason] | None = None, *, all_robots: bool = False
    ) -> list[RobotSummary]:
        """A summary of each robot, by name, with the reason why it is idle if `idle` has one.

        Just after the start those are not there that have not been found yet, unless `all_robots`.
        """
        reasons = idle or {}
        summaries = []
        for robot in self._by_name:
            state, reason, out = robot.state, reasons.get(robot.name), robot.down_reason(now_ns) or robot.out_of_service
            age_s = round(min(robot.age_s(now_ns), 1e6), 3)
            if robot.before is not None and isinstance(out, Gone) and state is None:
                if all_robots or self.is_complete(now_ns):
                    gone = replace(
                        robot.before.summary,
                        up=False,
                        age_s=age_s,
                        why=sentence_of(out),
                        idle=None,
                        out=out,
                        label=self.labels.get(robot.name, UNSET),
                    )
                    summaries.append(gone)
                continue
            summaries.append(
                RobotSummary(
                    name=robot.name,
                    up=robot.is_up(now_ns),
                    age_s=age_s,
                    halted=state is not None and state.halted,
                    soc=state.battery.soc if state is not None and state.battery is not None else None,
                    behavior=state.behavior if state is not None else "",
                    task=state.task.id if state is not None and state.task and not state.task.state.ended else "",
                    why=sentence_of(out or reason),
                    idle=reason,
                    out=out,
                    label=self.labels.get(robot.name, UNSET),
                    faulted=state.faulted if state is not None else [],
                )
            )
        return summaries

    def _robot(self, name: str) -> Robot:
        if name not in self.robots:
            self.robots[name] = Robot(name)
            self.robots[name].out_of_service = self._out_of_service.get(name)
            self._unseen += 1
            self._by_name = [self.robots[known] for known in sorted(self.robots)]
        return self.robots[name]


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
        """Stale topics as of the last check, by sender."""
        self._roster = roster
        self._gone: set[str] = set()
        """Senders of stale topics that are not up."""
        self._due_ns = 0
        self._logged_ns: int | None = None

    def check(self, now_ns: int) -> bool:
        """Check again, at most ten times a second; whether others are stale or gone than before."""
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
        deadline_s = ROBOT_STATE.deadline_s or math.inf
        return [
            TopicStale(ROBOT_STATE.name, robot.name, round(age_s, 3), deadline_s)
            for robot in self._roster.by_name
            if robot.has_token and robot.received_ns is not None and (age_s := robot.age_s(now_ns)) > deadline_s
        ]
