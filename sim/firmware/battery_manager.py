"""The battery manager: a node on the robot's CAN bus that measures the battery and cuts the motors off when empty."""

import can

from robrain.protocol.can.frames import codec
from robrain.sim.firmware.battery import Battery
from robrain.sim.firmware.power_model import PowerModel

STATUS_PERIOD_S = 0.2


class BatteryManager:
    """Adds up what the robot draws and reports the battery at 5 Hz; on its own reserve when the battery is empty.

    Args:
        bus: the robot's bus.
        battery: what it manages.
        power: what the robot draws by what it does.
        mass_kg: of the robot, for the energy of speeding up.
        tick_s: how long a tick is.

    """

    def __init__(self, bus: can.BusABC, battery: Battery, power: PowerModel, mass_kg: float, tick_s: float) -> None:
        self.battery = battery
        self._bus = bus
        self._power = power
        self._mass_kg = mass_kg
        self._tick_s = tick_s
        self._period_ticks = max(1, round(STATUS_PERIOD_S / tick_s))
        self._codec = codec("BatteryStatus")
        self._tick = 0
        self._sent = 0
        self._speed_m_s = 0.0
        self._motion_j = 0.0

    def report(self, speed_m_s: float, yaw_rate_rad_s: float) -> None:
        """Account for a tick of this motion; at 5 Hz, load the battery with its share and send the status."""
        self._motion_j += self._power.motion_w(speed_m_s, yaw_rate_rad_s) * self._tick_s
        self._motion_j += self._power.acceleration_j(self._mass_kg, self._speed_m_s, speed_m_s)
        self._speed_m_s = speed_m_s
        self._tick += 1
        if self._tick % self._period_ticks:
            return
        period_s = self._period_ticks * self._tick_s
        self.battery.draw(self._power.idle_w + self._power.compute_w + self._motion_j / period_s, period_s)
        self._motion_j = 0.0
        self._bus.send(
            self._codec.pack(
                self._sent,
                voltage_v=self.battery.voltage_v,
                current_a=self.battery.current_a,
                temperature_c=self.battery.temperature_c,
            )
        )
        self._sent += 1
