"""A driver that does not drive: its odometry is that of a log."""

from robrain.agent.plugin import Unit
from robrain.plugins.unit.driver.driver import Driver
from robrain.plugins.unit.driver.interface import DriverInterface, OdometryNoise
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.model.localization.pose_track import PoseTrack

HISTORY_ENTRIES = 1024
RADIUS_M = 0.2


class LogDriver(Unit):
    """Stands in for the stock driver, as far as localisation and mapper use it."""

    Parameters = Driver.Parameters
    interface = DriverInterface
    parameters: Driver.Parameters

    def init(self) -> None:
        self._track = PoseTrack(Pose2D(0.0, 0.0, 0.0), HISTORY_ENTRIES)

    def feed(self, stamp_ns: int, T_odom_robot: Pose2D) -> None:
        """Where the odometry had the robot; stamps do not descend."""
        self._track.add(stamp_ns, T_odom_robot)

    def pose(self) -> Pose2D:
        return self._track.pose

    def pose_at(self, stamp_ns: int) -> Pose2D:
        return self._track.pose_at(stamp_ns)

    def odometry_until_ns(self) -> int:
        return self._track.until_ns or 0

    def velocity(self) -> Twist2D:
        return Twist2D()

    def odometry_noise(self) -> OdometryNoise:
        return self.parameters.odometry

    def radius_m(self) -> float:
        return RADIUS_M
