"""Interface of the driver."""

import math
from enum import StrEnum
from typing import Protocol

import msgspec

from robrain.agent.action import Actions
from robrain.agent.event import Event
from robrain.agent.plugin import Unit, external
from robrain.plugins.device.mocdevice.interface import Counters, MocDeviceInterface
from robrain.protocol.clock import to_seconds
from robrain.protocol.messages.robots.action_messages import ActionEnd, ActionId, ActionProgress
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D


class Motion(StrEnum):
    """Present motion of the driver."""

    STOPPED = "stopped"
    DRIVING = "driving"
    BLOCKED = "blocked"
    """Something blocks the path, or the robot cannot see whether it does; the driver waits."""


class OdometryNoise(msgspec.Struct, frozen=True, kw_only=True):
    """Growth of the odometry's uncertainty with the path, as standard deviations of independent white noise.

    The standard deviations follow after `s` metres of path and `t` radians of turning, both summed without sign. The
    distance is known to `sigma_m_per_sqrt_m`·√s, and the yaw to √(`sigma_rad_per_sqrt_m`²·s +
    `sigma_rad_per_sqrt_rad`²·t). The covariance grows linearly with the path, as in Thrun, Burgard, Fox: Probabilistic
    Robotics, section 5.4. Systematic errors, such as wrong wheel radii, are not in it.
    """

    sigma_m_per_sqrt_m: float
    sigma_rad_per_sqrt_m: float
    sigma_rad_per_sqrt_rad: float


class DriverInterface(Protocol):
    """Motion and odometry. Everything is in the frame odom, which starts where the robot started."""

    arrived: Event[Point2D]
    """The end of the path, when it has been reached."""
    progress: Event[ActionProgress]
    finished: Event[ActionEnd]
    """An action has ended; its result, if it is done, is T_odom_robot."""

    def follow(self, path: list[Point2D], fastest_m_s: float = math.inf, *, is_narrow: bool = False) -> None:
        """Drive along these points to the last one, at most this fast, in place of an earlier path.

        With `is_narrow` the robot squeezes, slowly, through places hardly wider than itself.
        """

    def drive_path(self, points: list[Point2D]) -> ActionId:
        """As `follow`, as an action; its id. The next call that moves the robot supersedes it."""

    def drive(self, distance_m: float) -> ActionId:
        """Drive straight ahead, or back if negative, without turning; returns the action's id."""

    def go_to(self, x_m: float, y_m: float, yaw_rad: float) -> ActionId:
        """Drive straight to a pose, turning meanwhile; returns the action's id."""

    def turn(self, angle_rad: float) -> ActionId:
        """Turn on the spot, to the left if positive; the action's id."""

    def cancel(self, action: str) -> bool:
        """Cancel this action and stop; False if it is not running."""

    def stop(self) -> None:
        """Stop the robot."""

    def motion(self) -> Motion:
        """Present motion of the driver."""

    def blocked_s(self) -> float:
        """Time for which something has blocked the path; 0 if nothing does."""

    def blocked_reason(self) -> str:
        """Reason why the robot cannot continue; empty if it is not blocked."""

    def squeezes(self) -> bool:
        """Whether the robot is in a narrow place or in front of one, as seen when it last drove."""

    def gap_m(self) -> float | None:
        """Width of the gap that is too narrow for the robot and blocks it; None if it is not blocked by a gap."""

    def pose(self) -> Pose2D:
        """T_odom_robot now."""

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """T_odom_robot at a time within the last five seconds; after `odometry_until_ns` it is the newest pose."""

    def odometry_until_ns(self) -> int:
        """Time of measurement of the newest wheel counts, robot's clock; 0 before the first.

        For a later time `pose_at` returns the pose at this one.
        """

    def velocity(self) -> Twist2D:
        """Velocity in the body frame."""

    def odometry_noise(self) -> OdometryNoise:
        """Growth of the uncertainty of `pose` with distance, from the manifest."""

    def radius_m(self) -> float:
        """Radius of the round footprint."""


class MotionUnit(Unit):
    """A unit that moves the robot by actions; subclasses set `_actions` when they are set up."""

    arrived = Event[Point2D](outside=True)
    progress = Event[ActionProgress](outside=True)
    finished = Event[ActionEnd](outside=True)
    _actions: Actions

    def _stop_moving(self) -> None:
        raise NotImplementedError

    @external
    def cancel(self, action: str) -> bool:
        """Cancel this action and stop; False if it is not running."""
        if not self._actions.cancel(action):
            return False
        self._stop_moving()
        return True

    @external
    def stop(self) -> None:
        """Stop the robot."""
        caller = self.env.caller
        self._actions.cancel_all(f"{caller} stopped the driver" if caller else "the driver was told to stop")
        self._stop_moving()

    def squeezes(self) -> bool:
        """Whether the robot is in a narrow place; False where that is not known."""
        return False

    def gap_m(self) -> float | None:
        """Width of the gap that is too narrow for the robot; None where that is not known."""
        return None


class OnBase(MotionUnit):
    """A unit on `mocdevice`; subclasses set `_moc` when they are activated."""

    _moc: MocDeviceInterface
    _blocked_since_ns: int | None

    def blocked_s(self) -> float:
        """For how long the robot has not been able to continue."""
        if self._blocked_since_ns is None:
            return 0.0
        return to_seconds(self.env.clock.now_ns() - self._blocked_since_ns)

    @external
    def pose(self) -> Pose2D:
        """T_odom_robot now."""
        return self._moc.pose()

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """T_odom_robot at a time within the last five seconds."""
        return self._moc.pose_at(stamp_ns)

    def odometry_until_ns(self) -> int:
        """Time of measurement of the newest odometry; 0 before the first."""
        return self._moc.odometry_until_ns()

    @external
    def velocity(self) -> Twist2D:
        """Velocity in the body frame."""
        return self._moc.velocity()

    @external
    def odometry_noise(self) -> OdometryNoise:
        """Growth of the uncertainty of `pose` with distance, from the manifest."""
        noise: OdometryNoise = self.parameters.odometry
        return noise

    @external
    def bus_counters(self) -> Counters:
        """Counters of the base's device, which the driver holds exclusively."""
        return self._moc.counters()

    def radius_m(self) -> float:
        """Radius of the round footprint."""
        return self._moc.radius_m()
