"""What is believed of a sensor_msgs/BatteryState."""

import math
from typing import NamedTuple, Protocol

from robrain.plugins.device.bm2.counting import Reading, plausible
from robrain.plugins.device.ros2_base.odometry_message import Header
from robrain.protocol.wire.clock import NS_PER_S

CHARGING, DISCHARGING = 1, 2
"""POWER_SUPPLY_STATUS of sensor_msgs/BatteryState; they decide the sign of the current."""


class BatteryMessage(Protocol):
    """sensor_msgs/BatteryState. What is not measured is NaN."""

    header: Header
    voltage: float
    current: float
    """Negative while discharging."""
    temperature: float
    power_supply_status: int


class ToldBattery(NamedTuple):
    """A measurement of the battery."""

    stamp_ns: int
    """By the clock of whoever stamped it; 0 if it has no stamp."""
    reading: Reading


def read_battery(message: BatteryMessage, current_a: float | None, temperature_c: float) -> ToldBattery:
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
    return ToldBattery(stamp.sec * NS_PER_S + stamp.nanosec, reading)
