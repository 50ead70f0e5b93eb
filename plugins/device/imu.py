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


class Mounting:
    """Converts the IMU's measurements into the robot's frame.

    Args:
        upside_down: whether the IMU's z axis points down.
        yaw_rad: direction of the IMU's x axis in the robot's frame; affects only the accelerations.
        yaw_sign: -1 for an IMU whose rate is positive to the right.

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


class ImuDevice(Device):
    """Common part of all units: leaves the turn rate to the odometry."""

    interface = ImuInterface
    period_s = 0.02
    mounting: Mounting
    _latest: ImuSample | None = None

    def add(self, motion: ImuMotion, stamp_ns: int) -> None:
        """Leave a measurement on the board, after the one before."""
        before_ns = 0 if self._latest is None else self._latest.stamp_ns
        self._latest = sample = self.mounting.sample(motion, max(before_ns + 1, stamp_ns))
        self.env.board.yaw_rates.append(YawRate(sample.stamp_ns, sample.yaw_rate_rad_s))

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
