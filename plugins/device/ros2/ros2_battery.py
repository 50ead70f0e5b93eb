"""The battery of a ROS 2 robot, with the interface of the stock battery manager."""

import math
from typing import NamedTuple, Protocol

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import BatteryState

from robrain.agent.plugin import external, unlocked
from robrain.plugins.device.bm2.interface import BatteryMeasurement, Bm2Interface, Reading, counted, plausible
from robrain.plugins.device.ros2.link import Ros2Parameters, check_topics, open_link
from robrain.plugins.device.ros2.odometry_message import Header
from robrain.plugins.device.ros2.topic_device import CheckedTopic, TopicDevice
from robrain.protocol.clock import NS_PER_S
from robrain.protocol.model.ranges import Positive

CHARGING, DISCHARGING = 1, 2
"""POWER_SUPPLY_STATUS of sensor_msgs/BatteryState; they decide the sign of the current."""


class BatteryMessage(Protocol):
    """sensor_msgs/BatteryState.

    Values that are not measured are NaN.
    """

    header: Header
    voltage: float
    current: float
    """Negative while discharging."""
    temperature: float
    power_supply_status: int


class BatteryReading(NamedTuple):
    """A measurement of the battery."""

    stamp_ns: int
    """Time by the publisher's clock; 0 if the message has no stamp."""
    reading: Reading


def read_battery(message: BatteryMessage, current_a: float | None, temperature_c: float) -> BatteryReading:
    """The measurement in a message.

    Args:
        message: of the robot.
        current_a: used if the robot does not measure its current; None if it must.
        temperature_c: used if it does not measure its temperature.

    Raises:
        BadReading: no plausible voltage, or no current.

    """
    reading = plausible(
        message.voltage,
        None if math.isnan(message.current) else -message.current,
        message.temperature,
        assumed_a=current_a,
        assumed_c=temperature_c,
        is_charging={CHARGING: True, DISCHARGING: False}.get(message.power_supply_status),
    )
    stamp = message.header.stamp
    return BatteryReading(stamp.sec * NS_PER_S + stamp.nanosec, reading)


class Ros2Battery(TopicDevice):
    """Reads a ROS 2 robot's battery, and integrates charge and energy."""

    class Parameters(Ros2Parameters, frozen=True, kw_only=True, forbid_unknown_fields=True):
        """Topic, and values for quantities that the robot does not measure."""

        battery: str = "battery_state"
        """Topic of the measurements, sensor_msgs/BatteryState."""
        current_a: float | None = None
        """Current of a robot that does not measure it, positive while discharging."""
        temperature_c: float = 25.0
        """Temperature of a battery that does not measure it."""
        gap_s: Positive = 5.0
        """A longer time between two measurements is not counted."""

        def __post_init__(self) -> None:
            super().__post_init__()
            check_topics(self, "battery")

    interface = Bm2Interface
    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        self._latest: BatteryMeasurement | None = None

    def activate(self) -> None:
        wanted = self.parameters
        self._link = open_link(self.env, wanted)
        topic, qos = wanted.topic(wanted.battery), qos_profile_sensor_data
        self._topic = CheckedTopic(self._link, BatteryState, topic, qos, self._read, self.env.hurry)

    def step(self) -> None:
        self.check_node()
        wanted = self.parameters
        for state, stamp_ns, _ in self._topic.take() if self._topic is not None else ():
            self._latest = counted(self._latest, stamp_ns, *state.reading, gap_s=wanted.gap_s)

    @external
    @unlocked
    def latest(self) -> BatteryMeasurement | None:
        """The last measurement; null before the first."""
        return self._latest

    def _read(self, message: BatteryMessage) -> BatteryReading:
        return read_battery(message, self.parameters.current_a, self.parameters.temperature_c)
