"""Driver: moves an omnidirectional base smoothly, and stops in front of what lidar and range sensors see.

`follow` is for plugins that replan continuously. `drive_path`, `drive`, `turn` and `go_to` are long actions and return
an id. They end as done, as superseded by the next call that moves the robot, or as failed if it stays blocked.

The robot stops whenever it does not know the space ahead or its motion: without a fresh scan, with a frozen lidar,
without wheel reports. After a bump it does not press on.
"""

import itertools
import math
from operator import attrgetter
from typing import Annotated, NamedTuple

from msgspec import Meta

from robrain.agent.action import Action, Actions
from robrain.agent.plugin import external
from robrain.algorithms.navigation.clearance import LEAST_MARGIN_M, PREFERRED_MARGIN_M, least_clearance_m, least_gap_m
from robrain.algorithms.navigation.obstacles import Passage
from robrain.plugins.device.mocdevice.interface import ControllerStatus, MocDeviceInterface
from robrain.plugins.device.range_sensors import Bump, RangeSensorsInterface
from robrain.plugins.device.scan.interface import ScanInterface
from robrain.plugins.unit.driver.by_hand import ByHand
from robrain.plugins.unit.driver.interface import DriverInterface, Motion, OdometryNoise, OnBase
from robrain.plugins.unit.driver.path import PERIOD_S, Path, Ramp, RampLimits, check_range, speed_to_stop
from robrain.plugins.unit.driver.steering import SLOW_M_S, SPARE_M, Arcs, Steering
from robrain.plugins.unit.obstacle_distance import Lookout
from robrain.protocol.answers.hand_control import HandLease
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.action_messages import ActionId
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D, wrap_angle_rad
from robrain.protocol.model.ranges import Count, Metres, Name, Positive, Radians, Speed

BEGIN_M = 0.3
"""The driver squeezes where normal driving has less room ahead than this."""
SPEED_M_S, WIDE_M_S = 0.15, 0.6
"""Speed at the least clearance and at the preferred one; it grows linearly between them."""
CREEP_M_S = 0.05
"""Least speed between walls, regardless of apparent obstacles ahead: `hold_off` lets the robot slide along walls."""
CENTRING_PER_S = 1.5
CENTRING_M_S = 0.08
SEEN_M = 0.1
"""Walls farther than this from the hull do not count for centring."""
OFF_CENTRE_M = 0.04
"""This far off the middle the robot only creeps ahead."""
BEND_RAD = math.radians(30.0)
"""The robot does not centre itself where the path bends by more than this."""
TOLERANCE_M = 0.005
"""A gap that seems at most this much wider than the robot is not entered."""
ASIDE_RAD = tuple(math.radians(degrees) for degrees in (10.0, -10.0, 20.0, -20.0))
"""Seen at an angle a gap seems narrower than it is. Where the path is not parallel to the walls, one of these is."""
KEEP_M = 0.01
KEEP_PER_S = 1.5


class Squeeze(NamedTuple):
    """Motion in a narrow place."""

    heading_rad: float
    """Direction, frame odom."""
    speed_m_s: float
    """Highest speed in that direction."""
    left_m_s: float
    """Speed to the left of that direction, towards the middle."""
    free_m: float
    """The room ahead."""
    is_between: bool
    """Whether the robot is between walls, or about to be."""
    gap_m: float | None
    """Width between them if the robot does not fit; otherwise None."""

    def velocity_m_s(self, forward_m_s: float) -> tuple[float, float]:
        """Velocity (x, y), frame odom, with `forward_m_s` in the direction `heading_rad`."""
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return forward_m_s * cos - self.left_m_s * sin, forward_m_s * sin + self.left_m_s * cos


def squeeze(lookout: Lookout, pose: Pose2D, target_rad: float, along_rad: float, radius_m: float) -> Squeeze:
    """Motion where there is little room.

    Between walls the robot drives parallel to the path, `along_rad`, because the path may be off the middle by half a
    cell of the map. Before the walls, and where the path bends, it drives towards the path, `target_rad`. Both angles
    are in the frame odom.
    """
    seen_m = radius_m + SEEN_M
    along = lookout.passage(pose, along_rad)
    spare_m = 0.5 * (along.left_m + along.right_m) - least_clearance_m(radius_m)
    share = max(0.0, min(1.0, spare_m / (PREFERRED_MARGIN_M - LEAST_MARGIN_M)))
    speed_m_s = SPEED_M_S + share * (WIDE_M_S - SPEED_M_S)
    gap_m = along.left_m + along.right_m
    reported_gap_m = gap_m if gap_m < least_gap_m(radius_m) else None
    bends = abs(wrap_angle_rad(target_rad - along_rad)) > BEND_RAD
    if bends or max(along.left_m, along.right_m) > seen_m:
        free_m = lookout.passage(pose, target_rad).free_m
        return Squeeze(target_rad, SPEED_M_S if bends else speed_m_s, 0.0, free_m, share < 1.0, reported_gap_m)
    off_m = _off_centre_m(along, seen_m)
    left_m_s = max(-CENTRING_M_S, min(CENTRING_M_S, CENTRING_PER_S * off_m))
    if _is_shut(along, radius_m) and all(
        _is_shut(lookout.passage(pose, along_rad + aside_rad), radius_m) for aside_rad in ASIDE_RAD
    ):
        return Squeeze(along_rad, 0.0, left_m_s, 0.0, True, gap_m)
    speed_m_s = max(CREEP_M_S, speed_m_s * (1.0 - abs(off_m) / OFF_CENTRE_M))
    return Squeeze(along_rad, speed_m_s, left_m_s, along.free_m, share < 1.0, reported_gap_m)


def is_between(lookout: Lookout, pose: Pose2D, along_rad: float, radius_m: float) -> bool:
    """Whether the walls on both sides of the path leave less than the preferred clearance."""
    found = lookout.passage(pose, along_rad)
    return found.left_m + found.right_m < 2.0 * (radius_m + PREFERRED_MARGIN_M)


def _is_shut(found: Passage, radius_m: float) -> bool:
    """Whether a passage seems no wider than the robot.

    Walls are measured by their nearest points, so the noise of the lidar makes both seem too near. A passage that seems
    as wide as the robot therefore counts as wide enough.
    """
    return found.left_m + found.right_m < 2.0 * radius_m + TOLERANCE_M


def _off_centre_m(found: Passage, seen_m: float) -> float:
    """How far to the left the middle of a passage lies; a wall beyond `seen_m` counts as being at `seen_m`."""
    return 0.5 * (min(found.left_m, seen_m) - min(found.right_m, seen_m))


HAND_PERIOD_S = PERIOD_S / 3
HAND_PERIOD_NS = to_ns(HAND_PERIOD_S)
"""Period of the checks for a lapsed lease while driven by hand; it commands at the usual period."""
ARRIVED_M = 0.08
"""Of paths; a plugin that replans continuously needs no more."""
PLACED_M, STEERED_M, PARKED_M = 0.01, 0.03, 0.2
"""Of actions that go to a place; of a base that cannot drive sideways; of one that cannot turn on the spot."""
TURNED_RAD, PARKED_RAD = 0.008, 0.05
BLOCKED_M = 0.02
"""Less room ahead than this counts as none."""
POINTS_MAX = 100_000
_X_Y = attrgetter("x_m", "y_m")
NO_ODOMETRY = "no data from the wheel encoders"
NO_ROOM = "there is no room to turn"
NEEDS_SPEED = "its wheels turn it only while it drives"
PATH_BLOCKED = "an obstacle has blocked the path"
TOO_NARROW = "the path has been too narrow"


class Driver(OnBase):
    """Follows paths; slows down before corners, obstacles and the end."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """Limits of the motion. Values are chosen for a robot in the style of the Robertino."""

        speed_m_s: Positive = 0.6
        """Greatest speed."""
        turn_rate_rad_s: Positive = 1.5
        """Greatest turn rate."""
        acceleration_m_s2: Positive = 0.8
        jerk_m_s3: Positive = 4.0
        turn_acceleration_rad_s2: Positive = 3.0
        turn_jerk_rad_s3: Positive = 20.0
        braking_m_s2: Positive = 1.2
        """Braking for obstacles too near for a smooth stop; the wheels' grip allows a little more."""
        stop_distance_m: Positive = 0.12
        """The robot's edge keeps this distance from obstacles ahead."""
        patience_s: Positive = 10.0
        """Time behind an obstacle after which an action fails."""
        hand_lease_s: Positive = 0.1
        """Time from the last command of driving by hand to the stop of the wheels; at most 2 s."""
        hand_speed_m_s: Positive = 0.25  # with `hand_lease_s`, the robot stands 0.3 s after the last command
        hand_turn_rate_rad_s: Positive = 1.0
        odometry: OdometryNoise = OdometryNoise(
            sigma_m_per_sqrt_m=0.01, sigma_rad_per_sqrt_m=0.005, sigma_rad_per_sqrt_rad=0.01
        )

    interface = DriverInterface
    period_s = PERIOD_S
    parameters: Parameters

    def init(self) -> None:
        limits = self.parameters
        self._ramp = Ramp(RampLimits(limits.acceleration_m_s2, limits.jerk_m_s3))  # of the body, frame odom
        self._turn = Ramp(RampLimits(limits.turn_acceleration_rad_s2, limits.turn_jerk_rad_s3))
        self._arcs: Arcs | None = None
        """Of a base that cannot turn on the spot."""
        self._hand = ByHand(limits.hand_lease_s)
        self._actions = Actions(self.env, self.progress, self.finished)
        self._action: Action | None = None
        self._path: Path | None = None
        self._to_turn_rad = 0.0
        self._length = 0.0
        """Of the whole action, in metres or radians."""
        self._last_yaw_rad = 0.0
        self._motion = Motion.STOPPED
        self._blocked_since_ns: int | None = None
        self._reason = ""
        self._gap_m: float | None = None
        self._squeezes = False

    def activate(self) -> None:
        self._moc = self.env.use("mocdevice", MocDeviceInterface)
        scan = self.env.use("scan", ScanInterface)
        ranges = self.env.use("range_sensors", RangeSensorsInterface)
        self.env.observe(ranges.bumped, self._bump)
        limits = self.parameters
        self._lookout = Lookout(self._moc, scan, ranges, limits.stop_distance_m)
        self._steering = Steering(
            self._lookout,
            self._ramp,
            self._turn,
            turn_rate_rad_s=limits.turn_rate_rad_s,
            braking_m_s2=limits.braking_m_s2,
            moc=self._moc,
        )
        self._arcs = self._steering.arcs

    def step(self) -> None:
        if self._action is not None and not self._action.is_running:  # ended from elsewhere, as by a halt
            self._stop_moving()
        now_ns = self.env.clock.now_ns()
        if self._hand.has_ended(now_ns + HAND_PERIOD_NS):  # or would, before its next check
            self._release_hand()
        if self._hand.holds(now_ns):
            self._step_by_hand(now_ns, *self._moc.pose_if_fresh())
        elif self._to_turn_rad:
            self._step_turn(*self._moc.pose_if_fresh())
        elif self._path is not None:
            self._step_path(self._path, *self._moc.pose_if_fresh())

    def deactivate(self) -> None:
        self._hand.let_go()
        self._forget()
        self._moc.stop()

    def emergency_halt(self) -> None:
        self._hand.let_go()
        self._forget()

    def follow(self, path: list[Point2D], fastest_m_s: float = math.inf, *, is_narrow: bool = False) -> None:
        """Drive along these points to the last one, at most this fast; `is_narrow` lets it squeeze where needed."""
        check_range("follow", *itertools.chain.from_iterable(map(_X_Y, path)))
        if self._action is not None:
            self._action.supersede()
        new_path = Path(path, ARRIVED_M, fastest_m_s=fastest_m_s, is_narrow=is_narrow) if path else None
        if self._hand.holds(self.env.clock.now_ns()):  # the path waits until the lease ends
            self._path = new_path
        else:
            self._stop_moving() if new_path is None else self._set_out(new_path)

    @external
    def drive_path(self, points: Annotated[list[Point2D], Meta(max_length=POINTS_MAX)]) -> ActionId:
        """Drive along these points, frame odom, to the last one; returns the action's id."""
        if not points:
            raise CallError(ErrorCode.BAD_ARGUMENTS, "drive_path: expected at least one point, got none")
        check_range("drive_path", *itertools.chain.from_iterable(map(_X_Y, points)))
        return self._start_path("drive_path", Path(points, ARRIVED_M))

    @external
    def acquire_hand_lease(self, by: Name) -> HandLease:
        """Take the lease for driving by hand: call `move` with its number, every `renew_s`."""
        return self._hand.lease(by, self.env.clock.now_ns())

    @external
    def move(self, forward_m_s: Speed, left_m_s: Speed, yaw_rad_s: Speed, lease: Count) -> None:
        """Drive by hand at this velocity, body frame, until the lease lapses. Each call renews it; zeros end it.

        The robot still stops before obstacles. Paths given meanwhile wait; actions are cancelled.
        """
        now_ns = self.env.clock.now_ns()
        had_it = self._hand.holds(now_ns)
        self._hand.ask(Twist2D(forward_m_s, left_m_s, yaw_rad_s), lease, now_ns)
        if has_it := self._hand.holds(now_ns):
            self._actions.cancel_all("the robot is driven by hand")
            if self._action is not None:  # its path ends with it; a path from `follow` waits
                self._action = self._path = None
            self._motion = Motion.DRIVING
        if has_it != had_it:  # not each time: the ramps count on their period
            self.period_s = HAND_PERIOD_S
            self.env.hurry()

    @external
    def drive(self, distance_m: Metres) -> ActionId:
        """Drive straight ahead, or back if negative, without turning; returns the action's id."""
        check_range("drive", distance_m)
        pose = self._moc.pose()
        goal = Point2D(pose.x_m + distance_m * math.cos(pose.yaw_rad), pose.y_m + distance_m * math.sin(pose.yaw_rad))
        steers = not self._steering.is_holonomic
        return self._start_path("drive", Path([goal], PLACED_M, pose.yaw_rad, is_straight=True, steers=steers))

    @external
    def go_to(self, x_m: Metres, y_m: Metres, yaw_rad: Radians) -> ActionId:
        """Drive straight to a pose, frame odom, turning meanwhile; returns the action's id."""
        check_range("go_to", x_m, y_m, yaw_rad)
        steers = not self._steering.is_holonomic
        placed_m = STEERED_M if steers else PLACED_M
        turned_rad = TURNED_RAD
        if self._arcs is not None:
            placed_m, turned_rad = PARKED_M, PARKED_RAD
        path = Path([Point2D(x_m, y_m)], placed_m, wrap_angle_rad(yaw_rad), turned_rad, steers=steers)
        return self._start_path("go_to", path)

    @external
    def turn(self, angle_rad: Radians) -> ActionId:
        """Turn on the spot, to the left if positive, also by more than a full turn; returns the action's id.

        A base that cannot turn on the spot drives to and fro.
        """
        check_range("turn", angle_rad)
        pose = self._moc.pose()
        action = self._actions.start("turn")
        self._stop_moving()
        self._action = action
        self._length = abs(angle_rad)
        self._to_turn_rad = angle_rad or TURNED_RAD / 2  # nothing to turn is done at the next step as well
        self._last_yaw_rad = pose.yaw_rad
        self._motion = Motion.DRIVING
        self.env.hurry()
        return action.id

    @external
    def motion(self) -> Motion:
        """Present motion of the driver."""
        return self._motion

    @external
    def blocked_reason(self) -> str:
        """Reason why the robot cannot continue; empty if it is not blocked."""
        return self._reason if self._motion is Motion.BLOCKED else ""

    def squeezes(self) -> bool:
        """Whether the robot is in a narrow place or in front of one, as seen when it last drove."""
        return self._squeezes

    def gap_m(self) -> float | None:
        """Width of the gap that is too narrow for the robot and blocks it; None if it is not blocked by a gap."""
        return self._gap_m if self._motion is Motion.BLOCKED else None

    @external
    def controller_status(self) -> ControllerStatus | None:
        """Last status of the motor controller; null before the first."""
        return self._moc.status()

    def _start_path(self, name: str, path: Path) -> ActionId:
        pose = self._moc.pose()
        action = self._actions.start(name)
        self._set_out(path)
        self._action = action
        self._length = path.remaining_m(pose)
        return action.id

    def _set_out(self, path: Path) -> None:
        self._action = None
        self._to_turn_rad = 0.0
        before, self._path = self._path, path
        path.forget_progress()
        if before is not None and path.is_narrow and before.is_narrow:
            path.copy_progress(before, self._moc.pose())
        if self._motion is Motion.STOPPED:
            self._motion = Motion.DRIVING
            self.env.hurry()

    def _release_hand(self) -> None:
        path, action = self._path, self._action
        self._stop_moving()
        if path is not None:
            self._set_out(path)
            self._action = action

    def _forget(self) -> None:
        self._hand.stop()
        self.period_s = PERIOD_S
        self._action = None
        self._path = None
        self._to_turn_rad = 0.0
        self._motion = Motion.STOPPED
        self._blocked_since_ns = None
        self._ramp.stop()
        self._turn.stop()
        if self._arcs is not None:
            self._arcs.stop()

    def _stop_moving(self) -> None:
        if self._path is not None or self._motion is not Motion.STOPPED:
            self._moc.stop()
        self._forget()

    def _end(self, pose: Pose2D) -> None:
        action = self._action
        self._stop_moving()
        if action is not None:
            action.done(pose)

    def _report_progress(self, left: float) -> None:
        if self._action is not None and self._length > 0.0:
            self._action.progress(1.0 - left / self._length)

    def _bump(self, bump: Bump) -> None:
        self._lookout.feel(bump)
        # Regardless of the goal, it stops first, and continues only away from the touched obstacle.
        turns_by_arcs = self._to_turn_rad and self._arcs is not None
        is_driven = self._path is not None or turns_by_arcs or self._hand.holds(self.env.clock.now_ns())
        if bump.directions_rad and is_driven:
            self._moc.stop()
            self._steering.stop()

    def _step_by_hand(self, now_ns: int, pose: Pose2D, is_fresh: bool) -> None:
        if not self._hand.is_command_due(now_ns, to_ns(PERIOD_S)) or not self._sees(is_fresh=is_fresh):
            return
        wanted, limits = self._hand.wanted, self.parameters
        left_m_s = wanted.left_m_s if self._steering.is_holonomic else 0.0
        speed_m_s = math.hypot(wanted.forward_m_s, left_m_s)
        heading_rad = wrap_angle_rad(pose.yaw_rad + math.atan2(left_m_s, wanted.forward_m_s))
        free_m = self._lookout.free_m(pose, heading_rad)
        reason = NEEDS_SPEED if self._arcs is not None and speed_m_s == 0 and wanted.yaw_rad_s else ""
        self._record(PATH_BLOCKED if speed_m_s > 0 and free_m < BLOCKED_M else reason)
        ahead_m = self._ramp.ahead(math.cos(heading_rad), math.sin(heading_rad))
        slow_m_s = min(speed_m_s, limits.speed_m_s, limits.hand_speed_m_s)
        self._steering.go_towards(pose, heading_rad, slow_m_s, free_m, ahead_m, may_reverse=True)
        rate_rad_s = min(limits.turn_rate_rad_s, limits.hand_turn_rate_rad_s)
        self._turn.follow(max(-rate_rad_s, min(rate_rad_s, wanted.yaw_rad_s)), 0.0)
        self._moc.drive(self._steering.twist(pose, may_reverse=True))

    def _step_turn(self, pose: Pose2D, is_fresh: bool) -> None:
        before_rad, self._last_yaw_rad = self._last_yaw_rad, pose.yaw_rad
        left_rad = self._to_turn_rad - wrap_angle_rad(pose.yaw_rad - before_rad)
        if abs(left_rad) < TURNED_RAD:
            self._end(pose)
            return
        self._to_turn_rad = left_rad
        if self._arcs is not None:
            self._turn_by_arcs(left_rad, pose, is_fresh=is_fresh)
            return
        if is_fresh:
            self._record("")
            self._steering.turn_by(left_rad)
            self._report_progress(abs(left_rad))
        else:
            self._record(NO_ODOMETRY)
            self._turn.stop()
        self._moc.drive(Twist2D(0.0, 0.0, self._turn.x))
        self._give_up_if_blocked()

    def _turn_by_arcs(self, left_rad: float, pose: Pose2D, *, is_fresh: bool) -> None:
        if self._sees(is_fresh=is_fresh):
            self._steering.slow_down(pose)
            self._steering.turn_by(left_rad)
            self._moc.drive(self._by_arcs(pose, "", math.inf))
            self._report_progress(abs(left_rad))
        self._give_up_if_blocked()

    def _by_arcs(self, pose: Pose2D, block_reason: str, fastest_m_s: float) -> Twist2D:
        """Velocity of a base that may have no room to turn."""
        twist = self._steering.twist(pose, fastest_m_s=min(fastest_m_s, self.parameters.speed_m_s))
        has_room = self._arcs is None or self._arcs.has_room
        self._record(block_reason if block_reason or has_room else NO_ROOM)
        return twist

    def _step_path(self, path: Path, pose: Pose2D, is_fresh: bool) -> None:
        path.pass_points(pose)
        if path.is_done(pose):
            self._end(pose)
            self.arrived.notify(path.goal)
            return
        if self._sees(is_fresh=is_fresh):
            self._moc.drive(self._command(path, pose))
            self._report_progress(path.remaining_m(pose))
        self._give_up_if_blocked()

    def _command(self, path: Path, pose: Pose2D) -> Twist2D:
        target, ramp, limits = path.target, self._ramp, self.parameters
        heading_rad = math.atan2(target.y_m - pose.y_m, target.x_m - pose.x_m)
        free_m = self._lookout.free_m(pose, heading_rad)
        self._squeezes = path.is_narrow and (
            free_m < BEGIN_M or is_between(self._lookout, pose, path.along_rad(pose), self._moc.radius_m())
        )
        if self._squeezes:
            return self._squeeze(path, pose, heading_rad, free_m)
        path.forget_progress()
        self._gap_m = None
        block_reason = PATH_BLOCKED if free_m < BLOCKED_M and not path.is_at_goal(pose) else ""
        turns_by_arcs = self._arcs is not None and not path.is_straight
        if not turns_by_arcs:
            self._record(block_reason)
        ahead_m = ramp.ahead(math.cos(heading_rad), math.sin(heading_rad))
        path_m_s = path.speed_m_s(pose, limits.acceleration_m_s2, ahead_m)
        fastest_m_s = min(limits.speed_m_s, path.fastest_m_s, path_m_s)
        reverses = path.is_straight
        self._steering.go_towards(pose, heading_rad, fastest_m_s, free_m, ahead_m, may_reverse=reverses)
        self._steering.turn_by(path.to_turn_rad(pose, wrap_angle_rad(heading_rad - pose.yaw_rad)))
        if turns_by_arcs:
            return self._by_arcs(pose, block_reason, path.fastest_m_s)
        return self._steering.twist(pose, may_reverse=reverses)

    def _squeeze(self, path: Path, pose: Pose2D, heading_rad: float, free_m: float) -> Twist2D:
        """Drive one period through a narrow place or up to one; `free_m` is the room ahead for normal driving."""
        ramp, limits = self._ramp, self.parameters
        found = squeeze(self._lookout, pose, heading_rad, path.along_rad(pose), self._moc.radius_m())
        if is_there := path.is_at_goal(pose):
            path.forget_progress()
        is_stuck = not is_there and path.is_stuck(pose, self.env.clock.now_ns())
        self._gap_m = found.gap_m if is_stuck else None
        self._record("" if not is_stuck else PATH_BLOCKED if found.gap_m is None else TOO_NARROW)
        if ramp.speed > SLOW_M_S:
            room_m = self._lookout.passage(pose, math.atan2(ramp.y, ramp.x)).free_m
            if ramp.stopping() > room_m + SPARE_M:
                self._steering.brake()
                return self._steering.twist(pose)
        ahead_m = ramp.ahead(math.cos(found.heading_rad), math.sin(found.heading_rad))
        slow_m_s = found.speed_m_s
        if not found.is_between:
            slow_m_s = max(slow_m_s, speed_to_stop(free_m - ahead_m, limits.acceleration_m_s2))
        to_stop_m_s = speed_to_stop(found.free_m - ahead_m, limits.acceleration_m_s2)
        speed_m_s = min(
            slow_m_s,
            max(CREEP_M_S, to_stop_m_s) if found.is_between else to_stop_m_s,
            path.speed_m_s(pose, limits.acceleration_m_s2, ahead_m),
            path.fastest_m_s,
            limits.speed_m_s,
        )
        velocity_m_s = self._lookout.hold_off(pose, found.velocity_m_s(speed_m_s), KEEP_M, KEEP_PER_S)
        towards_rad = self._steering.go(pose, velocity_m_s)
        if not self._steering.is_holonomic and velocity_m_s != (0.0, 0.0):
            heading_rad = towards_rad
        self._steering.turn_by(path.to_turn_rad(pose, wrap_angle_rad(heading_rad - pose.yaw_rad)))
        return self._steering.twist(pose, fastest_m_s=min(path.fastest_m_s, limits.speed_m_s))

    def _sees(self, *, is_fresh: bool) -> bool:
        """Check the surroundings; a blind robot stops, and reports the reason."""
        blind_reason = self._lookout.check(self.env.clock.now_ns()) if is_fresh else NO_ODOMETRY
        if blind_reason:
            self._record(blind_reason)
            self._steering.stop()
            self._moc.drive(Twist2D())
        return not blind_reason

    def _record(self, block_reason: str) -> None:
        self._reason = block_reason
        if not block_reason:
            self._motion = Motion.DRIVING
            self._blocked_since_ns = None
        elif self._motion is not Motion.BLOCKED:
            self._motion = Motion.BLOCKED
            self._blocked_since_ns = self.env.clock.now_ns()

    def _give_up_if_blocked(self) -> None:
        action = self._action
        if action is not None and self.blocked_s() > self.parameters.patience_s:
            reason = self._reason
            self._stop_moving()
            action.fail(f"{reason} for {self.parameters.patience_s:g} s")
