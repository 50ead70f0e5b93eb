"""Status of a team as seen from outside, for `robrain status`, `robrain up` and `robrain top`."""

import time
from collections import deque
from collections.abc import Iterable, Iterator
from enum import StrEnum
from typing import NamedTuple

import msgspec

from robrain.client.members import team_found
from robrain.coordinator.team.roster import Roster
from robrain.deploy.command_line.terminal import new_table, print_line, results
from robrain.deploy.processes.live_process import client_endpoint
from robrain.deploy.supervision.part import ARENA, COORDINATOR, RECORDER
from robrain.protocol.clock import NS_PER_S
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.motes.mote_messages import MoteFieldState
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, RobotState
from robrain.protocol.messages.robots.witness_messages import Lead
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH, ArenaTruth
from robrain.protocol.messages.team.recorder_messages import RECORDER_STATE
from robrain.protocol.messages.team.service_messages import RobotLabel
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, COORDINATOR_STATE, StandByStatus, TeamState
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.map_frame import ARENA as ARENA_FRAME
from robrain.protocol.reasons import Gone, OutOfService, sentence_of
from robrain.protocol.refusals import Refusal
from robrain.protocol.safe_text import safe_lines
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.hub import team_endpoints, wrong_team
from robrain.recording.drawing.labels import natural_key, span_text

STATE_S = 1.0
"""Timeout of the members' states."""
POLL_S = 0.02
STATES, RECEIVED, TRUTHS = "states", "messages", "updates"
OVER_NS = 3 * NS_PER_S
"""Time over which rates are averaged."""
MEMBERS_MAX = 4096
"""Members whose rates are kept."""


class RobotCondition(StrEnum):
    """Status of a robot; the first that holds."""

    GONE = "gone"
    """It has left the network; `robrain remove` has it forgotten."""
    HALTED = "halted"
    FAULTED = "faulted"
    OUT_OF_SERVICE = "out of service"
    LOST = "lost"
    """It does not know its pose."""
    SILENT = "silent"
    """Its token is there, but it has published no state for a second."""
    UP = "up"


class RobotStatus(msgspec.Struct, frozen=True, kw_only=True):
    """Status of one robot."""

    robot: str
    condition: RobotCondition
    label: RobotLabel | None = None
    """How people call it, and who named it so; None if it was not renamed."""
    why: str = ""
    """In words; empty if it is up, or if only `plugins_out` has more."""
    soc: float | None = None
    """State of charge, 0 to 1; None if unknown."""
    place: Point2D | None = None
    """Its pose, arena frame; None if unknown."""
    task: str = ""
    """Id of the task that it does; of a robot that has gone, the last one."""
    behavior: str = ""
    """The behavior that drives it."""
    waits_for: str = ""
    """The robot for which it waits."""
    waits_at: str = ""
    """The zone or door before which it waits."""
    plugins_out: dict[str, list[str]] = {}
    """Plugins that do not run, by the reason."""
    silent_s: float | None = None
    """Time since its last state; None if it is there."""


class TeamStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The members of a team: present ones, and robots that have gone."""

    team: str
    coordinator: bool
    robots: list[str]
    """Names of present members, sorted."""
    statuses: list[RobotStatus] = []
    """Status of each robot, by name; also of robots that have gone and were not removed."""
    refused: dict[str, list[Refusal]] = {}
    """Refusals of the coordinator and the robots, by `coordinator` and the robots' names; absent if there are none."""
    mote_field: MoteFieldState | None = None
    """Status of the motes; absent if the coordinator does no work for them on its own initiative."""
    stand_by: StandByStatus | None = None
    """The stand-by coordinator, which has its own journal; absent if there is none."""
    lead: Lead | None = None
    """Electors of the coordinator; absent if the team has no witnesses for that."""
    unwritable: str = ""
    """Reason why the coordinator accepts no tasks: its journal cannot be written; absent if it can."""


def status_of(connect: str | None, team: str) -> TeamStatus:
    """The members of a team.

    Raises:
        NobodyThere: no member is present; the text lists the teams that have members present.

    """
    with client_endpoint(connect, team) as wire:
        found = status_by(wire)
        if not found.robots and not found.coordinator:
            raise wrong_team(f"nobody of team {team} is at {', '.join(team_endpoints(connect))}", wire)
        return found


def status_by(wire: Endpoint) -> TeamStatus:
    """The members of the endpoint's team."""
    monitor = TeamMonitor(wire)
    found = team_found(wire)
    until_s = time.monotonic() + STATE_S
    while len(monitor.states) < len(found.robots) or (found.coordinator and monitor.team_state is None):
        if time.monotonic() > until_s:
            break
        time.sleep(POLL_S)
        monitor.update()
    summary, states = monitor.team_state or TeamState(robots=[]), monitor.states
    refused = {COORDINATOR: summary.refused or []}
    refused |= {name: state.refused or [] for name, state in sorted(states.items())}
    statuses = {name: robot_status(name, states.get(name)) for name in found.robots}
    statuses |= {
        robot.name: msgspec.structs.replace(known, condition=RobotCondition.OUT_OF_SERVICE, why=str(robot.out))
        for robot in summary.robots
        if isinstance(robot.out, OutOfService)
        and (known := statuses.get(robot.name))
        and known.condition is RobotCondition.UP
    }
    statuses |= {
        robot.name: RobotStatus(
            robot=robot.name, condition=RobotCondition.GONE, task=robot.task, soc=robot.soc, silent_s=robot.age_s
        )
        for robot in summary.robots
        if isinstance(robot.out, Gone) and robot.name not in statuses
    }
    for robot in summary.robots:
        if robot.label and robot.name in statuses:
            statuses[robot.name] = msgspec.structs.replace(statuses[robot.name], label=robot.label)
    return TeamStatus(
        team=found.team,
        coordinator=found.coordinator,
        robots=found.robots,
        statuses=[statuses[name] for name in sorted(statuses, key=natural_key)],
        refused={name: each for name, each in refused.items() if each},
        mote_field=summary.mote_field or None,
        stand_by=summary.stand_by or None,
        lead=summary.lead or None,
        unwritable=summary.unwritable or "",
    )


def show_status(found: TeamStatus) -> None:
    """Print one line for each robot of a team, and below them the reasons, each once."""
    print_line(f"team {found.team}: coordinator {'up' if found.coordinator else 'not there'}")
    headings = ("robot", "state", "battery", "place", "task", "plugins out")
    table = new_table(*headings, right=("battery", "plugins out"))
    for robot in found.statuses:
        table.add_row(*map(safe_lines, _cells(robot)))
    if found.statuses:
        results().print(table)
    reasons: dict[str, list[str]] = {}
    for robot in found.statuses:
        for reason in reasons_of(robot):
            reasons.setdefault(reason, []).append(robot.robot)
    for reason, robots in reasons.items():
        print_line(f"{', '.join(robots)}: {reason}")
    if found.unwritable:
        print_line(f"the coordinator accepts no tasks: {found.unwritable}")
    for part in (found.lead, found.stand_by, found.mote_field):
        if part is not None:
            print_line(part.words)
    for name, refused in found.refused.items():
        for one in refused:
            print_line(f"{name} refused {one.words}")


def _cells(robot: RobotStatus) -> list[str]:
    out = sum(map(len, robot.plugins_out.values()))
    gone = "" if robot.silent_s is None else f" {span_text(robot.silent_s)}"
    return [
        f"{robot.label.text} ({robot.robot})" if robot.label else robot.robot,
        f"{robot.condition}{gone}",
        "–" if robot.soc is None else f"{robot.soc:.0%}",
        "–" if robot.place is None else f"({robot.place.x_m:.1f}, {robot.place.y_m:.1f})",
        (robot.task or robot.behavior or "–")
        + (", waits" if robot.waits_for or robot.waits_at else "")
        + (f" for {robot.waits_for}" if robot.waits_for else "")
        + (f" at {robot.waits_at}" if robot.waits_at else ""),
        str(out) if out else "–",
    ]


def reasons_of(robot: RobotStatus) -> Iterator[str]:
    """Faults of a robot, in words."""
    if robot.why:
        yield robot.why
    for reason, plugins in robot.plugins_out.items():
        verb = "does" if len(plugins) == 1 else "do"
        yield f"{', '.join(plugins)} {verb} not run: {reason}"


def robot_status(robot: str, state: RobotState | None) -> RobotStatus:
    """Status of a present robot, by its last state."""
    if state is None:
        reason = f"no state published for {STATE_S:g} s"
        return RobotStatus(robot=robot, condition=RobotCondition.SILENT, why=reason)
    condition, reason = RobotCondition.UP, ""
    if state.halted:
        condition, reason = RobotCondition.HALTED, f"halted by {', '.join(state.halted_by) or 'the team'}"
        if state.not_halted:
            reason += f"; not stopped: {', '.join(state.not_halted)}"
    elif state.faulted:
        condition = RobotCondition.FAULTED
    elif state.lost:
        condition, reason = RobotCondition.LOST, f"lost: {state.lost}"
    plugins_out: dict[str, list[str]] = {}
    for fault in state.faulted:
        plugins_out.setdefault(fault.why.strip().rpartition("\n")[2], []).extend([fault.plugin, *fault.dependants])
    return RobotStatus(
        robot=robot,
        condition=condition,
        why=reason,
        soc=None if state.battery is None else state.battery.soc,
        place=None if state.pose is None or state.lost else Point2D(state.pose.x_m, state.pose.y_m),
        task="" if state.task is None or state.task.state.ended else state.task.id,
        behavior=state.behavior,
        waits_for=state.waits_for,
        waits_at=state.waits_at or "",
        plugins_out=plugins_out,
    )


class Rate:
    """Rate of a count."""

    def __init__(self, what: str) -> None:
        self.what = what
        self._counts: deque[tuple[int, int]] = deque(maxlen=256)

    def record(self, now_ns: int, count: int) -> None:
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


class TeamMonitor:
    """Follows a team.

    Args:
        wire: its endpoint.
        expected: robots that are listed even if no message of them has arrived.

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
        self._counts: dict[str, int] = {}
        self._rates: dict[str, Rate] = {}
        self._truths = 0
        self._sim_time_s = self._before_s = 0.0
        for topic in (ARENA_TRUTH, ROBOT_STATE, COORDINATOR_STATE, RECORDER_STATE):
            wire.subscribe(self._inbox, topic)

    def update(self) -> None:
        """Process arrived messages."""
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
                self._counts[message.robot] = self._counts.get(message.robot, 0) + 1
                self._record_rate(message.robot, STATES, now_ns, self._counts[message.robot])
            elif received.topic is COORDINATOR_STATE:
                self.team_state = message
                self._record_rate(COORDINATOR, RECEIVED, now_ns, message.messages)
            else:
                self._record_rate(RECORDER, RECEIVED, now_ns, message.messages)
        self._coordinator.changes()
        self.has_coordinator = bool(self._coordinator.present)

    @property
    def states(self) -> dict[str, RobotState]:
        """The last state of each robot."""
        return {name: robot.state for name, robot in self._roster.robots.items() if robot.state is not None}

    @property
    def explored_fraction(self) -> float:
        """Share of the simulated floor that is explored; 0 without an arena."""
        return 0.0 if self.truth is None else self.truth.explored_fraction

    @property
    def sim_time_s(self) -> float:
        """Simulated time of all arenas, one after the other."""
        return self._before_s + self._sim_time_s

    def robots(self) -> list[RobotSeen]:
        """The expected robots, and the present ones, by name."""
        now_ns = self._clock.now_ns()
        names = [*self._expected, *sorted(set(self._roster.robots) - set(self._expected))]
        return [self._seen(name, now_ns) for name in names]

    def messages(self, member: str) -> str:
        """Rate of a member's messages, in words; empty if unknown."""
        rate = self._rates.get(member)
        per_s = rate.per_s(self._clock.now_ns()) if rate is not None else None
        return "" if rate is None or per_s is None else f"{per_s:.1f} {rate.what}/s"

    def last_pose(self, robot: str) -> Pose2D | None:
        """Reported pose of a robot, arena frame; None if it has not reported one, or has lost its pose."""
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
            status = robot_status(name, robot.state)
            behavior = status.behavior if status.condition is RobotCondition.UP else ""
            return RobotSeen(name, behavior or status.condition, is_up=True)
        return RobotSeen(name, sentence_of(robot.down_reason(now_ns)), is_up=False)

    def _record_truth(self, truth: ArenaTruth) -> None:
        if truth.sim_time_s < self._sim_time_s:  # of another arena, which starts again
            self._before_s += self._sim_time_s
        self.truth, self._sim_time_s = truth, truth.sim_time_s
        self._truths += 1

    def _record_rate(self, member: str, what: str, now_ns: int, count: int) -> None:
        if member not in self._rates and len(self._rates) < MEMBERS_MAX:
            self._rates[member] = Rate(what)
        if member in self._rates:
            self._rates[member].record(now_ns, count)
