"""A driver that does not drive: its odometry is that of a log."""

from bisect import bisect_left
from collections import deque

from robrain.agent.plugin import Unit
from robrain.plugins.unit.driver.driver import Driver
from robrain.plugins.unit.driver.interface import DriverInterface, OdometryNoise
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad

HISTORY_ENTRIES = 1024
RADIUS_M = 0.2


class LogDriver(Unit):
    """Stands in for the stock driver, as far as localisation and mapper use it."""

    Parameters = Driver.Parameters
    interface = DriverInterface
    parameters: Driver.Parameters

    def init(self) -> None:
        self._history: deque[tuple[int, Pose2D]] = deque(maxlen=HISTORY_ENTRIES)

    def feed(self, stamp_ns: int, T_odom_robot: Pose2D) -> None:
        """Where the odometry had the robot; stamps do not descend."""
        self._history.append((stamp_ns, T_odom_robot))

    def pose(self) -> Pose2D:
        return self._history[-1][1] if self._history else Pose2D(0.0, 0.0, 0.0)

    def pose_at(self, stamp_ns: int) -> Pose2D:
        history = self._history
        index = bisect_left(history, stamp_ns, key=lambda entry: entry[0])
        if index == len(history):
            return self.pose()
        after_ns, after = history[index]
        if index == 0 or after_ns == stamp_ns:
            return after
        before_ns, before = history[index - 1]
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        return Pose2D(
            before.x_m + share * (after.x_m - before.x_m),
            before.y_m + share * (after.y_m - before.y_m),
            wrap_angle_rad(before.yaw_rad + share * wrap_angle_rad(after.yaw_rad - before.yaw_rad)),
        )

    def odometry_until_ns(self) -> int:
        return self._history[-1][0] if self._history else 0

    def velocity(self) -> Twist2D:
        return Twist2D()

    def odometry_noise(self) -> OdometryNoise:
        return self.parameters.odometry

    def radius_m(self) -> float:
        return RADIUS_M
