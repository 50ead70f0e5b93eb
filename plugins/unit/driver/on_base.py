"""What every driver passes on from its base, whoever plans the motion."""

from robrain.agent.plugin import Unit, external
from robrain.plugins.device.mocdevice.interface import Counters, MocDeviceInterface
from robrain.plugins.unit.driver.interface import OdometryNoise
from robrain.protocol.model.geometry import Pose2D, Twist2D


class OnBase(Unit):
    """A unit on `mocdevice`; subclasses set `_moc` when they are activated, and say how exact its odometry is."""

    _moc: MocDeviceInterface

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
