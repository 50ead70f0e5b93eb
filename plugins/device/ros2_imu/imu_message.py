"""What is believed of a sensor_msgs/Imu."""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from robrain.plugins.device.imu.imu_codec import Motion
from robrain.plugins.device.imu.mounting import RATE_MAX_RAD_S
from robrain.plugins.device.ros2_base.odometry_message import Header
from robrain.protocol.wire.clock import NS_PER_S

ACCELERATION_MAX_M_S2 = 2000.0
"""Beyond the range of any accelerometer of this kind: 200 g."""
NOT_MEASURED = -1.0
"""First element of the covariance of what a unit does not measure (sensor_msgs/Imu, REP 145)."""


class BadImu(ValueError):
    """A message that is not believed; says why."""


class Vector(Protocol):
    """geometry_msgs/Vector3."""

    x: float
    y: float
    z: float


class ImuMessage(Protocol):
    """sensor_msgs/Imu: rad/s and m/s², x ahead, y to the left, z up if it is mounted like that (REP 103)."""

    header: Header
    angular_velocity: Vector
    angular_velocity_covariance: Sequence[float]
    linear_acceleration: Vector
    linear_acceleration_covariance: Sequence[float]


class ToldMotion(NamedTuple):
    """A measurement, with its stamp."""

    stamp_ns: int
    """By the publisher's clock; 0 if it has no stamp."""
    motion: Motion


def read_imu(message: ImuMessage) -> ToldMotion:
    """The measurement in a message.

    Raises:
        BadImu: a number that is not in range, or no turn rate.

    """
    rate_rad_s = message.angular_velocity.z
    if message.angular_velocity_covariance[0] == NOT_MEASURED:
        raise BadImu("the unit does not measure its angular velocity")
    if not abs(rate_rad_s) <= RATE_MAX_RAD_S:
        raise BadImu(f"expected a rate up to {RATE_MAX_RAD_S:g} rad/s, got {rate_rad_s:g}")
    stamp = message.header.stamp
    stamp_ns = stamp.sec * NS_PER_S + stamp.nanosec
    if message.linear_acceleration_covariance[0] == NOT_MEASURED:
        return ToldMotion(stamp_ns, Motion(rate_rad_s))
    x_m_s2, y_m_s2 = message.linear_acceleration.x, message.linear_acceleration.y
    if not math.hypot(x_m_s2, y_m_s2) <= ACCELERATION_MAX_M_S2:
        raise BadImu(f"expected up to {ACCELERATION_MAX_M_S2:g} m/s², got {x_m_s2:g} and {y_m_s2:g}")
    return ToldMotion(stamp_ns, Motion(rate_rad_s, x_m_s2, y_m_s2))
