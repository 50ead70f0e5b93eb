"""Teammates: places, paths and motion of the other robots, by their messages."""

import itertools
import math
from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import Protocol

import msgspec
import numpy as np

from robrain.agent.plugin import Unit, external
from robrain.algorithms.navigation.reservations import ReservedArea, TeammateRequests, blockers
from robrain.algorithms.navigation.right_of_way import (
    LONGEST_M,
    STEP_M,
    TEAMMATE_AHEAD_M,
    Track,
    any_within,
    pass_on,
    sample_path,
)
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.border.border import Received
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import (
    RESERVATIONS_MAX,
    ROBOT_PATH,
    ROBOT_STATE,
    PlannedPath,
    RobotState,
)
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.claim import Claim, Rank, Reservation, ZoneNames
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.map_frame import ARENA, MapFrame
from robrain.protocol.model.ranges import Positive
from robrain.protocol.model.tasks.task import ENDED


class Teammate(msgspec.Struct, frozen=True):
    """Another robot, in the map frame of the one that asks."""

    name: str
    pose: Pose2D
    velocity: Twist2D
    radius_m: float


class Doing(StrEnum):
    """Expected motion of a teammate."""

    MOVING = "under way"
    """It follows its path, or waits on it for others."""
    IDLE = "idle"
    """It has no path, and may be given one at any time."""
    OBSTACLE = "obstacle"
    """It is halted, silent or lost, or it does not move although no robot holds it up. It is assumed to stay where it
    was last seen."""


class NearbyRobot(msgspec.Struct, frozen=True, eq=False):
    """Another robot, as seen by a robot that drives."""

    name: str
    pose: Pose2D
    radius_m: float
    """Larger than the true radius for a lost robot."""
    doing: Doing
    claim: Claim
    track: Track
    """Its remaining path; its `keep_m` is this teammate's radius alone, and the user fills in `goes_first`."""
    task: str
    """The id of the task that it is at; empty if none."""
    bound: Point2D
    """Where its path ends; where it is if it has none."""
    behavior: str = ""
    """Behavior that drives the robot."""
    endurance_s: float = math.inf
    """Guaranteed time of its battery at its usual power; inf if it reports none."""
    stationary_since_ns: int = 0
    """Time since which it has not moved."""
    rank: Rank | None = None
    """`claim.rank(name)`, if it has been computed."""


class TeammatesInterface(Protocol):
    """The other robots.

    A robot that publishes its pose in another map frame than this robot's has no known place.
    """

    def others(self) -> list[Teammate]:
        """Robots received within the last two seconds, by name, in the robot's map frame."""

    def in_frame(self, frame: MapFrame) -> list[Teammate]:
        """Robots received within the last two seconds with poses in a map frame, by name."""

    def count(self) -> int:
        """Number of robots received within the last two seconds, in any map frame."""

    def nearby(self, place: Point2D, within_m: float) -> list[NearbyRobot]:
        """Those that are, or are bound, within a distance of a place, by name; also those that have fallen silent."""

    def reserve(self, wanted: Sequence[tuple[ReservedArea, bool]]) -> dict[ZoneNames, list[str]]:
        """Request these areas, and release all others.

        Args:
            wanted: the areas, and whether the robot is there already.

        Returns:
            For each area the robots for which the robot waits, itself while it starts; none if it may drive there.

        """

    def is_wanted(self, area: ReservedArea) -> bool:
        """Whether another robot waits for an area that this robot has."""


RECEIVE_NS = to_ns(0.15)
"""Each teammate sends ten states a second; every second one is enough, and decoding dominates the cost."""
TEAMMATES_MAX = 4096
"""Largest number of robots that are tracked."""

MOVED_M = 0.1
"""Less than this is no motion."""
AT_END = 3
"""Remaining positions of a path that counts as driven: 0.2 m, as near as drivers get."""
AHEAD = round(TEAMMATE_AHEAD_M / STEP_M)
"""Number of checked positions of a path."""
ROLLS_M_S = 0.1
ROLLS_S = 1.5
"""Time that a robot faster than `ROLLS_M_S` without a path is assumed to go straight on."""
LEAST_W = 0.1
START_NS = to_ns(3.0)
"""Time after its start in which a robot neither grants nor gets zones (chosen): it receives its team and the zones."""
LATE_NS = to_ns(60.0)
"""A state that is older than the last by less than this was overtaken by it; otherwise the robot's clock was set."""
LOST_MARGIN_M = 0.5
"""Distance kept from a lost teammate, beyond its radius; chosen."""


Box = tuple[float, float, float, float]
"""Least x and y, greatest x and y."""


class KnownTeammate:
    """State and path that one other robot has published.

    Args:
        name: its name.
        wanted: limits for silent and stalled teammates.

    """

    def __init__(self, name: str, wanted: "Teammates.Parameters") -> None:
        self.name = name
        self.received_ns = 0
        """Time of the last reception of its state."""
        self.spoke_ns = 0
        """When anything was."""
        self.teammate: Teammate | None = None
        """None before it has published its pose."""
        self.frame = ARENA
        """The map frame of its pose."""
        self.state: RobotState | None = None
        """The last with a pose."""
        self.path: Floats | None = None
        """(N, 2) positions of the path that it drives; None if it has none."""
        self.box: Box | None = None
        """Around the whole path."""
        self.passed = 0
        """The position of it that it has passed."""
        self.bound: Point2D | None = None
        """Where the path ends."""
        self.claim = Claim()
        self.rank = self.claim.rank(name)
        self.speed_m_s = self.default_speed_m_s = wanted.speed_m_s
        self.held_at_m: float | None = None
        self.moved_ns = 0
        """When it was last seen to move, or was given reason to."""
        self.stationary_since_ns = 0
        """Time since which it has not moved."""
        self.moved_at: Pose2D | None = None
        self.stalled_ns = to_ns(wanted.stalled_s)
        self.cached: NearbyRobot | None = None
        """The last prediction; None after a newer message."""
        self.requests: Sequence[Reservation] = ()
        """Requests for zones in its last state."""
        self.has_reserved = False
        """Whether some of them are its own."""


# Each of these handles all teammates at once: calls dominate the cost of a large team.


def receive_states(reported: Iterable[tuple[KnownTeammate, RobotState]], now_ns: int) -> None:
    """Take states of teammates."""
    for known, state in reported:
        known.spoke_ns = now_ns
        pose = state.pose
        last = known.state
        if pose is None:
            continue
        if known.requests and last is not None and 0 < last.stamp_ns - state.stamp_ns < LATE_NS:
            continue  # an older message must not undo a request
        known.received_ns = now_ns
        known.state, known.frame, known.cached = state, state.frame, None
        if state.reservations or known.requests:
            known.requests = state.reservations or ()
            known.has_reserved = any(one.robot == known.name for one in known.requests)
        known.teammate = Teammate(known.name, pose, state.velocity, state.radius_m)
        at = known.moved_at
        # Each robot does this for each other: a call for it would be a thirtieth of all calls among 64 robots.
        if at is None or math.hypot(pose.x_m - at.x_m, pose.y_m - at.y_m) > MOVED_M:
            known.moved_at, known.moved_ns, known.stationary_since_ns = pose, now_ns, now_ns


def receive_paths(reported: Sequence[tuple[KnownTeammate, PlannedPath]], now_ns: int) -> None:
    """Take paths of teammates, at most one of each."""
    _pass_on([known for known, _ in reported])
    for known, path in reported:
        known.spoke_ns = now_ns
        is_driving = known.teammate is not None and known.path is not None and len(known.path) - known.passed > AT_END
        if known.held_at_m is not None or not is_driving:
            known.moved_ns = now_ns  # it has been waiting or standing, and only now may be expected to move
        if path.points:
            (known.path, known.box), known.bound = path.derived(_path_of), path.points[-1]
        else:
            known.path = known.box = known.bound = None
        known.passed = 0
        if path.claim != known.claim:
            known.claim, known.rank = path.claim, path.claim.rank(known.name)
        known.speed_m_s = path.speed_m_s if path.speed_m_s > 0 else known.default_speed_m_s
        known.held_at_m = path.held_at_m
        known.cached = None


def _path_of(path: PlannedPath) -> tuple[Floats, Box]:
    """(N, 2) positions along a path that is not empty, and the box around it."""
    xs, ys = [point.x_m for point in path.points], [point.y_m for point in path.points]
    return sample_path(np.array([*zip(xs, ys, strict=True)]), LONGEST_M), (min(xs), min(ys), max(xs), max(ys))


def reckon(teammates: Iterable[KnownTeammate], now_ns: int, fresh_ns: int) -> list[NearbyRobot]:
    """Predictions of the teammates, without those that have not published their pose."""
    placed = [known for known in teammates if known.teammate is not None]
    silent_ns = now_ns - fresh_ns
    stale = [known for known in placed if known.cached is None or known.received_ns < silent_ns]
    _pass_on(stale)
    for known in stale:
        teammate, state, route = known.teammate, known.state, known.path
        if teammate is None or state is None:
            continue
        pose, held_at_m = teammate.pose, known.held_at_m
        radius_m = teammate.radius_m + LOST_MARGIN_M if state.lost else teammate.radius_m
        bound, rest = Point2D(pose.x_m, pose.y_m), None
        doing = Doing.OBSTACLE
        if known.received_ns >= silent_ns and not state.halted and not state.lost:
            rest = None if route is None else route[known.passed + 1 : known.passed + 1 + AHEAD]
            if rest is None or len(rest) < AT_END:
                doing = Doing.IDLE
            elif held_at_m is not None or now_ns - known.moved_ns <= known.stalled_ns:
                doing = Doing.MOVING
        if doing is Doing.MOVING and rest is not None and known.bound is not None:
            bound, speed_m_s, held_at = known.bound, known.speed_m_s, len(rest)
            positions = np.empty((held_at + 1, 2))
            positions[0] = pose.x_m, pose.y_m
            positions[1:] = rest
            if held_at_m is not None:
                held_at = max(0, min(held_at, round((held_at_m - known.passed * STEP_M) / STEP_M)))
        else:
            positions, speed_m_s = _rolling_on(teammate, is_fresh=known.received_ns >= silent_ns)
            held_at = len(positions) - 1
        energy, task = state.energy, state.task
        known.cached = NearbyRobot(
            known.name,
            pose,
            radius_m,
            doing,
            known.claim,
            Track(positions, speed_m_s, held_at, radius_m, goes_first=False),
            "" if task is None or task.state in ENDED else task.id,
            bound,
            state.behavior,
            math.inf if energy is None else energy.usable_j / max(energy.usual_power_w, LEAST_W),
            known.stationary_since_ns,
            known.rank,
        )
    return [known.cached for known in placed if known.cached is not None]


def _pass_on(teammates: Iterable[KnownTeammate]) -> None:
    """Record the progress of teammates along their paths."""
    driving, routes, passed, places = [], [], [], []
    for known in teammates:
        if known.path is not None and known.teammate is not None:
            driving.append(known)
            routes.append(known.path)
            passed.append(known.passed)
            places.append((known.teammate.pose.x_m, known.teammate.pose.y_m))
    if driving:
        for known, now in zip(driving, pass_on(routes, passed, np.array(places)), strict=True):
            known.passed = now


def _rolling_on(teammate: Teammate, *, is_fresh: bool) -> tuple[Floats, float]:
    """Predicted positions and speed of a teammate without a path: its place and, while it moves, straight on."""
    pose, velocity = teammate.pose, teammate.velocity
    speed_m_s = math.hypot(velocity.forward_m_s, velocity.left_m_s)
    if not is_fresh or speed_m_s <= ROLLS_M_S:
        return np.array(((pose.x_m, pose.y_m),)), speed_m_s
    heading_rad = pose.yaw_rad + math.atan2(velocity.left_m_s, velocity.forward_m_s)
    along_m = STEP_M * np.arange(math.ceil(speed_m_s * ROLLS_S / STEP_M) + 1)
    ahead = np.stack((pose.x_m + along_m * math.cos(heading_rad), pose.y_m + along_m * math.sin(heading_rad)), axis=1)
    return ahead, speed_m_s


def may_be_near(teammates: Iterable[KnownTeammate], place: Point2D, within_m: float) -> list[KnownTeammate]:
    """All that are, may roll, or are bound within a distance of a place, and some others."""
    x_m, y_m, found = place.x_m, place.y_m, []
    for known in teammates:
        teammate, box = known.teammate, known.box
        if teammate is None:
            continue
        pose, velocity = teammate.pose, teammate.velocity
        reach_m = within_m + ROLLS_S * (abs(velocity.forward_m_s) + abs(velocity.left_m_s)) + STEP_M
        is_here = abs(pose.x_m - x_m) <= reach_m and abs(pose.y_m - y_m) <= reach_m
        if is_here or (
            box is not None
            and box[0] - within_m <= x_m <= box[2] + within_m
            and box[1] - within_m <= y_m <= box[3] + within_m
        ):
            found.append(known)
    return found


def near(teammates: Sequence[NearbyRobot], place: Point2D, within_m: float) -> list[NearbyRobot]:
    """Those that are, or are bound, within a distance of a place."""
    return list(itertools.compress(teammates, any_within([teammate.track for teammate in teammates], place, within_m)))


class Teammates(Unit):
    """Tracks places and paths of the other robots."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """Limits for silent and stalled teammates.

        All are chosen.
        """

        fresh_s: Positive = 2.0
        """Time of silence after which a robot counts as lost, and as an obstacle at its last place."""
        remember_s: Positive = 60.0
        """Time after which a lost robot is forgotten; by then the lidar has mapped it if it is still there."""
        stalled_s: Positive = 4.0
        """Time without motion after which a driving robot counts as an obstacle, unless it waits for another robot."""
        speed_m_s: Positive = 0.6
        """Speed assumed for a robot that does not publish one."""

    interface = TeammatesInterface
    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        self._inbox = Inbox()
        self._next_ns = 0
        self._known: dict[str, KnownTeammate] = {}
        self._own: dict[ZoneNames, Reservation] = {}
        """This robot's requests."""
        self._began_ns: int | None = None
        self._fresh_ns = to_ns(self.parameters.fresh_s)
        self._remember_ns = to_ns(self.parameters.remember_s)

    def activate(self) -> None:
        self._guard = RecordGuard(self.env.wire.refusals)
        self.env.wire.subscribe(self._inbox, ROBOT_STATE)
        self.env.wire.subscribe(self._inbox, ROBOT_PATH)

    def emergency_halt(self) -> None:
        self._own = {names: one for names, one in self._own.items() if one.has}

    def step(self) -> None:
        self._publish_requests(self._receive())

    @external
    def others(self) -> list[Teammate]:
        """Robots received within the last two seconds, by name, in the robot's map frame."""
        return self.in_frame(self.env.board.frame)

    def in_frame(self, frame: MapFrame) -> list[Teammate]:
        """Robots received within the last two seconds with poses in a map frame, by name."""
        now_ns = self._receive()
        return [
            known.teammate
            for known in self._known.values()
            if known.teammate is not None and known.frame == frame and now_ns - known.received_ns <= self._fresh_ns
        ]

    def count(self) -> int:
        """Number of robots received within the last two seconds, in any map frame."""
        now_ns = self._receive()
        return sum(now_ns - known.received_ns <= self._fresh_ns for known in self._known.values())

    def nearby(self, place: Point2D, within_m: float) -> list[NearbyRobot]:
        """Those that are, or are bound, within a distance of a place, by name; also those that have fallen silent."""
        now_ns = self._receive()
        frame = self.env.board.frame
        here = [known for known in self._known.values() if known.frame == frame]
        return near(reckon(may_be_near(here, place, within_m), now_ns, self._fresh_ns), place, within_m)

    def reserve(self, wanted: Sequence[tuple[ReservedArea, bool]]) -> dict[ZoneNames, list[str]]:
        """Request these areas, and release all others; returns the robots for which it waits."""
        if not wanted and not self._own:
            return {}
        now_ns, robot = self._receive(), self.env.robot
        self._own = {
            area.names: self._own.get(area.names) or Reservation(robot=robot, zones=area.names, since_ns=now_ns)
            for area, _ in wanted
        }
        waits = dict[ZoneNames, list[str]]()
        others = self._requests(now_ns)
        for area, is_there in wanted:
            own, robots = self._own[area.names], list[str]()
            if not own.has:
                if area.is_exclusive and not is_there:
                    robots = [robot] if self._is_starting(now_ns) else blockers(own, others)
                self._own[area.names] = msgspec.structs.replace(own, has=not robots)
            waits[area.names] = robots
        self._publish_requests(now_ns)
        return waits

    def is_wanted(self, area: ReservedArea) -> bool:
        """Whether another robot waits for an area that this robot has."""
        names = set(area.names)
        return any(
            not one.has and not names.isdisjoint(one.zones)
            for name, received in self._requests(self.env.clock.now_ns()).items()
            for one in received.reservations
            if received.is_fresh and one.robot == name
        )

    def _requests(self, now_ns: int) -> dict[str, TeammateRequests]:
        """The requests that the robots that obey zones have published."""
        return {
            known.name: TeammateRequests(known.requests, now_ns - known.received_ns <= self._fresh_ns)
            for known in self._known.values()
            if known.state is not None and known.state.reservations is not msgspec.UNSET
        }

    def _publish_requests(self, now_ns: int) -> None:
        there = [known for known in self._known.values() if known.has_reserved]
        theirs = [one for known in there for one in known.requests if one.robot == known.name]
        found = () if self._is_starting(now_ns) else (*self._own.values(), *theirs)
        self.env.board.reservations = found[:RESERVATIONS_MAX]

    def _is_starting(self, now_ns: int) -> bool:
        if self._began_ns is None:
            self._began_ns = now_ns
        return now_ns - self._began_ns < START_NS

    def _receive(self) -> int:
        now_ns = self.env.clock.now_ns()
        if now_ns < self._next_ns:
            return now_ns
        if not self._inbox.has_some:
            return now_ns
        self._next_ns = now_ns + RECEIVE_NS
        count = len(self._known)
        self._guard.batch(self._inbox.drain(), self._handle)
        too_old_ns = now_ns - self._remember_ns
        oldest_ns = min([known.spoke_ns for known in self._known.values()], default=now_ns)
        if len(self._known) != count or oldest_ns < too_old_ns:
            by_name = sorted(self._known.items())
            self._known = {name: known for name, known in by_name if known.spoke_ns >= too_old_ns or known.has_reserved}
        return now_ns

    def _handle(self, batch: Sequence[Received]) -> None:
        robot, all_known = self.env.robot, self._known
        states, paths = [], []
        for received in batch:
            message = received.message
            name = message.robot
            if name == robot:
                continue
            known = all_known.get(name)
            if known is None:
                if len(all_known) >= TEAMMATES_MAX:
                    continue
                known = all_known[name] = KnownTeammate(name, self.parameters)
            if received.topic is ROBOT_STATE:
                states.append((known, message))
            else:
                paths.append((known, message))
        now_ns = self.env.clock.now_ns()
        receive_paths(paths, now_ns)
        receive_states(states, now_ns)
