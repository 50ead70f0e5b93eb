"""How an inertial measurement unit is mounted, and what it measures in the robot's frame."""

import math

from robrain.plugins.device.imu.imu_codec import ImuMotion
from robrain.plugins.device.imu.interface import ImuSample

RATE_MAX_RAD_S = 40.0
"""Beyond the range of any gyroscope of this kind."""


class Mounting:
    """Turns measurements of the unit into the robot's frame.

    Args:
        upside_down: its z axis points down.
        yaw_rad: direction of its x axis, robot's frame; for the accelerations alone.
        yaw_sign: -1 for a unit whose rate is positive to the right.

    """

    def __init__(self, *, upside_down: bool, yaw_rad: float, yaw_sign: int = 1) -> None:
        self._turns = -yaw_sign if upside_down else yaw_sign
        self._left_sign = -1.0 if upside_down else 1.0
        self._cos, self._sin = math.cos(yaw_rad), math.sin(yaw_rad)

    def sample(self, motion: ImuMotion, stamp_ns: int) -> ImuSample:
        """A measurement in the robot's frame."""
        rate_rad_s = self._turns * motion.yaw_rate_rad_s
        if motion.x_m_s2 is None or motion.y_m_s2 is None:
            return ImuSample(stamp_ns, rate_rad_s)
        x_m_s2, y_m_s2 = motion.x_m_s2, self._left_sign * motion.y_m_s2
        return ImuSample(
            stamp_ns,
            rate_rad_s,
            self._cos * x_m_s2 - self._sin * y_m_s2,
            self._sin * x_m_s2 + self._cos * y_m_s2,
        )
