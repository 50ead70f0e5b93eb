"""Driver of a point: it follows paths exactly, at constant speed, and stops before other robots."""

import math
from typing import Annotated

from msgspec import Meta

from robrain.agent.action import Action, Actions
from robrain.agent.plugin import external
from robrain.plugins.unit.driver.driver import PATH_BLOCKED, Driver
from robrain.plugins.unit.driver.interface import DriverInterface, Motion, MotionUnit, OdometryNoise
from robrain.protocol.messages.robots.action_messages import ActionId
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.ranges import Metres, Radians
from robrain.sim.points.point_team import POINT_TICK_S, robot_of

POINTS_MAX = 100_000


class PointDriver(MotionUnit):
    """Drives the point; the frame odom is the arena frame."""

    Parameters = Driver.Parameters
    interface = DriverInterface
    period_s = POINT_TICK_S
    parameters: Driver.Parameters

    def init(self) -> None:
        self._robot = robot_of(self.env)
        self._actions = Actions(self.env, self.progress, self.finished)
        self._action: Action | None = None
        self._goal: Point2D | None = None
        self._yaw_rad: float | None = None
        """Heading at the goal; None for any."""
        self._length_m = 0.0

    def step(self) -> None:
        if self._action is not None and not self._action.is_running:  # ended from elsewhere, as by a halt
            self._stop_moving()
        if self._goal is None:
            return
        self._robot.command()
        if not self._robot.is_driving:
            self._end(self._goal)
        elif self._action is not None and self.blocked_s() > self.parameters.patience_s:
            action = self._action
            self._stop_moving()
            action.fail(f"{PATH_BLOCKED} for {self.parameters.patience_s:g} s")
        elif self._action is not None and self._length_m > 0.0:
            self._action.progress(1.0 - self._robot.remaining_m() / self._length_m)

    def deactivate(self) -> None:
        self._stop_moving()

    def emergency_halt(self) -> None:
        self._stop_moving()

    def follow(self, path: list[Point2D], fastest_m_s: float = math.inf, *, is_narrow: bool = False) -> None:
        """See DriverInterface."""
        if self._action is not None:
            self._action.supersede()
            self._action = None
        if path:
            self._set_out(path, fastest_m_s)
        else:
            self._stop_moving()

    @external
    def drive_path(self, points: Annotated[list[Point2D], Meta(min_length=1, max_length=POINTS_MAX)]) -> ActionId:
        """Drive along these points, arena frame, to the last one; returns the action's id."""
        return self._start("drive_path", points)

    @external
    def drive(self, distance_m: Metres) -> ActionId:
        """Drive straight ahead, or back if negative; returns the action's id."""
        pose = self._robot.pose
        x_m = pose.x_m + distance_m * math.cos(pose.yaw_rad)
        y_m = pose.y_m + distance_m * math.sin(pose.yaw_rad)
        return self._start("drive", [Point2D(x_m, y_m)], pose.yaw_rad)

    @external
    def go_to(self, x_m: Metres, y_m: Metres, yaw_rad: Radians) -> ActionId:
        """Drive straight to a pose, arena frame; returns the action's id."""
        return self._start("go_to", [Point2D(x_m, y_m)], yaw_rad)

    @external
    def turn(self, angle_rad: Radians) -> ActionId:
        """Turn on the spot, to the left if positive; returns the action's id."""
        pose = self._robot.pose
        return self._start("turn", [Point2D(pose.x_m, pose.y_m)], pose.yaw_rad + angle_rad)

    @external
    def motion(self) -> Motion:
        """Present motion of the driver."""
        if self._goal is None:
            return Motion.STOPPED
        return Motion.BLOCKED if self.blocked_s() > 0.0 else Motion.DRIVING

    def blocked_s(self) -> float:
        """Time for which another robot has been in the way."""
        return self._robot.blocked_s

    @external
    def blocked_reason(self) -> str:
        """Reason why the robot cannot continue; empty if it is not blocked."""
        return PATH_BLOCKED if self.blocked_s() > 0.0 else ""

    @external
    def pose(self) -> Pose2D:
        """T_odom_robot now."""
        return self._robot.pose

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """The pose now: nothing measures a point at other times."""
        return self._robot.pose

    def odometry_until_ns(self) -> int:
        """Now."""
        return self.env.clock.now_ns()

    @external
    def velocity(self) -> Twist2D:
        """Velocity in the body frame."""
        return self._robot.velocity

    @external
    def odometry_noise(self) -> OdometryNoise:
        """Growth of the uncertainty of `pose` with distance: none."""
        return OdometryNoise(sigma_m_per_sqrt_m=0.0, sigma_rad_per_sqrt_m=0.0, sigma_rad_per_sqrt_rad=0.0)

    def radius_m(self) -> float:
        """Radius of the round footprint."""
        return self._robot.radius_m

    def _start(self, name: str, points: list[Point2D], yaw_rad: float | None = None) -> ActionId:
        action = self._actions.start(name)
        self._set_out(points, math.inf)
        self._action, self._yaw_rad = action, yaw_rad
        self._length_m = self._robot.remaining_m()
        return action.id

    def _set_out(self, path: list[Point2D], fastest_m_s: float) -> None:
        self._goal, self._yaw_rad = path[-1], None
        self._robot.follow(path, min(fastest_m_s, self.parameters.speed_m_s))

    def _stop_moving(self) -> None:
        self._action = self._goal = None
        self._robot.stop()

    def _end(self, goal: Point2D) -> None:
        action, yaw_rad = self._action, self._yaw_rad
        if yaw_rad is not None:
            self._robot.face(yaw_rad)
        self._stop_moving()
        self.arrived.notify(goal)
        if action is not None:
            action.done(self._robot.pose)
