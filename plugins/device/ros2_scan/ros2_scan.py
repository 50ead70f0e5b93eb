"""The lidar of a ROS 2 robot, with the interface of the stock one.

A lidar that falls silent is a fault of this device, and so is one that a user doubts, as the driver does when the
ranges stay equal while the robot moves. A turn that was doubted is not handed on again, also after a restart.
"""

import math

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan as LaserScanMessage

from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.agent.silence import Silence
from robrain.plugins.device.ros2.link import Ros2Link, Subscription, open_link
from robrain.plugins.device.ros2.parameters import Ros2Parameters, check_topics
from robrain.plugins.device.ros2.stamp_clock import StampClock
from robrain.plugins.device.ros2_scan.scan_message import BadScan, ScanMessage, ScanReader, ToldScan
from robrain.plugins.device.scan.interface import LaserScan, ScanInterface
from robrain.plugins.device.scan.scan import MM_PER_M, LidarFault
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.ranges import check_positive
from robrain.protocol.wire.clock import NS_PER_S, to_ns


class Ros2Scan(Device):
    """Passes on each turn of a ROS 2 robot's lidar, as seen from the robot's centre."""

    class Parameters(Ros2Parameters, frozen=True, kw_only=True, forbid_unknown_fields=True):
        """Topic, mounting and limits."""

        scan: str = "scan"
        """Topic of the turns, sensor_msgs/LaserScan."""
        x_m: float = 0.0
        """Place of the lidar in the robot's frame: forward of its centre."""
        y_m: float = 0.0
        """To the left of it."""
        yaw_rad: float = 0.0
        """Direction of the lidar's x axis, counter-clockwise from that of the robot."""
        beams: int = 360
        """Directions around the robot that turns are resampled to; 0 gives the lidar's own beams."""
        range_max_m: float = 0.0
        """Greatest range that is used; 0: that which the lidar tells."""
        silent_s: float = 1.0
        """Time without a turn after which the lidar faults."""

        def __post_init__(self) -> None:
            super().__post_init__()
            check_topics(self, "scan")
            check_positive(self, "silent_s")
            if not all(map(math.isfinite, (self.x_m, self.y_m, self.yaw_rad))):
                raise ValueError("expected x_m, y_m and yaw_rad to be finite")
            if not 0.0 <= self.range_max_m < math.inf:
                raise ValueError(f"expected range_max_m >= 0, got {self.range_max_m}")
            if not 0 <= self.beams <= 10_000:
                raise ValueError(f"expected beams from 0 to 10000, got {self.beams}")
            if not self.beams and (self.x_m or self.y_m):
                raise ValueError("expected beams > 0 for a lidar that is not at the robot's centre, got 0")

    interface = ScanInterface
    period_s = 0.2  # and as soon as a turn arrives
    parameters: Parameters
    scanned = Event[LaserScan]()
    trouble = Event[str](outside=True)
    """Why the lidar is at fault, before the device faults."""

    def init(self) -> None:
        self._link: Ros2Link | None = None
        self._inbox: Subscription[ScanMessage] | None = None
        self._latest: LaserScan | None = None
        self._ranges_mm: list[int] = []
        self._doubt = self._why_rejected = ""
        self._rejected = 0

    def activate(self) -> None:
        wanted = self.parameters
        self._silence = Silence(to_ns(wanted.silent_s))
        self._heard_ns = self.env.clock.now_ns()
        self._clock = StampClock()
        self._reader = ScanReader(Pose2D(wanted.x_m, wanted.y_m, wanted.yaw_rad), wanted.beams, wanted.range_max_m)
        link, topic = open_link(self.env, wanted), wanted.topic(wanted.scan)
        self._link = link
        if self.env.board.has_scanned and link.is_gone(topic):
            raise LidarFault(self.env.plugin, f"no turn of the lidar: {self._where(link)}")
        self._inbox = link.subscribe(LaserScanMessage, topic, qos_profile_sensor_data, self.env.hurry)

    def step(self) -> None:
        link, inbox = self._link, self._inbox
        if link is None or inbox is None:
            return
        if link.failure:
            self._fail(link.failure)
        for arrived in inbox.drain():
            try:
                told = self._reader.read(arrived.message)
            except BadScan as error:
                self._rejected += 1
                self._why_rejected = str(error)
                continue
            self._take(told, self._clock.measured_ns(told.stamp_ns, arrived.arrived_ns))
        if self._doubt:
            self.env.board.doubted_scan = self._ranges_mm
            self._fail(self._doubt)
        self._check(link)

    def deactivate(self) -> None:
        link, self._link = self._link, None
        if self._inbox is not None:
            self._inbox.close()
            self._inbox = None
        if link is not None:
            link.release()

    def latest(self) -> LaserScan | None:
        """The last scan; None before the first."""
        return self._latest

    def doubt(self, why: str) -> None:
        """Say that the last scan cannot be true: the device faults, and hands no such turn on again."""
        self._doubt = why

    @external
    def nearest_m(self) -> float | None:
        """Distance to the nearest object in sight; null if there is none, and before the first scan."""
        if self._latest is None:
            return None
        nearest_m = min(self._latest.beam_ranges_m, default=math.inf)
        return nearest_m if nearest_m < self._latest.range_max_m else None

    @external
    def rejected(self) -> int:
        """Turns that were rejected: angles, ranges or limits that cannot be."""
        return self._rejected

    @external
    def why_rejected(self) -> str:
        """Why the last of them was; empty if none was."""
        return self._why_rejected

    def _take(self, told: ToldScan, measured_ns: int) -> None:
        board = self.env.board
        ranges_mm = [round(MM_PER_M * range_m) for range_m in told.ranges_m]
        if ranges_mm == board.doubted_scan:
            return
        board.doubted_scan = None
        board.has_scanned = True
        self._heard_ns = self.env.clock.now_ns()
        self._ranges_mm = ranges_mm
        self._latest = LaserScan(measured_ns, told.angles_rad, told.ranges_m, told.range_max_m)
        self.scanned.notify(self._latest)

    def _check(self, link: Ros2Link) -> None:
        board, now_ns = self.env.board, self.env.clock.now_ns()
        if not board.has_scanned or now_ns - self._heard_ns <= self._silence.begins_ns:
            return
        silent_ns = self._silence.since(self._heard_ns, now_ns)
        if silent_ns < self._silence.limit_ns:
            return
        what = "no turn" if board.doubted_scan is None else "nothing but the turn that it froze in"
        self._fail(f"the lidar has sent {what} for {silent_ns / NS_PER_S:.1f} s: {self._where(link)}")

    def _where(self, link: Ros2Link) -> str:
        topic = self.parameters.topic(self.parameters.scan)
        if not link.publishers(topic):
            return f"{topic} has no publisher in ROS domain {link.domain_id}"
        return f"the publisher of {topic} is silent, or what it says is rejected"

    def _fail(self, why: str) -> None:
        self.trouble.notify(why)
        raise LidarFault(self.env.plugin, why)
