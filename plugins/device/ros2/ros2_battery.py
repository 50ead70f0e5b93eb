"""The battery of a ROS 2 robot, with the interface of the stock battery manager."""

import math
from typing import Any

from sensor_msgs.msg import BatteryState

from robrain.plugins.device.bm2.interface import BatteryDevice, Reading, plausible
from robrain.plugins.device.ros2.link import Ros2Parameters
from robrain.plugins.device.ros2.topic_device import TopicDevice, stamp_ns_of
from robrain.protocol.model.ranges import Positive

CHARGING, DISCHARGING = 1, 2
"""POWER_SUPPLY_STATUS of sensor_msgs/BatteryState; they decide the sign of the current."""


def read_battery(message: Any, current_a: float | None, temperature_c: float) -> tuple[int, Reading]:
    """Stamp and measurement of a sensor_msgs/BatteryState, whose values are NaN if they are not measured.

    Args:
        message: of the robot.
        current_a: used if the robot does not measure its current; None if it must.
        temperature_c: used if it does not measure its temperature.

    Raises:
        BadReading: no plausible voltage, or no current.

    """
    reading = plausible(
        message.voltage,
        None if math.isnan(message.current) else -message.current,  # the message's is negative while discharging
        message.temperature,
        assumed_a=current_a,
        assumed_c=temperature_c,
        is_charging={CHARGING: True, DISCHARGING: False}.get(message.power_supply_status),
    )
    return stamp_ns_of(message), reading


class Ros2Battery(TopicDevice, BatteryDevice):
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

        topics = ("battery",)

    parameters: Parameters

    def activate(self) -> None:
        self.gap_s = self.parameters.gap_s
        self.subscribe(BatteryState, self.parameters.battery, self._read)

    def step(self) -> None:
        for reading, stamp_ns, _ in self.received():
            self.count(reading, stamp_ns)

    def _read(self, message: Any) -> tuple[int, Reading]:
        return read_battery(message, self.parameters.current_a, self.parameters.temperature_c)
