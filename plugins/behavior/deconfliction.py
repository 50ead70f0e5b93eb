"""Deconfliction: priority where robots meet, and how far each may drive along its path.

`Encounter` is the set of other robots around a robot at one moment. `TravelClaim` is its right of way among them. `Leg`
is the path that it drives as far as they permit, and that it publishes.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from robrain.agent.board import Board
from robrain.algorithms.mapping.zone_grid import LIMIT_AHEAD_M
from robrain.algorithms.navigation.navigation_grid import Swath
from robrain.algorithms.navigation.right_of_way import (
    LOOK_AHEAD_M,
    STEP_M,
    DrivenPath,
    Margins,
    PathOrder,
    Release,
    Track,
    meet,
    orders,
    release,
)
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.plugins.skill.localisation import LocalisationInterface
from robrain.plugins.skill.mapper.mapper import MapCells
from robrain.plugins.skill.planner import Circle
from robrain.plugins.unit.driver.interface import DriverInterface
from robrain.plugins.unit.teammates import Doing, NearbyRobot
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import PlannedPath
from robrain.protocol.model.claim import LEFT_WEIGHT, PRIORITY_S, Claim
from robrain.protocol.model.geometry import Point2D, Pose2D

MARGINS = Margins()
REFUGE_M = 0.22
"""Distance between two hulls in a refuge, chosen: it covers the clearance and the driver's stop short of its goal."""
ZONE_AHEAD_M = 8.0
"""Length of a teammate's path to keep free for it, chosen: as far as teammates' paths are considered."""
ROOM_S = 8.0
"""An idle robot makes room for a teammate that will arrive within this time."""
PRESSED_S = 2.5
"""A robot without a refuge reports this when a teammate could arrive within this time. Earlier, the teammate may be
waiting for others."""
CORNERED_AGAIN_S = 4.0
"""Least time between two reports of a robot that has nowhere to go, chosen. The others need time to make room."""
AHEAD = round(1.0 / STEP_M)
"""Positions ahead to which the direction of a path is taken."""
STATIONARY_NS = to_ns(3.0)
"""A robot on another's path goes first until it has stood for this time (chosen). Then claims decide."""
PRIORITY_MAX = 100.0
"""Where robots meet, a task's priority counts up to this."""
NEAR_END_M = 0.3
"""The driver receives a longer released path when it grows by this length, or when the robot comes this near to its
end."""


class Encounter:
    """The other robots around a robot, as the robot sees them.

    Args:
        robot: the robot's name.
        claim: its claim.
        radius_m: its radius.
        teammates: the robots around it.
        speed_m_s: its speed.
        own: (N, 2), its remaining path from where it is; None if it is bound for nowhere.
        stationary_since_ns: time since which it has not moved.
        now_ns: the time.

    """

    def __init__(
        self,
        robot: str,
        claim: Claim,
        radius_m: float,
        teammates: Sequence[NearbyRobot],
        speed_m_s: float,
        own: Floats | None = None,
        stationary_since_ns: int = 0,
        now_ns: int = 0,
    ) -> None:
        self.radius_m = radius_m
        self.teammates = teammates
        self._speed_m_s = speed_m_s
        self.tracks = list[Track]()
        self.leader: NearbyRobot | None = None
        """The robot behind which this one drives."""
        found = [0] * len(teammates)
        if own is not None and teammates:
            found = orders(own, [teammate.track for teammate in teammates], radius_m + MARGINS.contest_m)
        rank, moved_ns = claim.rank(robot), now_ns - STATIONARY_NS
        for teammate, order in zip(teammates, found, strict=True):
            track, goes_first, keep_m = teammate.track, False, teammate.radius_m + radius_m
            if teammate.doing is Doing.MOVING:
                goes_first = (teammate.rank or teammate.claim.rank(teammate.name)) < rank
                if teammate.claim.cornered == claim.cornered:
                    if order == PathOrder.OWN and stationary_since_ns >= moved_ns:
                        goes_first = False
                    elif order >= PathOrder.OTHER and teammate.stationary_since_ns >= moved_ns:
                        goes_first = True
                if order == PathOrder.LEADS:
                    self.leader = teammate
            self.tracks.append(Track(track.positions, track.speed_m_s, track.held_at, keep_m, goes_first=goes_first))

    def release(self, ahead: Floats) -> Release:
        """Released part of the positions (N, 2)."""
        return release(ahead, self._speed_m_s, self.tracks, MARGINS)

    def guard(self, ahead: Floats) -> Release:
        """How far a robot that makes room may go without touching another robot."""
        return release(ahead, self._speed_m_s, self.tracks, MARGINS, yields=False)

    def pressing(self, here: Floats, within_s: float) -> list[str]:
        """Names of the robots with priority that will pass these positions (N, 2) within that time."""
        found = []
        for teammate, track in zip(self.teammates, self.tracks, strict=True):
            if track.goes_first:
                soon = 1 + round(within_s * track.speed_m_s / STEP_M)
                if meet(here, track, MARGINS.contest_m, soon):
                    found.append(teammate.name)
        return found

    def is_oncoming(self, index: int, ahead: Floats) -> bool:
        """Whether a teammate drives against the direction of a path (N, 2)."""
        theirs = self.tracks[index].positions
        own_m, their_m = ahead[min(AHEAD, len(ahead) - 1)] - ahead[0], theirs[min(AHEAD, len(theirs) - 1)] - theirs[0]
        return bool(own_m[0] * their_m[0] + own_m[1] * their_m[1] < 0.0)

    def passes_in_s(self, index: int, ahead: Floats) -> float:
        """Time until a teammate has passed positions (N, 2), if nothing holds it up."""
        track = self.tracks[index]
        apart_m = np.hypot(*(track.positions[:, np.newaxis] - ahead).transpose(2, 0, 1)).min(axis=1)
        last = np.flatnonzero(apart_m < track.keep_m + MARGINS.contest_m)
        return STEP_M * float(last[-1]) / max(track.speed_m_s, STEP_M) if len(last) else 0.0

    def still_meets(self, ahead: Floats, names: Sequence[str]) -> bool:
        """Whether the path of any of these teammates meets that of the robot, regardless of priority."""
        return any(
            meet(ahead, track, MARGINS.contest_m)
            for teammate, track in zip(self.teammates, self.tracks, strict=True)
            if teammate.name in names
        )

    def to_escape(self, pressed_by: NearbyRobot | None = None) -> tuple[float, list[Track], float]:
        """Input of the planner for finding a refuge: own speed, tracks, distance between hulls.

        If a robot presses this one, robots with lower priority do not count: they yield in turn. Neither do those that
        act by the claim of the first.
        """
        owner = "" if pressed_by is None else pressed_by.claim.lent_by or pressed_by.name
        tracks = []
        for teammate, track in zip(self.teammates, self.tracks, strict=True):
            makes_room = teammate is not pressed_by and (not track.goes_first or teammate.claim.lent_by == owner)
            if not owner or teammate.doing is Doing.OBSTACLE or not makes_room:
                tracks.append(track)
        return self._speed_m_s, tracks, REFUGE_M


def circles(teammates: Sequence[NearbyRobot], margin_m: float, doing: Doing) -> list[Circle]:
    """Places of teammates of one kind, with a margin beyond their radius."""
    return [
        (teammate.pose.x_m, teammate.pose.y_m, teammate.radius_m + margin_m)
        for teammate in teammates
        if teammate.doing is doing
    ]


def swaths(teammates: Sequence[NearbyRobot], encounter: Encounter, margin_m: float) -> list[Swath]:
    """Floor to keep free for others: the paths of robots with priority, and the places of waiting robots."""
    found = []
    for teammate, track in zip(teammates, encounter.tracks, strict=True):
        ahead = round(ZONE_AHEAD_M / STEP_M) if track.goes_first else 1
        found.append(Swath(track.positions[:ahead], teammate.radius_m + margin_m))
    return found


class TravelClaim:
    """The claim of one robot while it travels."""

    def __init__(self) -> None:
        self._own = Claim()
        self._begun_s = 0.0
        """Time at which the travel began, less what its priority counts."""
        self._lent: Claim | None = None
        """Claim of the robot for which it makes room."""
        self._led: Claim | None = None
        """Claim of the robot behind which it drives."""
        self._cornered_ns = -to_ns(CORNERED_AGAIN_S)
        self._cornered_by: list[str] = []
        """The teammates that must give way, because this robot cannot."""

    @property
    def claim(self) -> Claim:
        """Claim by which the robot acts, and which it publishes."""
        if self._lent is not None:
            return self._lent
        return self._own if self._own.cornered or self._led is None else self._led

    def set_out(self, priority: float, now_ns: int) -> None:
        """Begin a new travel."""
        self._begun_s = to_seconds(now_ns) - PRIORITY_S * min(priority, PRIORITY_MAX)
        self._own = Claim()
        self._lent = self._led = None
        self._cornered_by = []

    def follow(self, leader: NearbyRobot | None) -> None:
        """Act by the claim of the robot behind which this robot drives, if there is one."""
        self._led = None if leader is None else leader.claim.lend(leader.name, to_follower=True)

    def make_room_for(self, teammate: NearbyRobot) -> None:
        """Act by that teammate's claim, until `restore`."""
        self._lent = teammate.claim.lend(teammate.name)

    def restore(self, left_s: float) -> None:
        """Act by its own claim again; its path still takes that long."""
        self._own = msgspec.structs.replace(self._own, order_s=round(self._begun_s + LEFT_WEIGHT * left_s, 1))
        self._lent = None

    def has_no_refuge(self, encounter: Encounter, here: Floats, now_ns: int) -> None:
        """Record that there is no refuge; it is reported once a robot is near enough to wait for it."""
        pressed_by = encounter.pressing(here, PRESSED_S)
        if pressed_by and now_ns - self._cornered_ns >= to_ns(CORNERED_AGAIN_S):
            self._cornered_ns = now_ns
            self._cornered_by = sorted({*self._cornered_by, *pressed_by})
            most = max(teammate.claim.cornered for teammate in encounter.teammates if teammate.name in pressed_by)
            self._own = msgspec.structs.replace(self._own, cornered=1 + most)

    def relieve(self, encounter: Encounter, ahead: Floats) -> None:
        """End the cornered state once the paths of those that had to give way no longer meet the robot's path."""
        if self._cornered_by and not encounter.still_meets(ahead, self._cornered_by):
            self._cornered_by = []
            self._own = msgspec.structs.replace(self._own, cornered=0)


class Outlet(NamedTuple):
    """Outputs of a leg: to the driver, and to the team."""

    robot: str
    speed_m_s: float
    driver: DriverInterface
    localisation: LocalisationInterface
    publish: Callable[[PlannedPath], None]
    view: Callable[[], MapCells]
    board: Board


class Leg:
    """A path from where the robot is.

    Args:
        outlet: receives the released path.
        pose: T_arena_robot now.
        path: points to drive along, arena frame, at least one.
        is_escape: whether it leads out of others' path instead of to the goal.
        is_narrow: whether it leads through narrow places, where the robot has to squeeze.

    """

    def __init__(
        self, outlet: Outlet, pose: Pose2D, path: list[Point2D], *, is_escape: bool = False, is_narrow: bool = False
    ) -> None:
        self.is_escape = is_escape
        self.is_narrow = is_narrow
        self.path = DrivenPath(np.array([(pose.x_m, pose.y_m), *[(point.x_m, point.y_m) for point in path]]))
        self.end = path[-1]
        self._outlet = outlet
        self._released_m = -1.0
        """Length of the path sent to the driver; below 0 for none."""
        self._fastest_m_s = math.inf
        """Speed limit that the driver has."""
        self._reported: tuple[Claim, float | None] | None = None

    def guard(self, encounter: Encounter, pose: Pose2D) -> Release:
        """How far the robot may go along it without touching another robot."""
        return encounter.guard(self.path.ahead(pose.x_m, pose.y_m, LOOK_AHEAD_M))

    def left(self) -> list[Point2D]:
        """The remaining points."""
        return _points(self.path, math.inf)

    def drive(self, allowed: Release, claim: Claim) -> None:
        """Go this far, and publish the path."""
        route, has_other_limit = self.path, self._has_other_limit()
        if allowed.is_whole:
            if has_other_limit or self._released_m < route.length_m:
                self._send(route.length_m)
            self._publish(claim, None)
        elif allowed.positions < 2:
            self.stop(claim)
        else:
            until_m = route.passed_m + (allowed.positions - 1) * STEP_M
            more_m = until_m - self._released_m
            is_near_end = self._released_m - route.passed_m < NEAR_END_M
            if has_other_limit or more_m < 0 or more_m > NEAR_END_M or (is_near_end and more_m > 0.5 * STEP_M):
                self._send(until_m)
            self._publish(claim, until_m)

    def stop(self, claim: Claim) -> None:
        """Stop, and publish that the robot waits."""
        if self._released_m != self.path.passed_m:
            self._outlet.driver.stop()
            self._released_m = self.path.passed_m
        self._publish(claim, self.path.passed_m)

    def cut(self, pose: Pose2D, more_m: float) -> "Leg | None":
        """The remaining path within that distance, up to its released end; None if nothing remains."""
        until_m = min(self._released_m, self.path.passed_m + more_m)
        if until_m <= self.path.passed_m:
            return None
        return Leg(self._outlet, pose, _points(self.path, until_m), is_narrow=self.is_narrow)

    def _has_other_limit(self) -> bool:
        """Update the speed limit; whether it is another than before."""
        zones, was_m_s = self._outlet.view().zones, self._fastest_m_s
        if zones is None:
            self._fastest_m_s = math.inf
        else:
            pose = self._outlet.localisation.pose()
            self._fastest_m_s = zones.fastest_m_s(self.path.ahead(pose.x_m, pose.y_m, LIMIT_AHEAD_M))
        self._outlet.board.is_slowed = self._fastest_m_s < self._outlet.speed_m_s
        return self._fastest_m_s != was_m_s

    def _send(self, until_m: float) -> None:
        self._released_m = until_m
        path = self._outlet.localisation.to_odom(_points(self.path, until_m))
        self._outlet.driver.follow(path, self._fastest_m_s, is_narrow=self.is_narrow)

    def _publish(self, claim: Claim, until_m: float | None) -> None:
        """Publish the path if it has changed."""
        word = claim, None if until_m is None else round(2.0 * until_m) / 2.0
        if word == self._reported:
            return
        self._reported = word
        route, outlet = self.path, self._outlet
        pose = outlet.localisation.pose()
        outlet.publish(
            PlannedPath(
                robot=outlet.robot,
                points=[Point2D(pose.x_m, pose.y_m), *_points(route, math.inf)],
                claim=claim,
                speed_m_s=outlet.speed_m_s,
                held_at_m=None if until_m is None else max(0.0, until_m - route.passed_m),
            )
        )


def _points(route: DrivenPath, until_m: float) -> list[Point2D]:
    return [Point2D(float(x_m), float(y_m)) for x_m, y_m in route.points_until(until_m)]
