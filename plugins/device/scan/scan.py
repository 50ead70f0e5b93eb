"""Lidar whose scans come over the wire, as those of the simulator do."""

from robrain.plugins.device.scan.interface import LaserScan
from robrain.plugins.device.scan.lidar_device import LidarDevice, Mount, ScanMaker
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_SCAN, Scan
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.ranges import Positive
from robrain.protocol.serial.points import Point

MM_PER_M = 1000.0
CENTRAL = Mount()
ORIGIN = Pose2D(0.0, 0.0, 0.0)


class ScanDevice(LidarDevice):
    """Passes on each turn of the lidar."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """When the lidar counts as gone, and how it is mounted."""

        silent_s: Positive = 3.0
        """Time without a turn after which the lidar faults; the stock lidar turns five times a second."""
        mount: Mount = Mount()
        """Place and direction of the lidar on the robot, if its turns are in its own frame."""

    parameters: Parameters
    period_s = 0.2  # and as soon as a turn arrives

    def init(self) -> None:
        super().init()
        self._inbox = Inbox()
        self._angles_rad: tuple[float, ...] = ()
        self._fan: tuple[int, float, float] | None = None

    def begin(self) -> None:
        self.env.wire.subscribe(self._inbox, ARENA_SCAN, robot=self.env.robot)
        self.env.wake_on(self._inbox)

    def read_turns(self, now_ns: int) -> None:
        for received in self._inbox.drain():
            scan: Scan = received.message
            self.record(self._convert(scan), scan.ranges_mm, now_ns)

    def _convert(self, scan: Scan) -> LaserScan:
        fan = (len(scan.ranges_mm), scan.angle_min_rad, scan.angle_increment_rad)
        if fan != self._fan:
            self._fan = fan
            first_rad, step_rad = scan.angle_min_rad, scan.angle_increment_rad
            self._angles_rad = tuple(first_rad + step_rad * beam for beam in range(len(scan.ranges_mm)))
        far_m, mount = scan.range_max_m, self.parameters.mount
        if mount != CENTRAL and scan.ranges_mm:
            ranges_mm = zip(self._angles_rad, scan.ranges_mm, strict=True)
            points = [Point(angle_rad, mm / MM_PER_M) for angle_rad, mm in ranges_mm]
            return ScanMaker(len(points), far_m, mount).scan([(ORIGIN, points)], (), scan.stamp_ns)
        ranges_m = tuple([mm / MM_PER_M if mm else far_m for mm in scan.ranges_mm])
        return LaserScan(scan.stamp_ns, self._angles_rad, ranges_m, scan.range_max_m)
