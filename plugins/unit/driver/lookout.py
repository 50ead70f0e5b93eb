"""What lies where the driver wants to go: by lidar, range sensors and bump contacts."""

import math

from robrain.plugins.device.mocdevice.interface import MocDeviceInterface
from robrain.plugins.device.range_sensors.interface import Bump, RangeSensorsInterface
from robrain.plugins.device.scan.interface import ScanInterface
from robrain.plugins.unit.obstacle_points import ObstaclePoints
from robrain.protocol.model.geometry import Pose2D, wrap_angle_rad
from robrain.protocol.model.navigation.obstacles import Passage, contact_distance_m, hold_off, passage

BUMPED_RAD = math.radians(80.0)
"""The robot does not drive within this angle of a touched direction."""
SQUEEZED_GAP_M = 0.03
"""In a narrow place the robot's edge stays this far from what is ahead."""


class Lookout:
    """Keeps the latest sensor data and answers how far a direction is free.

    Args:
        moc: tells where the robot was when something was seen, and how large it is.
        scan: the lidar; told if it is frozen.
        ranges: the range sensors and bump contacts.
        stop_distance_m: the robot's edge is to stay this far from what is ahead.

    """

    def __init__(
        self, moc: MocDeviceInterface, scan: ScanInterface, ranges: RangeSensorsInterface, stop_distance_m: float
    ) -> None:
        self._scan = scan
        self._ranges = ranges
        self._obstacles = ObstaclePoints(moc.pose_at)
        self._touched_rad = ranges.pressed_rad()
        # What the swept disc, a little wider than the robot, would touch.
        self._reach_m = moc.radius_m() + 0.25 * stop_distance_m
        self._gap_m = 0.75 * stop_distance_m
        self._radius_m = moc.radius_m()

    def feel(self, bump: Bump) -> None:
        """Take a change of the bump contacts."""
        self._touched_rad = bump.directions_rad

    def look(self, now_ns: int) -> str:
        """Read the sensors; returns why the robot is blind, empty if it is not."""
        blind_why = self._obstacles.update(self._scan.latest(), self._ranges.latest(), now_ns)
        if self._obstacles.is_frozen:
            self._scan.doubt("the lidar is frozen: its ranges stay equal to the millimetre while the robot moves")
        return blind_why

    def free_m(self, pose: Pose2D, heading_rad: float) -> float:
        """How far the robot can go straight in this direction of odom, less its stop distance before an obstacle."""
        if self._is_touched(pose, heading_rad):
            return 0.0
        points_m = self._obstacles.points_m
        return contact_distance_m(points_m, pose.x_m, pose.y_m, heading_rad, self._reach_m) - self._gap_m

    def passage(self, pose: Pose2D, heading_rad: float) -> Passage:
        """The room for squeezing straight ahead through a narrow place, by the lidar.

        Range sensors do not tell directions within their cone, so they count only for what is straight ahead.
        """
        found = passage(self._obstacles.scan_m, pose.x_m, pose.y_m, heading_rad, self._radius_m)
        free_m = min(found.free_m, self._heard_m(pose, heading_rad)) - SQUEEZED_GAP_M
        return found._replace(free_m=0.0 if self._is_touched(pose, heading_rad) else free_m)

    def hold_off(
        self, pose: Pose2D, velocity_m_s: tuple[float, float], keep_m: float, per_s: float
    ) -> tuple[float, float]:
        """The velocity (x, y), frame odom, less what would bring the hull within `keep_m` of what the lidar sees."""
        x_m_s, y_m_s = velocity_m_s
        if math.hypot(x_m_s, y_m_s) > 0.0 and self._is_touched(pose, math.atan2(y_m_s, x_m_s)):
            return 0.0, 0.0
        return hold_off(self._obstacles.scan_m, pose.x_m, pose.y_m, x_m_s, y_m_s, self._radius_m, keep_m, per_s)

    def _is_touched(self, pose: Pose2D, heading_rad: float) -> bool:
        return any(
            abs(wrap_angle_rad(pose.yaw_rad + touched_rad - heading_rad)) < BUMPED_RAD
            for touched_rad in self._touched_rad
        )

    def _heard_m(self, pose: Pose2D, heading_rad: float) -> float:
        reach_m = 0.5 * self._radius_m
        contact_m = contact_distance_m(self._obstacles.ring_m, pose.x_m, pose.y_m, heading_rad, reach_m)
        return contact_m - (self._radius_m - reach_m)
