"""An inertial measurement unit that ROS 2 publishes; its turn rate goes to the odometry, as that of `serial_imu`."""

import logging
import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu

from robrain.agent.plugin import external, unlocked
from robrain.agent.silence import FirstWord, Silence
from robrain.algorithms.localization.odometry import YawRate
from robrain.plugins.device.imu import (
    RATE_MAX_RAD_S,
    ImuAbsent,
    ImuInterface,
    ImuMotion,
    ImuSample,
    Mounting,
    check_agreement,
)
from robrain.plugins.device.ros2.link import Ros2Parameters, check_topics, open_link
from robrain.plugins.device.ros2.odometry_message import Header
from robrain.plugins.device.ros2.topic_device import CheckedTopic, TopicDevice
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.model.ranges import Positive

logger = logging.getLogger(__name__)


ACCELERATION_MAX_M_S2 = 2000.0
"""Beyond the range of any accelerometer of this kind: 200 g."""
NOT_MEASURED = -1.0
"""First element of the covariance of a quantity that a unit does not measure (sensor_msgs/Imu, REP 145)."""


class BadImu(ValueError):
    """A message that is not believed; the text is the reason."""


class ImuVector(Protocol):
    """geometry_msgs/Vector3."""

    x: float
    y: float
    z: float


class ImuMessage(Protocol):
    """sensor_msgs/Imu: rad/s and m/s², x ahead, y to the left, z up if it is mounted like that (REP 103)."""

    header: Header
    angular_velocity: ImuVector
    angular_velocity_covariance: Sequence[float]
    linear_acceleration: ImuVector
    linear_acceleration_covariance: Sequence[float]


class ImuReading(NamedTuple):
    """A measurement, with its stamp."""

    stamp_ns: int
    """By the publisher's clock; 0 if it has no stamp."""
    motion: ImuMotion


def read_imu(message: ImuMessage) -> ImuReading:
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
        return ImuReading(stamp_ns, ImuMotion(rate_rad_s))
    x_m_s2, y_m_s2 = message.linear_acceleration.x, message.linear_acceleration.y
    if not math.hypot(x_m_s2, y_m_s2) <= ACCELERATION_MAX_M_S2:
        raise BadImu(f"expected up to {ACCELERATION_MAX_M_S2:g} m/s², got {x_m_s2:g} and {y_m_s2:g}")
    return ImuReading(stamp_ns, ImuMotion(rate_rad_s, x_m_s2, y_m_s2))


class Ros2Imu(TopicDevice):
    """Reads a unit's turn rate and acceleration, and leaves the turn rate to the odometry."""

    class Parameters(Ros2Parameters, frozen=True, kw_only=True, forbid_unknown_fields=True):
        """The topic, and how the unit is mounted."""

        imu: str = "imu/data"
        """Topic of the measurements, sensor_msgs/Imu."""
        upside_down: bool = False
        mounted_yaw_rad: float = 0.0
        """Direction of the unit's x axis, robot's frame; for the accelerations alone."""
        silent_s: Positive = 1.0
        """Time without a measurement, after the first, after which the unit counts as gone."""

        def __post_init__(self) -> None:
            super().__post_init__()
            check_topics(self, "imu")

    interface = ImuInterface
    period_s = 0.02
    parameters: Parameters

    def init(self) -> None:
        wanted = self.parameters
        self._latest: ImuSample | None = None
        self._mounting = Mounting(upside_down=wanted.upside_down, yaw_rad=wanted.mounted_yaw_rad)

    def activate(self) -> None:
        wanted = self.parameters
        self._link = open_link(self.env, wanted)
        self._first, self._silence = FirstWord(self.env.clock.now_ns()), Silence(to_ns(wanted.silent_s))
        self._received_ns: int | None = None
        self.env.board.gyro_contradiction = None
        self._where = wanted.topic(wanted.imu)
        self._topic = CheckedTopic(self._link, Imu, self._where, qos_profile_sensor_data, read_imu, self.env.hurry)

    def step(self) -> None:
        self.check_node()
        check_agreement(self.env.board)
        rates, now_ns = self.env.board.yaw_rates, self.env.clock.now_ns()
        if self._latest is None and self._topic is not None and not self._topic and self._first.is_missing(now_ns):
            logger.warning("%s: no measurement yet: %s", self.env.robot, self._topic.silence_reason)
        for reported, measured_ns, _ in self._topic.take() if self._topic is not None else ():
            latest = self._latest
            before_ns = 0 if latest is None else latest.stamp_ns
            sample = self._mounting.sample(reported.motion, max(before_ns + 1, min(measured_ns, now_ns)))
            self._latest, self._received_ns = sample, now_ns
            rates.append(YawRate(sample.stamp_ns, sample.yaw_rate_rad_s))
        received_ns, silence = self._received_ns, self._silence
        if received_ns is not None and silence.since(received_ns, now_ns) > silence.limit_ns:
            raise ImuAbsent(f"no measurement: {self._topic.silence_reason if self._topic is not None else 'stopped'}")

    @external
    @unlocked
    def latest(self) -> ImuSample | None:
        """The last measurement; null before the first."""
        return self._latest
