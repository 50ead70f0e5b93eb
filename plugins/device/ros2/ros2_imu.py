"""An inertial measurement unit that ROS 2 publishes; its turn rate goes to the odometry, as that of `serial_imu`."""

import logging
import math
from typing import Any

from sensor_msgs.msg import Imu

from robrain.agent.silence import FirstWord, Silence
from robrain.plugins.device.imu import RATE_MAX_RAD_S, ImuAbsent, ImuDevice, ImuMotion
from robrain.plugins.device.ros2.link import Ros2Parameters
from robrain.plugins.device.ros2.topic_device import BadMessage, TopicDevice, stamp_ns_of
from robrain.protocol.clock import to_ns
from robrain.protocol.model.ranges import Positive

logger = logging.getLogger(__name__)

ACCELERATION_MAX_M_S2 = 2000.0
"""Beyond the range of any accelerometer of this kind: 200 g."""
NOT_MEASURED = -1.0
"""First element of the covariance of a quantity that a unit does not measure (sensor_msgs/Imu, REP 145)."""


def read_imu(message: Any) -> tuple[int, ImuMotion]:
    """Stamp and measurement of a sensor_msgs/Imu: rad/s and m/s², axes by REP 103 if the unit is mounted like that.

    Raises:
        BadMessage: a number that is not in range, or no turn rate.

    """
    rate_rad_s = message.angular_velocity.z
    if message.angular_velocity_covariance[0] == NOT_MEASURED:
        raise BadMessage("the IMU does not measure angular velocity")
    if not abs(rate_rad_s) <= RATE_MAX_RAD_S:
        raise BadMessage(f"expected a rate up to {RATE_MAX_RAD_S:g} rad/s, got {rate_rad_s:g}")
    if message.linear_acceleration_covariance[0] == NOT_MEASURED:
        return stamp_ns_of(message), ImuMotion(rate_rad_s)
    x_m_s2, y_m_s2 = message.linear_acceleration.x, message.linear_acceleration.y
    if not math.hypot(x_m_s2, y_m_s2) <= ACCELERATION_MAX_M_S2:
        raise BadMessage(f"expected up to {ACCELERATION_MAX_M_S2:g} m/s², got {x_m_s2:g} and {y_m_s2:g}")
    return stamp_ns_of(message), ImuMotion(rate_rad_s, x_m_s2, y_m_s2)


class Ros2Imu(TopicDevice, ImuDevice):
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

        topics = ("imu",)

    parameters: Parameters

    def activate(self) -> None:
        self.env.board.gyro_contradiction = None
        self._first = FirstWord(self.env.clock.now_ns())
        self._silence = Silence(to_ns(self.parameters.silent_s))
        self._received_ns: int | None = None
        self.subscribe(Imu, self.parameters.imu, read_imu)

    def step(self) -> None:
        received, now_ns = self.received(), self.env.clock.now_ns()
        self.check_agreement()
        for motion, measured_ns, _ in received:
            self.add(motion, min(measured_ns, now_ns))
            self._received_ns = now_ns
        if self.latest() is None and self._first.is_missing(now_ns):
            logger.warning("%s: no measurement yet: %s", self.env.robot, self.silence_reason())
        received_ns, silence = self._received_ns, self._silence
        if received_ns is not None and silence.since(received_ns, now_ns) > silence.limit_ns:
            raise ImuAbsent(f"no measurement: {self.silence_reason()}")
