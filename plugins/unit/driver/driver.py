"""Driver: follows paths with an omnidirectional base and stops in front of what the lidar sees.

`follow` is for plugins that plan anew all the time. `drive_path`, `drive` and `turn` are long actions: they return an
id, and end as done, as cancelled by whatever moves the robot next, or as failed when the way stays blocked.
"""

import itertools
import math

import msgspec
import numpy as np

from robrain.agent.action import Action, ActionDesk, ActionEnd, ActionProgress
from robrain.agent.event import Event
from robrain.agent.plugin import Unit, external
from robrain.plugins.device.mocdevice.interface import MocDeviceInterface
from robrain.plugins.device.scan.interface import ScanInterface
from robrain.plugins.unit.driver.interface import DriverInterface, Motion
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D, wrap_angle_rad
from robrain.protocol.wire.clock import to_ns, to_seconds
from robrain.protocol.wire.errors import CallError, ErrorCode

ARRIVED_M = 0.08
TURNED_RAD = 0.02
SLOWEST_TURN_RAD_S = 0.1
"""What the wheels still do evenly; the last bit of a turn is done with it."""
CORNER_M = 0.25
"""A waypoint that is not the last counts as passed within this."""
SCAN_FRESH_NS = to_ns(1.0)


class Driver(Unit):
    """Follows paths; slows down before the end and before obstacles."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """Limits of the motion. Values are chosen for a robot in the style of the Robertino."""

        speed_m_s: float = 0.6
        turn_rate_rad_s: float = 1.5
        acceleration_m_s2: float = 0.8
        stop_distance_m: float = 0.12
        """The robot's edge stays this far from what it sees ahead."""
        patience_s: float = 10.0
        """An action fails when something has stood in its way for so long."""

        def __post_init__(self) -> None:
            for name in self.__struct_fields__:
                if getattr(self, name) <= 0:
                    raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")

    interface = DriverInterface
    period_s = 0.06
    parameters: Parameters
    arrived = Event[Point2D](outside=True)
    progress = Event[ActionProgress](outside=True)
    finished = Event[ActionEnd](outside=True)

    def init(self) -> None:
        self._actions = ActionDesk(self.env, self.progress, self.finished)
        self._action: Action | None = None
        self._path: list[Point2D] = []
        self._yaw_rad: float | None = None
        """Kept while the robot drives straight ahead or back; None if it looks where it goes."""
        self._to_turn_rad = 0.0
        self._length = 0.0
        """Of the whole action, in metres or radians."""
        self._last_yaw_rad = 0.0
        self._motion = Motion.STANDING
        self._blocked_since_ns: int | None = None
        self._points_m = np.empty((2, 0))
        self._scan_stamp_ns = -1

    def activate(self) -> None:
        self._moc = self.env.use("mocdevice", MocDeviceInterface)
        self._scan = self.env.use("scan", ScanInterface)

    def step(self) -> None:
        pose = self._moc.pose()
        if self._action is not None and not self._action.is_running:  # ended from elsewhere, as by a halt
            self._stand()
        if self._to_turn_rad:
            self._step_turn(pose)
            return
        while len(self._path) > 1 and pose.distance_m(self._path[0]) < CORNER_M:
            self._path.pop(0)
        if not self._path:
            return
        if len(self._path) == 1 and pose.distance_m(self._path[0]) < ARRIVED_M:
            goal, action = self._path[0], self._action
            self._stand()
            self.arrived.notify(goal)
            if action is not None:
                action.done(pose)
            return
        self._moc.drive(self._command(pose))
        self._tell(self._way_left_m(pose))
        if self._action is not None and self.blocked_s() > self.parameters.patience_s:
            action = self._action
            self._stand()
            action.fail(f"something has stood in the way for {self.parameters.patience_s:g} s")

    def deactivate(self) -> None:
        self._forget()
        self._moc.stop()

    def emergency_halt(self) -> None:
        self._forget()

    def follow(self, path: list[Point2D]) -> None:
        """Drive along these points to the last one."""
        self._actions.cancel_all("another path was given")
        self._set_out(path)

    @external
    def drive_path(self, points: list[Point2D]) -> str:
        """Drive along these points, frame odom, to the last one; the action's id."""
        if not points:
            raise CallError(ErrorCode.BAD_ARGUMENTS, "drive_path: expected at least one point, got none")
        _check_finite("drive_path", *(number for point in points for number in (point.x_m, point.y_m)))
        return self._start_path("drive_path", points)

    @external
    def drive(self, distance_m: float) -> str:
        """Drive straight ahead, or back if negative, without turning; the action's id."""
        _check_finite("drive", distance_m)
        pose = self._moc.pose()
        goal = Point2D(pose.x_m + distance_m * math.cos(pose.yaw_rad), pose.y_m + distance_m * math.sin(pose.yaw_rad))
        return self._start_path("drive", [goal], pose.yaw_rad)

    @external
    def turn(self, angle_rad: float) -> str:
        """Turn on the spot, to the left if positive, also by more than a full turn; the action's id."""
        _check_finite("turn", angle_rad)
        pose = self._moc.pose()
        action = self._actions.start("turn")
        self._stand()
        self._action = action
        self._length = abs(angle_rad)
        self._to_turn_rad = angle_rad or TURNED_RAD / 2  # nothing to turn is done at the next step as well
        self._last_yaw_rad = pose.yaw_rad
        self._motion = Motion.DRIVING
        return action.id

    @external
    def cancel(self, action: str) -> bool:
        """Stand still if this action is running; False if it is not."""
        if not self._actions.cancel(action):
            return False
        self._stand()
        return True

    @external
    def stop(self) -> None:
        """Stand still."""
        self._actions.cancel_all("the driver was told to stop")
        self._stand()

    @external
    def motion(self) -> Motion:
        """What the driver is at."""
        return self._motion

    def blocked_s(self) -> float:
        """For how long something has stood in the way."""
        if self._blocked_since_ns is None:
            return 0.0
        return to_seconds(self.env.clock.now_ns() - self._blocked_since_ns)

    @external
    def pose(self) -> Pose2D:
        """T_odom_robot now."""
        return self._moc.pose()

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """T_odom_robot at a time within the last second."""
        return self._moc.pose_at(stamp_ns)

    def velocity(self) -> Twist2D:
        """Velocity in the body frame."""
        return self._moc.velocity()

    def radius_m(self) -> float:
        """Radius of the round footprint."""
        return self._moc.radius_m()

    def _start_path(self, name: str, points: list[Point2D], yaw_rad: float | None = None) -> str:
        pose = self._moc.pose()
        action = self._actions.start(name)
        self._set_out(points)
        self._yaw_rad = yaw_rad
        self._action = action
        self._length = self._way_left_m(pose)
        return action.id

    def _set_out(self, path: list[Point2D]) -> None:
        self._action = None
        self._to_turn_rad = 0.0
        self._yaw_rad = None
        self._path = list(path)
        if self._motion is Motion.STANDING:
            self._motion = Motion.DRIVING

    def _forget(self) -> None:
        self._action = None
        self._path = []
        self._to_turn_rad = 0.0
        self._motion = Motion.STANDING
        self._blocked_since_ns = None

    def _stand(self) -> None:
        if self._path or self._motion is not Motion.STANDING:
            self._moc.stop()
        self._forget()

    def _tell(self, left: float) -> None:
        if self._action is not None and self._length > 0.0:
            self._action.progress(1.0 - left / self._length)

    def _step_turn(self, pose: Pose2D) -> None:
        before_rad, self._last_yaw_rad = self._last_yaw_rad, pose.yaw_rad
        left_rad = self._to_turn_rad - wrap_angle_rad(pose.yaw_rad - before_rad)
        if abs(left_rad) < TURNED_RAD:
            action = self._action
            self._stand()
            if action is not None:
                action.done(pose)
            return
        self._to_turn_rad = left_rad
        rate_rad_s = max(SLOWEST_TURN_RAD_S, min(self.parameters.turn_rate_rad_s, 2.0 * abs(left_rad)))
        self._moc.drive(Twist2D(0.0, 0.0, math.copysign(rate_rad_s, left_rad)))
        self._tell(abs(left_rad))

    def _way_left_m(self, pose: Pose2D) -> float:
        return pose.distance_m(self._path[0]) + sum(
            math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in itertools.pairwise(self._path)
        )

    def _command(self, pose: Pose2D) -> Twist2D:
        target = self._path[0]
        bearing_rad = wrap_angle_rad(math.atan2(target.y_m - pose.y_m, target.x_m - pose.x_m) - pose.yaw_rad)
        free_m = self._free_ahead_m(pose, bearing_rad)
        limits = self.parameters
        to_end_m = self._way_left_m(pose)
        # v² = 2·a·s: as fast as still allows to stop in the free distance.
        speed_m_s = min(limits.speed_m_s, math.sqrt(2 * limits.acceleration_m_s2 * min(max(free_m, 0.0), to_end_m)))
        self._note(free_m)
        aside_rad = bearing_rad if self._yaw_rad is None else wrap_angle_rad(self._yaw_rad - pose.yaw_rad)
        turn_rad_s = max(-limits.turn_rate_rad_s, min(limits.turn_rate_rad_s, 2.0 * aside_rad))
        return Twist2D(speed_m_s * math.cos(bearing_rad), speed_m_s * math.sin(bearing_rad), turn_rad_s)

    def _note(self, free_m: float) -> None:
        if free_m > 0.02:
            self._motion = Motion.DRIVING
            self._blocked_since_ns = None
        elif self._motion is not Motion.BLOCKED:
            self._motion = Motion.BLOCKED
            self._blocked_since_ns = self.env.clock.now_ns()

    def _free_ahead_m(self, pose: Pose2D, bearing_rad: float) -> float:
        """How far the round robot can go straight in a direction of its own frame before it touches something."""
        scan = self._scan.latest()
        if scan is None or self.env.clock.now_ns() - scan.stamp_ns > SCAN_FRESH_NS:
            return 0.0  # blind robots stand
        if scan.stamp_ns != self._scan_stamp_ns:
            self._scan_stamp_ns = scan.stamp_ns
            hit = scan.ranges_m < scan.range_max_m
            angles_rad, ranges_m = scan.angles_rad[hit], scan.ranges_m[hit]
            seen_from = self._moc.pose_at(scan.stamp_ns)
            angles_rad = angles_rad + seen_from.yaw_rad
            self._points_m = np.stack(
                (seen_from.x_m + ranges_m * np.cos(angles_rad), seen_from.y_m + ranges_m * np.sin(angles_rad))
            )
        if not self._points_m.size:
            return math.inf
        heading_rad = pose.yaw_rad + bearing_rad
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        dx, dy = self._points_m[0] - pose.x_m, self._points_m[1] - pose.y_m
        ahead_m, aside_m = cos * dx + sin * dy, np.abs(cos * dy - sin * dx)
        # What the swept disc, a little wider than the robot, would touch; what lies beside or behind is passed.
        reach_m = self._moc.radius_m() + 0.25 * self.parameters.stop_distance_m
        in_way = (aside_m < reach_m) & (ahead_m > 0)
        if not in_way.any():
            return math.inf
        contact_m = ahead_m[in_way] - np.sqrt(reach_m**2 - aside_m[in_way] ** 2)
        return float(contact_m.min()) - 0.75 * self.parameters.stop_distance_m


def _check_finite(function: str, *numbers: float) -> None:
    if not all(map(math.isfinite, numbers)):
        raise CallError(ErrorCode.BAD_ARGUMENTS, f"{function}: expected finite numbers, got {numbers}")
