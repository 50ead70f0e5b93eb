"""Sends velocities to the robot, and zero once nothing else is commanded.

A velocity holds for `HOLD_S`; then zero is published, `ZEROS` times, in case one is lost. While the robot is halted,
zero is published all the time, so that no other node drives it. This is done on the thread of the ROS node: it also
stops a robot whose plugin hangs. A robot whose agent has died stops by its own watchdog.
"""

import math
import time
from collections.abc import Callable
from threading import Lock
from typing import Annotated, Any, NamedTuple

from geometry_msgs.msg import Twist, TwistStamped
from msgspec import Meta
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile

from robrain.agent.plugin import external
from robrain.plugins.device.mocdevice.interface import (
    BusFault,
    ControllerStatus,
    Counters,
    DriveCondition,
    MocDeviceInterface,
)
from robrain.plugins.device.mocdevice.wheel_device import JUMP_SLACK, STILL, BaseDevice, BaseOdometry
from robrain.plugins.device.ros2.link import Ros2Parameters, Ros2Publisher
from robrain.plugins.device.ros2.topic_device import BadMessage, TopicDevice, stamp_ns_of
from robrain.protocol.clock import NS_PER_S, to_ns, to_seconds
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.model.ranges import Positive

HOLD_NS = to_ns(0.2)
ZEROS = 10
TICK_S = 0.05
"""Period of `tick`."""


class CommandGate:
    """Publishes velocities, and zero when they lapse; it may be used from any thread.

    Args:
        publish: publishes a velocity, body frame; it must not wait.
        now_ns: a clock that is never set.

    """

    def __init__(self, publish: Callable[[Twist2D], None], now_ns: Callable[[], int]) -> None:
        self._publish, self._now_ns = publish, now_ns
        self._lock = Lock()
        self._lapses_ns: int | None = None
        """Time when the last command lapses; None while the robot must stand."""
        self._zeros = 0
        self._held_ns: int | None = None
        self._is_closed = False

    def drive(self, twist: Twist2D) -> None:
        """Command a velocity for `HOLD_S`; without effect while the gate is held, and after its end."""
        with self._lock:
            if self._held_ns is None and not self._is_closed:
                self._lapses_ns = self._now_ns() + HOLD_NS
                self._publish(twist)

    def stop(self) -> None:
        """Command zero, now and repeatedly."""
        with self._lock:
            self._publish_zero()

    def hold(self) -> None:
        """Command zero until `release`, regardless of other commands."""
        with self._lock:
            self._held_ns = self._now_ns()
            self._publish_zero()

    def release(self) -> None:
        """End `hold`, for a step of the plugin, which has none while it is halted.

        Without effect just after `hold`: that step may have begun before the halt.
        """
        with self._lock:
            if self._held_ns is not None and self._now_ns() - self._held_ns >= HOLD_NS:
                self._held_ns = None

    def tick(self) -> None:
        """Send zero if it is due; called every `TICK_S`."""
        with self._lock:
            if self._is_closed:
                return
            if self._lapses_ns is not None and self._now_ns() >= self._lapses_ns:
                self._publish_zero()
            elif self._held_ns is not None or self._zeros:
                self._zeros = max(self._zeros - 1, 0)
                self._publish(STILL)

    def close(self) -> None:
        """Command zero once more, and nothing afterwards."""
        with self._lock:
            if not self._is_closed:
                self._publish_zero()
                self._is_closed = True

    def _publish_zero(self) -> None:
        if self._is_closed:
            return
        self._lapses_ns, self._zeros = None, ZEROS
        self._publish(STILL)


HISTORY_NS = 5 * NS_PER_S
HISTORY_MESSAGES = 2048
JUMP_M, JUMP_RAD = 0.05, 0.1
"""A smaller change is no jump."""
BLIND_S = 1.0
"""Longest time that a base may have moved without a message from it: its watchdog then stops it."""


PLACE_MAX_M = 1e5
"""Largest distance of a robot from its start."""
SPEED_MAX = 100.0
"""Metres or radians per second that no base can make."""
NORM_SLACK = 0.05
"""How far the length of an orientation's quaternion may be from 1."""


class OdometryReading(NamedTuple):
    """Odometry as the robot reported it."""

    pose: Pose2D
    """Of the body in the robot's own odometry frame."""
    velocity: Twist2D


def read_odometry(message: Any) -> tuple[int, OdometryReading]:
    """Stamp and planar part of a nav_msgs/Odometry (BadMessage); its velocity is that in the body frame."""
    place, velocity = message.pose.pose.position, message.twist.twist
    if not (abs(place.x) <= PLACE_MAX_M and abs(place.y) <= PLACE_MAX_M):  # also False for NaN
        raise BadMessage(f"expected a place within {PLACE_MAX_M:g} m, got {place.x:g}, {place.y:g}")
    twist = Twist2D(velocity.linear.x, velocity.linear.y, velocity.angular.z)
    if not all(abs(each) <= SPEED_MAX for each in (twist.forward_m_s, twist.left_m_s, twist.yaw_rad_s)):
        raise BadMessage(f"expected speeds up to {SPEED_MAX:g}, got {twist}")
    pose = Pose2D(place.x, place.y, _yaw_rad(message.pose.pose.orientation))
    return stamp_ns_of(message), OdometryReading(pose, twist)


def _yaw_rad(orientation: Any) -> float:
    """Yaw of an orientation, by which the body's x axis points, seen from above (BadMessage)."""
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(norm - 1.0) <= NORM_SLACK:
        raise BadMessage(f"expected a quaternion of length 1, got {x:g}, {y:g}, {z:g}, {w:g}")
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


class ReportedPath(BaseOdometry):
    """Follows the odometry of a base; the frame odom begins at the robot's first message.

    Args:
        speed_m_s: greatest speed of the base.
        turn_rate_rad_s: its greatest turn rate.
        pose: T_odom_robot from which it continues.
        before: the base's report at that pose, and the number of that message; None if they are unknown.

    """

    def __init__(
        self, speed_m_s: float, turn_rate_rad_s: float, pose: Pose2D, before: tuple[Pose2D, int] | None
    ) -> None:
        super().__init__(pose, HISTORY_MESSAGES)
        self.before = before
        self._speed_m_s, self._turn_rate_rad_s = speed_m_s, turn_rate_rad_s

    def follow(self, reported: OdometryReading, measured_ns: int, number: int) -> bool:
        """Read a report of the base; returns False if its odometry has jumped, and the pose has stayed.

        Args:
            reported: the message.
            measured_ns: its time of measurement, robot's clock.
            number: its publisher's count of messages. A publisher that counts from the start again has been started
                again, and so may have been its odometry; 0 if there is no count.

        """
        before, self.before = self.before, (reported.pose, number)
        has_jumped = False
        if before is not None:
            displacement = before[0].inverse().compose(reported.pose)
            if 0 < number <= before[1] or self._is_jump(displacement, measured_ns):
                has_jumped = True
            else:
                self.pose = self.pose.compose(displacement)
        self.velocity = STILL if has_jumped else reported.velocity
        self._record(measured_ns)
        while self._history[0][0] < measured_ns - HISTORY_NS:
            self._history.popleft()
        return not has_jumped

    def _is_jump(self, displacement: Pose2D, measured_ns: int) -> bool:
        until_ns = self.until_ns
        passed_s = BLIND_S if until_ns is None else max(to_seconds(measured_ns - until_ns), 0.0)
        reach_m = JUMP_M + JUMP_SLACK * self._speed_m_s * passed_s
        reach_rad = JUMP_RAD + JUMP_SLACK * self._turn_rate_rad_s * passed_s
        return displacement.distance_m(Pose2D(0.0, 0.0, 0.0)) > reach_m or abs(displacement.yaw_rad) > reach_rad


COMMAND_QOS = QoSProfile(depth=1)
"""Reliable, the newest only: a subscription of any reliability receives it."""


class Ros2Base(TopicDevice, BaseDevice):
    """Drives a ROS 2 robot by `cmd_vel`, and follows its odometry."""

    class Parameters(Ros2Parameters, frozen=True, kw_only=True, forbid_unknown_fields=True):
        """Topics and limits; the limits are chosen, take those of your robot."""

        cmd_vel: str = "cmd_vel"
        """Topic of the velocities."""
        stamped: bool = False
        """Whether that takes geometry_msgs/TwistStamped instead of Twist."""
        command_frame: str = "base_link"
        """Frame of stamped velocities."""
        odom: str = "odom"
        """Topic of the odometry, nav_msgs/Odometry."""
        holonomic: bool = False
        """Whether the base can drive sideways."""
        turn_radius_min_m: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.0
        """Radius of the tightest turn, of a car; 0 for a base that turns on the spot."""
        radius_m: Positive = 0.20
        """Radius of the round footprint."""
        speed_m_s: Positive = 1.0
        """Greatest speed; faster commands are slowed down, faster odometry has jumped."""
        turn_rate_rad_s: Positive = 3.0
        """Greatest turn rate; likewise."""
        silent_s: Positive = 0.5
        """Time without odometry after which the robot counts as gone."""

        topics = ("cmd_vel", "odom")

        def __post_init__(self) -> None:
            super().__post_init__()
            if self.holonomic and self.turn_radius_min_m:
                raise ValueError("expected turn_radius_min_m = 0 for a holonomic base")

    interface = MocDeviceInterface
    reports = "odometry"
    parameters: Parameters
    _odometry: ReportedPath

    def init(self) -> None:
        self._publisher: Ros2Publisher | None = None
        self._gate: CommandGate | None = None
        self._believed = self._jumps = 0

    def activate(self) -> None:
        board, wanted = self.env.board, self.parameters
        self.begin(wanted.silent_s)
        start = board.T_odom_robot or Pose2D(0.0, 0.0, 0.0)
        self._odometry = ReportedPath(wanted.speed_m_s, wanted.turn_rate_rad_s, start, board.published_odometry)
        link = self.subscribe(Odometry, wanted.odom, read_odometry, _ignore)
        self._pending = self._inbox
        if self._is_again and link.is_gone(wanted.topic(wanted.odom)):
            raise BusFault(self.env.plugin, f"no odometry: {self.silence_reason()}")
        self._publisher = link.publisher(
            TwistStamped if wanted.stamped else Twist, wanted.topic(wanted.cmd_vel), COMMAND_QOS
        )
        self._gate = CommandGate(self._publish, time.monotonic_ns)
        self._end_ticks = link.every(TICK_S, self._gate.tick)

    def step(self) -> None:
        if self._gate is None:
            return
        self._gate.release()
        try:
            self._catch_up()
            if self._link is not None and self._link.failure:
                raise BusFault(self.env.plugin, self._link.failure)
            self._check_silence()
        except BusFault as fault:
            self.condition.notify(DriveCondition(False, str(fault)))
            raise

    def deactivate(self) -> None:
        if self._gate is not None:
            self._gate.close()
            self._end_ticks()
            self._gate = None
        if self._publisher is not None:
            self._publisher.close()
            self._publisher = None
        super().deactivate()

    def emergency_halt(self) -> None:
        if (gate := self._gate) is not None:
            gate.hold()

    def drive(self, twist: Twist2D) -> None:
        """Command a velocity, body frame. It holds for 200 ms; beyond the base's limits its curvature is kept."""
        if self._gate is None or (self._is_again and self._received_ns is None):
            return  # it may receive but not send: no motion before its first message
        wanted = self.parameters
        forward, left, yaw = twist.forward_m_s, twist.left_m_s * wanted.holonomic, twist.yaw_rad_s
        speed_m_s = math.hypot(forward, left)
        if not (math.isfinite(speed_m_s) and math.isfinite(yaw)):
            raise ValueError(f"expected a finite velocity, got {twist}")
        excess = max(1.0, speed_m_s / wanted.speed_m_s, abs(yaw) / wanted.turn_rate_rad_s)
        self._gate.drive(Twist2D(forward / excess, left / excess, yaw / excess))

    @external
    def stop(self) -> None:
        """Stop the wheels at once."""
        if self._gate is not None:
            self._gate.stop()

    @external
    def is_holonomic(self) -> bool:
        """Whether the base can drive sideways."""
        return self.parameters.holonomic

    @external
    def turn_radius_min_m(self) -> float:
        """Radius of the tightest turn; 0 for a base that turns on the spot."""
        return self.parameters.turn_radius_min_m

    @external
    def counters(self) -> Counters:
        """Messages believed, rejected and lost; `foreign` counts other publishers of the velocities."""
        self._catch_up()
        link, topic = self._link, self.parameters.topic(self.parameters.cmd_vel)
        foreign = max(link.publishers(topic) - 1, 0) if link is not None else 0
        dropped = self._inbox.dropped if self._inbox is not None else 0
        return Counters(self._believed, self.rejected(), foreign, dropped, self._jumps)

    def status(self) -> ControllerStatus | None:
        """None: a ROS 2 robot has no status of that kind."""
        return None

    @external
    def trouble(self) -> str:
        """Reason why the robot cannot drive, in words; empty if none is known."""
        publisher, wanted = self._publisher, self.parameters
        if publisher is None:
            return "the device is not active"
        found = []
        if not self.is_fresh():
            found.append(f"no odometry: {self.silence_reason()}")
        if not publisher.listeners():
            found.append(f"nothing listens to {wanted.topic(wanted.cmd_vel)}")
        if rejected := self.rejection():
            found.append(f"the last odometry that was rejected: {rejected}")
        return "; ".join(found)

    def _publish(self, twist: Twist2D) -> None:
        publisher = self._publisher
        if publisher is None:
            return
        message = TwistStamped() if self.parameters.stamped else Twist()
        velocity = message
        if self.parameters.stamped:
            sec, nanosec = divmod(self.env.clock.now_ns(), NS_PER_S)
            message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
            message.header.frame_id = self.parameters.command_frame
            velocity = message.twist
        velocity.linear.x, velocity.linear.y, velocity.angular.z = twist.forward_m_s, twist.left_m_s, twist.yaw_rad_s
        publisher.publish(message)

    def _catch_up(self) -> None:
        for reported, measured_ns, number in self.drain():
            if not self._odometry.follow(reported, measured_ns, number):
                self._jumps += 1
            self._believed += 1
            if self._received_ns is None and self._is_again:
                self.condition.notify(DriveCondition(True, "the robot reports its odometry again"))
            self._received_ns = self.env.clock.now_ns()
            board = self.env.board
            board.T_odom_robot, board.published_odometry = self._odometry.pose, self._odometry.before


def _ignore() -> None:
    """Odometry is read when it is asked for, and at each step."""
