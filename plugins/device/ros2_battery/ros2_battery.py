"""The battery of a ROS 2 robot, with the interface of the stock battery manager."""

import math

import msgspec
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import BatteryState

from robrain.agent.plugin import Device, external, unlocked
from robrain.plugins.device.bm2.counting import counted
from robrain.plugins.device.bm2.interface import BatteryMeasurement, Bm2Interface
from robrain.plugins.device.ros2.link import Ros2Link, Subscription, open_link
from robrain.plugins.device.ros2.parameters import Ros2Parameters, check_topics
from robrain.plugins.device.ros2.stamp_clock import StampClock
from robrain.plugins.device.ros2_battery.battery_message import BadBattery, BatteryMessage, read_battery
from robrain.protocol.model.energy.battery_report import BatteryReport
from robrain.protocol.model.ranges import check_positive


class Ros2Battery(Device):
    """Reads a ROS 2 robot's battery, and integrates charge and energy."""

    class Parameters(Ros2Parameters, frozen=True, kw_only=True, forbid_unknown_fields=True):
        """Topic, and what stands for what the robot does not measure."""

        battery: str = "battery_state"
        """Topic of the measurements, sensor_msgs/BatteryState."""
        current_a: float | None = None
        """Current of a robot that does not measure it, positive while discharging."""
        temperature_c: float = 25.0
        """Temperature of a battery that does not measure it."""
        gap_s: float = 5.0
        """A longer time between two measurements is not counted."""

        def __post_init__(self) -> None:
            super().__post_init__()
            check_topics(self, "battery")
            check_positive(self, "gap_s")
            if not math.isfinite(self.current_a or 0.0) or not math.isfinite(self.temperature_c):
                raise ValueError("expected current_a and temperature_c to be finite")

    interface = Bm2Interface
    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        self._link: Ros2Link | None = None
        self._inbox: Subscription[BatteryMessage] | None = None
        self._latest: BatteryMeasurement | None = None
        self._rejected = 0
        self._why_rejected = ""

    def activate(self) -> None:
        wanted = self.parameters
        self._clock = StampClock()
        self._link = open_link(self.env, wanted)
        topic = wanted.topic(wanted.battery)
        self._inbox = self._link.subscribe(BatteryState, topic, qos_profile_sensor_data, self.env.hurry)

    def step(self) -> None:
        wanted = self.parameters
        for arrived in self._inbox.drain() if self._inbox is not None else ():
            try:
                told = read_battery(arrived.message, wanted.current_a, wanted.temperature_c)
            except BadBattery as error:
                self._rejected += 1
                self._why_rejected = str(error)
                continue
            stamp_ns = self._clock.measured_ns(told.stamp_ns, arrived.arrived_ns)
            volts, amps, celsius = told.voltage_v, told.current_a, told.temperature_c
            report = msgspec.UNSET if told.has_current else BatteryReport(has_current=False)
            self._latest = counted(self._latest, stamp_ns, volts, amps, celsius, report, gap_s=wanted.gap_s)

    def deactivate(self) -> None:
        link, self._link = self._link, None
        if self._inbox is not None:
            self._inbox.close()
            self._inbox = None
        if link is not None:
            link.release()

    @external
    @unlocked
    def latest(self) -> BatteryMeasurement | None:
        """The last measurement; null before the first."""
        return self._latest

    @external
    def rejected(self) -> int:
        """Messages that were rejected: numbers out of range, or no current."""
        return self._rejected

    @external
    def why_rejected(self) -> str:
        """Why the last of them was; empty if none was."""
        return self._why_rejected
