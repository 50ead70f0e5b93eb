"""Reads a LaserScan of ROS 2. Apart from the device: its arrays need numpy, which a plain install lacks."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.plugins.device.ros2.topic_device import BadMessage, stamp_ns_of
from robrain.plugins.device.scan.lidar_device import Mount
from robrain.protocol.clock import to_ns

BEAMS_MAX = 100_000
RANGE_MAX_M = 1000.0
"""A greater `range_max` is no limit: pointcloud_to_laserscan sends inf."""
UNLIMITED_M = 10.0
"""Range that is used of a lidar that reports no limit (chosen: every lidar of this kind reaches as far)."""
TURN_RAD = 2.0 * math.pi
TURN_SLACK_RAD = 0.1
"""A lidar may see a little more than one turn."""
VALID_SHARE = 0.02
"""Least valid share of a turn, hits or free, for it to be believed."""
SCAN_TIME_MAX_S = 2.0

Floats = NDArray[np.float64]


class ScanReading(NamedTuple):
    """A turn in the robot's frame."""

    angles_rad: tuple[float, ...]
    ranges_m: tuple[float, ...]
    """From the robot's centre; `range_max_m` where nothing was hit."""
    range_max_m: float


class ScanReader:
    """Turns messages into turns of the robot's own lidar.

    Args:
        mount: pose of the lidar, and its field of view.
        beams: number of directions of a turn, evenly around the robot, of which those that the lidar sees are given.
            The value 0 gives the lidar's own beams, if it is mounted at the robot's centre.
        range_max_m: greatest range that is used; 0 for that of the message.

    """

    def __init__(self, mount: Mount, beams: int, range_max_m: float) -> None:
        self._mount, self._beams, self._range_max_m = mount, beams, range_max_m
        self._fan: tuple[int, float, float] | None = None
        self._angles_rad: Floats = np.zeros(0)
        """Of the message's beams, in the robot's frame."""

    def read(self, message: Any) -> tuple[int, ScanReading]:
        """Time of the middle of the turn (0 if the message has none), and the turn in a sensor_msgs/LaserScan.

        Raises:
            BadMessage: a turn that is not believed.

        """
        ranges_m = np.array(message.ranges, dtype=np.float64)
        self._check(message, len(ranges_m))
        is_limited = message.range_max <= RANGE_MAX_M
        far_m = min(message.range_max, self._range_max_m or (message.range_max if is_limited else UNLIMITED_M))
        # REP 117: -inf is too near to be measured, +inf is nothing within reach, NaN is no measurement.
        with np.errstate(invalid="ignore"):
            is_close = ranges_m == -np.inf
            is_hit = (ranges_m >= message.range_min) & (ranges_m < far_m) | is_close
            is_free = ranges_m >= far_m
        ranges_m[is_close], ranges_m[is_free] = message.range_min, far_m
        valid = (is_hit | is_free) & ~self._hidden(ranges_m, is_hit)
        if np.count_nonzero(valid) < max(VALID_SHARE * len(ranges_m), 1.0):
            what = f"expected ranges from {message.range_min:g} m, and beyond the robot itself"
            raise BadMessage(f"{what}, got {len(ranges_m)} of which none is valid")
        angles_rad, ranges_m, is_hit = self._angles_rad[valid], ranges_m[valid], is_hit[valid]
        if self._beams:
            # From its centre the robot sees less far in the direction away from the lidar.
            far_m -= math.hypot(self._mount.x_m, self._mount.y_m)
            if far_m <= 0.0:
                raise BadMessage(f"expected a reach beyond the robot's centre, got range_max {message.range_max:g}")
            angles_rad, ranges_m = self._resample(angles_rad, ranges_m, is_hit, far_m)
        turn = ScanReading(tuple(angles_rad.tolist()), tuple(ranges_m.tolist()), far_m)
        return _middle_ns(message, len(valid)), turn

    def _check(self, message: Any, beams: int) -> None:
        first_rad, step_rad = message.angle_min, message.angle_increment
        if not 1 <= beams <= BEAMS_MAX:
            raise BadMessage(f"expected 1 to {BEAMS_MAX} ranges, got {beams}")
        if not (abs(first_rad) <= TURN_RAD + TURN_SLACK_RAD and 0.0 < abs(step_rad) <= TURN_RAD):
            raise BadMessage(f"expected beams within a turn, got angle_min {first_rad:g}, angle_increment {step_rad:g}")
        if abs(step_rad) * (beams - 1) > TURN_RAD + TURN_SLACK_RAD:
            raise BadMessage(f"expected beams within a turn, got {beams} with angle_increment {step_rad:g}")
        span_rad = message.angle_max - first_rad
        if not abs(span_rad - step_rad * (beams - 1)) <= 1.5 * abs(step_rad):
            raise BadMessage(f"expected {span_rad / step_rad + 1:.0f} ranges by the angles, got {beams}")
        if not 0.0 <= message.range_min < message.range_max:
            raise BadMessage(f"expected range_min < range_max, got {message.range_min:g} and {message.range_max:g}")
        if (fan := (beams, first_rad, step_rad)) != self._fan:
            self._fan = fan
            sign = -1.0 if self._mount.upside_down else 1.0
            turned_rad = sign * (first_rad + step_rad * np.arange(beams, dtype=np.float64))
            self._angles_rad = turned_rad + self._mount.yaw_rad

    def _hidden(self, ranges_m: Floats, is_hit: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Mask of the hits that are parts of the robot itself."""
        mount = self._mount
        if not mount.hidden_within_m:
            return np.zeros_like(is_hit)
        x_m = mount.x_m + ranges_m * np.cos(self._angles_rad)
        y_m = mount.y_m + ranges_m * np.sin(self._angles_rad)
        return is_hit & (np.hypot(x_m, y_m) < mount.hidden_within_m)

    def _resample(
        self, angles_rad: Floats, ranges_m: Floats, is_hit: NDArray[np.bool_], far_m: float
    ) -> tuple[Floats, Floats]:
        """Angles and ranges of the directions in which something was measured, in their order."""
        x_m = self._mount.x_m + ranges_m * np.cos(angles_rad)
        y_m = self._mount.y_m + ranges_m * np.sin(angles_rad)
        step_rad = TURN_RAD / self._beams
        seen_rad, seen_m = np.arctan2(y_m, x_m), np.hypot(x_m, y_m)
        seen_m = np.where(is_hit & (seen_m < far_m), seen_m, far_m)
        direction = np.rint((seen_rad + math.pi) / step_rad).astype(np.int64) % self._beams
        nearest_m = np.full(self._beams, np.inf)
        np.minimum.at(nearest_m, direction, seen_m)
        # The angle of the beam that was hit, not that of the direction's middle, so that walls stay where they are.
        angles = -math.pi + step_rad * np.arange(self._beams)
        is_nearest = seen_m <= nearest_m[direction]
        angles[direction[is_nearest]] = seen_rad[is_nearest]
        was_seen = np.isfinite(nearest_m)
        return angles[was_seen], nearest_m[was_seen]


def _middle_ns(message: Any, beams: int) -> int:
    """Time of the beam in the middle; the stamp is that of the first one."""
    stamp_ns = stamp_ns_of(message)
    duration_s = message.time_increment * (beams - 1)
    if stamp_ns <= 0 or not 0.0 <= duration_s <= SCAN_TIME_MAX_S:
        return max(stamp_ns, 0)
    return stamp_ns + to_ns(0.5 * duration_s)
