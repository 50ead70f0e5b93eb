"""Inertial measurement units: their interface, faults and mounting, and the common part of their devices."""

import math
from typing import NamedTuple, Protocol

import msgspec

from robrain.agent.plugin import Device, external, unlocked
from robrain.algorithms.localization.odometry import YawRate


class ImuMotion(NamedTuple):
    """One measurement in the axes of the unit: x ahead, y to the left, z up if it is mounted like that."""

    yaw_rate_rad_s: float
    """Turn rate about z."""
    x_m_s2: float | None = None
    y_m_s2: float | None = None


class ImuAbsent(OSError):
    """The unit is not there, or is silent."""


class ImuContradicted(Exception):
    """The unit is mounted or read wrongly; until it agrees the wheels' turning counts."""


class ImuSample(msgspec.Struct, frozen=True):
    """One measurement, robot's frame (x ahead, y to the left, z up)."""

    stamp_ns: int
    """Time of measurement, robot's clock."""
    yaw_rate_rad_s: float
    """Turn rate about z, to the left positive, with its bias."""
    forward_m_s2: float | None = None
    """Acceleration along x, as measured; None if it is not."""
    left_m_s2: float | None = None
    """Along y."""


class ImuInterface(Protocol):
    """Measurements as they come; each is left on the board, where the odometry finds it."""

    def latest(self) -> ImuSample | None:
        """The last measurement; None before the first."""


RATE_MAX_RAD_S = 40.0
"""Limit beyond the range of any gyroscope of this kind."""


class ImuDevice(Device):
    """Common part of all units: leaves the turn rate to the odometry."""

    interface = ImuInterface
    period_s = 0.02
    yaw_sign = 1
    """-1 for a unit whose rate is positive to the right."""
    _latest: ImuSample | None = None

    def add(self, motion: ImuMotion, stamp_ns: int) -> None:
        """Leave a measurement on the board, after the one before, and in the robot's frame."""
        wanted, before = self.parameters, self._latest
        side = -1.0 if wanted.upside_down else 1.0
        stamp_ns = max(stamp_ns, 1 if before is None else before.stamp_ns + 1)
        rate_rad_s, forward_m_s2, left_m_s2 = side * self.yaw_sign * motion.yaw_rate_rad_s, None, None
        if motion.x_m_s2 is not None and motion.y_m_s2 is not None:
            cos, sin = math.cos(wanted.mounted_yaw_rad), math.sin(wanted.mounted_yaw_rad)
            forward_m_s2 = cos * motion.x_m_s2 - sin * side * motion.y_m_s2
            left_m_s2 = sin * motion.x_m_s2 + cos * side * motion.y_m_s2
        self._latest = ImuSample(stamp_ns, rate_rad_s, forward_m_s2, left_m_s2)
        self.env.board.yaw_rates.append(YawRate(stamp_ns, rate_rad_s))

    def check_agreement(self) -> None:
        """Raise ImuContradicted if the odometry has found that the unit and the wheels contradict each other."""
        ratio = self.env.board.gyro_contradiction
        if ratio is None:
            return
        what = f"it turns {ratio:.2g} times as far as the wheels turn the robot"
        if ratio < 0:
            what = f"{what}: the unit is upside down, or counts to the right ([parameters.imu] upside_down)"
            raise ImuContradicted(what)
        raise ImuContradicted(f"{what}: check the unit of its turn rate")

    @external
    @unlocked
    def latest(self) -> ImuSample | None:
        """The last measurement; null before the first."""
        return self._latest
