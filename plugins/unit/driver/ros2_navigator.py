"""A driver with the stock driver's interface that lets Nav2 drive: it sends path ends as NavigateToPose goals.

Nav2 plans its own path to them, at its own speed, and stops before obstacles by itself. Where robots meet, the team's
rules still hold: behaviors only send the driver as far as the robot may go.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import msgspec
from rclpy.action import ActionClient

from robrain.agent.action import Action, Actions
from robrain.agent.errors import HardwareAbsent
from robrain.agent.plugin import external
from robrain.plugins.device.mocdevice.interface import MocDeviceInterface
from robrain.plugins.device.ros2.link import Ros2Link, Ros2Parameters, open_link
from robrain.plugins.unit.driver.interface import DriverInterface, Motion, OdometryNoise, OnBase
from robrain.plugins.unit.driver.path import check_range
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.action_messages import ActionId
from robrain.protocol.model.geometry import Point2D, Pose2D, wrap_angle_rad
from robrain.protocol.model.ranges import Metres, Positive, Radians

ENDS_MAX = 64
CANCEL_S = 0.5
"""How long the end of the client waits until Nav2 has taken the cancellation."""
SUCCEEDED, CANCELED = 4, 5
"""Of action_msgs/GoalStatus."""


class GoalEnd(NamedTuple):
    """The end of a goal."""

    number: int
    reason: str | None
    """Why the robot is not there; None if it has arrived."""


class GoalClient:
    """A client of the action NavigateToPose.

    Args:
        plugin: whose it is, for errors.
        link: the node.
        topic: name of the action.
        on_end: called on the thread of the node after a goal has ended.

    Raises:
        HardwareAbsent: Nav2's interfaces are not installed.

    """

    def __init__(self, plugin: str, link: Ros2Link, topic: str, on_end: Callable[[], None]) -> None:
        try:
            from nav2_msgs.action import NavigateToPose
        except ModuleNotFoundError as error:
            what = "nav2_msgs is not installed: it comes with Nav2, as in ros-jazzy-nav2-msgs"
            raise HardwareAbsent(plugin, what) from error
        self._kind: Any = NavigateToPose
        self._link, self._topic, self._on_end = link, topic, on_end
        self._client: Any = link.do(lambda: ActionClient(link.node, NavigateToPose, topic))
        self._ends: deque[GoalEnd] = deque(maxlen=ENDS_MAX)
        self._handles: dict[int, Any] = {}
        """Of the goals that Nav2 has accepted and not ended; on the thread of the node."""
        self._last = 0
        self._cancelled_to = 0
        """Goals up to this number must be cancelled."""
        self._is_idle = threading.Event()
        self._is_idle.set()

    def send(self, number: int, pose: Pose2D, frame: str, stamp: tuple[int, int]) -> None:
        """Send a goal in place of those before; its end comes in `drain`.

        Args:
            number: greater than those before.
            pose: in `frame`.
            frame: name of the ROS frame.
            stamp: seconds and nanoseconds.

        """
        goal = self._kind.Goal()
        goal.pose.header.frame_id = frame
        goal.pose.header.stamp.sec, goal.pose.header.stamp.nanosec = stamp
        goal.pose.pose.position.x, goal.pose.pose.position.y = pose.x_m, pose.y_m
        goal.pose.pose.orientation.z, goal.pose.pose.orientation.w = (
            math.sin(pose.yaw_rad / 2),
            math.cos(pose.yaw_rad / 2),
        )
        self._last = number
        self._is_idle.clear()
        self._link.later(lambda: self._send(number, goal))

    def cancel(self) -> None:
        """Cancel all goals that were sent; returns at once, on any thread."""
        self._cancelled_to = self._last
        self._link.later(self._cancel)

    def drain(self) -> list[GoalEnd]:
        """The ends of goals since the last call."""
        return [self._ends.popleft() for _ in range(len(self._ends))]

    def close(self) -> None:
        """Cancel all goals, and end; waits a moment until Nav2 has taken that."""
        self.cancel()
        self._is_idle.wait(CANCEL_S)
        self._link.end(self._client.destroy)

    def _send(self, number: int, goal: Any) -> None:
        if number <= self._cancelled_to:
            self._end(number, "")
        elif not self._client.server_is_ready():
            self._end(number, f"there is no action server {self._topic}")
        else:
            self._client.send_goal_async(goal).add_done_callback(partial(self._answered, number))

    def _answered(self, number: int, answer: Any) -> None:
        handle = answer.result()
        if handle is None or not handle.accepted:
            self._end(number, "Nav2 has rejected the goal")
            return
        self._handles[number] = handle
        handle.get_result_async().add_done_callback(partial(self._ended, number))
        if number <= self._cancelled_to:
            handle.cancel_goal_async()

    def _cancel(self) -> None:
        for number, handle in self._handles.items():
            if number <= self._cancelled_to:
                handle.cancel_goal_async()

    def _ended(self, number: int, answer: Any) -> None:
        self._handles.pop(number, None)
        found = answer.result()
        code, words = getattr(found.result, "error_code", 0), getattr(found.result, "error_msg", "")
        failed = f"Nav2 does not get there: {words or f'error {code}'}"
        self._end(number, {SUCCEEDED: None, CANCELED: "Nav2's goal was cancelled"}.get(found.status, failed))

    def _end(self, number: int, reason: str | None) -> None:
        self._ends.append(GoalEnd(number, reason))
        if number == self._last:
            self._is_idle.set()
        self._on_end()


POINTS_MAX = 100_000
MOVES_M_S, MOVES_RAD_S = 0.05, 0.1
"""A robot that moves faster than one of these is not blocked."""


class NavigationGoal(msgspec.Struct):
    """Goal of the robot."""

    pose: Pose2D
    """Frame odom."""
    action: Action | None
    length: float
    """At the start, metres and radians."""
    number: int = 0
    """Of the goal that was sent for it last."""
    again_ns: int | None = None
    """Time when a failed goal is sent again; None while Nav2 pursues it."""


class Ros2Navigator(OnBase):
    """Drives by Nav2."""

    class Parameters(Ros2Parameters, frozen=True, kw_only=True, forbid_unknown_fields=True):
        """Nav2's action, and when a goal is sent again."""

        action: str = "navigate_to_pose"
        """Name of the action nav2_msgs/NavigateToPose."""
        frame: str = "odom"
        """Frame of the odometry that `ros2_base` receives."""
        goal_step_m: Positive = 0.15
        """A goal is sent if it differs from the previous goal by at least this distance or `goal_step_rad`."""
        goal_step_rad: Positive = 0.5
        retry_s: Positive = 1.0
        """Time after which a goal that has failed is sent again."""
        patience_s: Positive = 10.0
        """Time of failed attempts after which an action fails."""
        odometry: OdometryNoise = OdometryNoise(
            sigma_m_per_sqrt_m=0.01, sigma_rad_per_sqrt_m=0.005, sigma_rad_per_sqrt_rad=0.01
        )

        topics = ("action",)

    interface = DriverInterface
    period_s = 0.1  # and when a goal has ended
    parameters: Parameters

    def init(self) -> None:
        self._actions = Actions(self.env, self.progress, self.finished)
        self._link: Ros2Link | None = None
        self._goals: GoalClient | None = None
        self._wanted: NavigationGoal | None = None
        self._number = 0
        self._blocked_since_ns: int | None = None
        self._reason = ""

    def activate(self) -> None:
        wanted = self.parameters
        self._moc = self.env.use("mocdevice", MocDeviceInterface)
        self._link = open_link(self.env, wanted)
        self._goals = GoalClient(self.env.plugin, self._link, wanted.topic(wanted.action), self.env.hurry)

    def step(self) -> None:
        wanted = self._wanted
        if wanted is not None and wanted.action is not None and not wanted.action.is_running:
            self._stop_moving()  # it ended from elsewhere, as by a halt
            return
        for end in self._goals.drain() if self._goals is not None else ():
            if wanted is None or end.number != wanted.number:
                continue  # another goal has taken its place
            if end.reason is None:
                self._arrive(wanted)
                return
            self._record(end.reason)
            wanted.again_ns = self.env.clock.now_ns() + to_ns(self.parameters.retry_s)
        if wanted is not None:
            self._go_on(wanted)

    def deactivate(self) -> None:
        self._wanted = None
        if self._goals is not None:
            self._goals.close()
            self._goals = None
        link, self._link = self._link, None
        if link is not None:
            link.release()

    def emergency_halt(self) -> None:
        self._wanted = None
        if (goals := self._goals) is not None:
            goals.cancel()

    def follow(self, path: list[Point2D], fastest_m_s: float = math.inf, *, is_narrow: bool = False) -> None:
        """Drive to the last of these points; speed and path are Nav2's."""
        if not path:
            self._stop_moving()
            return
        check_range("follow", *(number for point in path for number in (point.x_m, point.y_m)))
        before = self._wanted
        goal = self._end_of(path)
        if before is not None and before.action is None and self._is_near(goal, before.pose):
            return
        if before is not None and before.action is not None:
            before.action.supersede()
        self._send(goal)

    @external
    def drive_path(self, points: list[Point2D]) -> ActionId:
        """Drive to the last of these points, frame odom; returns the action's id."""
        if not 1 <= len(points) <= POINTS_MAX:
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"drive_path: expected 1 to {POINTS_MAX} points")
        check_range("drive_path", *(number for point in points for number in (point.x_m, point.y_m)))
        return self._start("drive_path", self._end_of(points))

    @external
    def drive(self, distance_m: Metres) -> ActionId:
        """Drive to a place straight ahead, or back if negative; returns the action's id."""
        check_range("drive", distance_m)
        return self._start("drive", self._moc.pose().compose(Pose2D(distance_m, 0.0, 0.0)))

    @external
    def go_to(self, x_m: Metres, y_m: Metres, yaw_rad: Radians) -> ActionId:
        """Drive to a pose, frame odom; returns the action's id."""
        check_range("go_to", x_m, y_m, yaw_rad)
        return self._start("go_to", Pose2D(x_m, y_m, wrap_angle_rad(yaw_rad)))

    @external
    def turn(self, angle_rad: Radians) -> ActionId:
        """Turn to a heading; returns the action's id.

        More than half a turn is done in the shorter direction.
        """
        check_range("turn", angle_rad)
        return self._start("turn", self._moc.pose().compose(Pose2D(0.0, 0.0, wrap_angle_rad(angle_rad))))

    @external
    def motion(self) -> Motion:
        """Present motion of the driver."""
        if self._wanted is None:
            return Motion.STOPPED
        return Motion.DRIVING if self._blocked_since_ns is None else Motion.BLOCKED

    @external
    def blocked_reason(self) -> str:
        """Reason why the robot cannot continue; empty if it is not blocked."""
        return self._reason if self._blocked_since_ns is not None else ""

    def _start(self, name: str, goal: Pose2D) -> ActionId:
        action = self._actions.start(name)
        self._send(goal, action)
        return action.id

    def _end_of(self, path: list[Point2D]) -> Pose2D:
        """The last point of a path, facing along its last stretch."""
        end = path[-1]
        before: Point2D | Pose2D = path[-2] if len(path) > 1 else self._moc.pose()
        return Pose2D(end.x_m, end.y_m, math.atan2(end.y_m - before.y_m, end.x_m - before.x_m))

    def _is_near(self, goal: Pose2D, other: Pose2D) -> bool:
        turn_rad = abs(wrap_angle_rad(goal.yaw_rad - other.yaw_rad))
        return goal.distance_m(other) < self.parameters.goal_step_m and turn_rad < self.parameters.goal_step_rad

    def _send(self, goal: Pose2D, action: Action | None = None) -> None:
        pose = self._moc.pose()
        length = pose.distance_m(goal) + abs(wrap_angle_rad(goal.yaw_rad - pose.yaw_rad))
        self._wanted = NavigationGoal(goal, action, length)
        self._put(self._wanted)

    def _put(self, wanted: NavigationGoal) -> None:
        """Send the goal in the frame of the robot's own odometry, which the team's frame odom differs from."""
        board, goal = self.env.board, wanted.pose
        self._number += 1
        wanted.number, wanted.again_ns = self._number, None
        if board.published_odometry is not None and board.T_odom_robot is not None:
            goal = board.published_odometry[0].compose(board.T_odom_robot.inverse()).compose(goal)
        if self._goals is not None:
            self._goals.send(wanted.number, goal, self.parameters.frame, divmod(self.env.clock.now_ns(), NS_PER_S))

    def _go_on(self, wanted: NavigationGoal) -> None:
        now_ns, action = self.env.clock.now_ns(), wanted.action
        if wanted.again_ns is None:
            velocity = self._moc.velocity()
            if math.hypot(velocity.forward_m_s, velocity.left_m_s) > MOVES_M_S or abs(velocity.yaw_rad_s) > MOVES_RAD_S:
                self._blocked_since_ns = None
            pose = self._moc.pose()
            left = pose.distance_m(wanted.pose) + abs(wrap_angle_rad(wanted.pose.yaw_rad - pose.yaw_rad))
            if action is not None and wanted.length > 0.0:
                action.progress(1.0 - left / wanted.length)
        elif action is not None and self.blocked_s() > self.parameters.patience_s:
            reason = self._reason
            self._stop_moving()
            action.fail(f"{reason}, for {self.parameters.patience_s:g} s")
        elif now_ns >= wanted.again_ns:
            self._put(wanted)

    def _arrive(self, wanted: NavigationGoal) -> None:
        self._forget()
        if wanted.action is not None:
            wanted.action.done(self._moc.pose())
        self.arrived.notify(Point2D(wanted.pose.x_m, wanted.pose.y_m))

    def _record(self, reason: str) -> None:
        self._reason = reason
        if self._blocked_since_ns is None:
            self._blocked_since_ns = self.env.clock.now_ns()

    def _stop_moving(self) -> None:
        if self._wanted is not None and self._goals is not None:
            self._goals.cancel()
        self._forget()

    def _forget(self) -> None:
        self._wanted = None
        self._blocked_since_ns = None
