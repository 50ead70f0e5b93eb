"""What is believed of a sensor_msgs/BatteryState."""

import math
from typing import NamedTuple, Protocol

from robrain.plugins.device.ros2_base.odometry_message import Header
from robrain.protocol.wire.clock import NS_PER_S

VOLTAGE_MAX_V = 1000.0
CURRENT_MAX_A = 1000.0
TEMPERATURE_MAX_C = 200.0


class BadBattery(ValueError):
    """A message that is not believed; says why."""


class BatteryMessage(Protocol):
    """sensor_msgs/BatteryState. What is not measured is NaN."""

    header: Header
    voltage: float
    current: float
    """Negative while discharging."""
    temperature: float


class ToldBattery(NamedTuple):
    """A measurement of the battery."""

    stamp_ns: int
    """By the clock of whoever stamped it; 0 if it has no stamp."""
    voltage_v: float
    current_a: float
    """Positive while discharging."""
    temperature_c: float
    has_current: bool
    """False if the current is the one that was given."""


def read_battery(message: BatteryMessage, current_a: float | None, temperature_c: float) -> ToldBattery:
    """The measurement in a message.

    Args:
        message: of the robot.
        current_a: used if the robot does not measure its current; None if it must.
        temperature_c: used if it does not measure its temperature.

    Raises:
        BadBattery: a number that is not in range, or no current.

    """
    if not 0.0 < message.voltage <= VOLTAGE_MAX_V:
        raise BadBattery(f"expected a voltage up to {VOLTAGE_MAX_V:g} V, got {message.voltage:g}")
    drawn_a = -message.current
    has_current = not math.isnan(drawn_a)
    if not has_current:
        if current_a is None:
            raise BadBattery("the robot does not measure its current: give current_a")
        drawn_a = current_a
    if not abs(drawn_a) <= CURRENT_MAX_A:
        raise BadBattery(f"expected a current up to {CURRENT_MAX_A:g} A, got {message.current:g}")
    measured_c = temperature_c if math.isnan(message.temperature) else message.temperature
    if not abs(measured_c) <= TEMPERATURE_MAX_C:
        raise BadBattery(f"expected a temperature up to {TEMPERATURE_MAX_C:g} °C, got {message.temperature:g}")
    stamp = message.header.stamp
    return ToldBattery(stamp.sec * NS_PER_S + stamp.nanosec, message.voltage, drawn_a, measured_c, has_current)
