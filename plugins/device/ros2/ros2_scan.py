"""The lidar of a ROS 2 robot, with the interface of the stock one."""

from typing import Annotated

from msgspec import Meta
from sensor_msgs.msg import LaserScan as LaserScanMessage

from robrain.plugins.device.ros2.link import Ros2Parameters
from robrain.plugins.device.ros2.scan_reader import ScanReader
from robrain.plugins.device.ros2.topic_device import TopicDevice
from robrain.plugins.device.scan.interface import LaserScan
from robrain.plugins.device.scan.lidar_device import LidarDevice, LidarFault, Mount
from robrain.protocol.model.ranges import NotNegative, Positive

MM_PER_M = 1000.0


class Ros2Scan(TopicDevice, LidarDevice):
    """Passes on each turn of a ROS 2 robot's lidar, as seen from the robot's centre."""

    class Parameters(Ros2Parameters, frozen=True, kw_only=True, forbid_unknown_fields=True):
        """Topic, mounting and limits."""

        scan: str = "scan"
        """Topic of the turns, sensor_msgs/LaserScan."""
        mount: Mount = Mount()
        beams: Annotated[int, Meta(ge=0, le=10000)] = 360
        """Directions around the robot that turns are resampled to; 0 gives the lidar's own beams."""
        range_max_m: NotNegative = 0.0
        """Greatest range that is used; 0: that which the lidar reports, or 10 m if that is infinite."""
        silent_s: Positive = 1.0
        """Time without a turn after which the lidar faults."""

        topics = ("scan",)

        def __post_init__(self) -> None:
            super().__post_init__()
            if not self.beams and (self.mount.x_m or self.mount.y_m):
                raise ValueError("expected beams > 0 for a lidar that is not at the robot's centre, got 0")

    period_s = 0.2  # and as soon as a turn arrives
    parameters: Parameters

    def begin(self) -> None:
        wanted = self.parameters
        reader = ScanReader(wanted.mount, wanted.beams, wanted.range_max_m)
        link = self.subscribe(LaserScanMessage, wanted.scan, reader.read)
        if self.env.board.has_scanned and link.is_gone(wanted.topic(wanted.scan)):
            raise LidarFault(self.env.plugin, f"no turn of the lidar{self.where()}")

    def read_turns(self, now_ns: int) -> None:
        if self._link is not None and self._link.failure:
            self.fail(self._link.failure)
        for turn, measured_ns, _ in self.received():
            scan = LaserScan(measured_ns, turn.angles_rad, turn.ranges_m, turn.range_max_m)
            self.record(scan, [round(MM_PER_M * range_m) for range_m in turn.ranges_m], now_ns)

    def where(self) -> str:
        reason = self.silence_reason()
        return f": {reason}" if reason else ""
