"""The battery manager: a node on the robot's CAN bus that measures the battery and cuts the motors off when it must."""

import math
from collections.abc import Callable

import can
import numpy as np

from robrain.protocol.can.frame_port import frame_port
from robrain.protocol.can.frames import codec
from robrain.sim.firmware.battery import GaugeSpec, SimulatedBattery
from robrain.sim.firmware.power_model import PowerModel

STATUS_PERIOD_S = 0.2

Reading = tuple[float, float, float]
"""Volts, amperes, degrees Celsius."""


class Gauge:
    """Measures with offsets that are drawn once, and with noise.

    Args:
        spec: how wrongly.
        rng: of this robot's gauge alone.

    """

    def __init__(self, spec: GaugeSpec, rng: np.random.Generator) -> None:
        self._spec = spec
        self._rng = rng
        offset_v, offset_a, gain = rng.standard_normal(3)
        self._offset_v = spec.voltage_offset_v * offset_v
        self._offset_a = spec.current_offset_a * offset_a
        self._gain = 1.0 + spec.current_gain * gain

    def read(self, voltage_v: float, current_a: float, temperature_c: float) -> Reading:
        """What it makes of the true values."""
        spec = self._spec
        noise_v, noise_a, noise_c = self._rng.standard_normal(3).tolist()
        return (
            _stepped(voltage_v + self._offset_v + spec.voltage_noise_v * noise_v, spec.voltage_step_v),
            _stepped(self._gain * current_a + self._offset_a + spec.current_noise_a * noise_a, spec.current_step_a),
            temperature_c + spec.temperature_noise_c * noise_c,
        )


class BatteryManager:
    """Adds up what the robot draws and reports the battery at 5 Hz; on its own reserve when the battery has cut off.

    Args:
        bus: the robot's bus.
        battery: what it manages.
        power: what the robot draws by what it does.
        mass_kg: of the robot without payload.
        tick_s: how long a tick is.
        rng: of the gauge's errors and of the computer's bursts.

    """

    def __init__(
        self,
        bus: can.BusABC,
        battery: SimulatedBattery,
        power: PowerModel,
        mass_kg: float,
        tick_s: float,
        rng: np.random.Generator,
    ) -> None:
        self.battery = battery
        self.supply_w = 0.0
        """What a charger gives now."""
        self.lie: Callable[[Reading], Reading] | None = None
        """A fault of the gauge: what it tells in place of what it reads."""
        self.load = Load(power, mass_kg, rng)
        """What the robot has drawn since the last status."""
        self._port = frame_port(bus)
        self._gauge = Gauge(battery.spec.gauge, rng)
        self._tick_s = tick_s
        self.period_ticks = max(1, round(STATUS_PERIOD_S / tick_s))
        self._period_s = self.period_ticks * tick_s
        self._codec = codec("BatteryStatus")
        self._tick = 0
        self._sent = 0

    def report(self, speed_m_s: float, yaw_rate_rad_s: float) -> None:
        """Account for a tick of this motion; at 5 Hz, load the battery with its share and send the status."""
        self.load.move(speed_m_s, yaw_rate_rad_s, self._tick_s)
        self._tick += 1
        if self._tick % self.period_ticks == 0:
            self.measure()

    def measure(self) -> None:
        """Load the battery with what was drawn in the period that ends now, and send the status."""
        battery, period_s = self.battery, self._period_s
        battery.step(self.load.mean_power_w(period_s), self.supply_w, period_s)
        reading = self._gauge.read(battery.voltage_v, battery.current_a, battery.temperature_c)
        if self.lie is not None:
            reading = self.lie(reading)
        voltage_v, current_a, temperature_c = reading
        self._port.send_data(
            self._codec.arbitration_id, self._codec.encode(self._sent, voltage_v, current_a, temperature_c)
        )
        self._sent += 1


class Load:
    """What the robot draws: its motion tick by tick, and a computer that has bursts of work.

    Args:
        power: terms of the robot's power.
        mass_kg: of the robot without payload.
        rng: says when bursts come.

    """

    def __init__(self, power: PowerModel, mass_kg: float, rng: np.random.Generator) -> None:
        self.motion_j = 0.0
        """Energy of its motion since `mean_power_w`."""
        self._power = power
        self._mass_kg = mass_kg
        self._rng = rng
        self._bursting = False
        self._speed_m_s = 0.0

    def move(self, speed_m_s: float, yaw_rate_rad_s: float, duration_s: float) -> None:
        """Account for some time of this motion."""
        if speed_m_s or yaw_rate_rad_s:
            self.motion_j += self._power.motion_w(speed_m_s, yaw_rate_rad_s, self._mass_kg) * duration_s
        if speed_m_s > self._speed_m_s:
            self.motion_j += self._power.acceleration_j(self._mass_kg, self._speed_m_s, speed_m_s)
        self._speed_m_s = speed_m_s

    def row(self) -> tuple[float, ...]:
        """Its terms as a row of `LOAD`, for a robot whose motion is accounted for together with others'."""
        power = self._power
        return (
            self._mass_kg,
            power.payload_kg,
            power.moving_w,
            power.speed_w_per_m_s,
            power.speed2_w_per_m2_s2,
            power.yaw_w_per_rad_s,
            power.drive_efficiency,
            self._speed_m_s,
            self.motion_j,
        )

    def mean_power_w(self, period_s: float) -> float:
        """Mean power of the period that ends now."""
        power = self._power
        if power.burst_w:
            mean_s = power.burst_s if self._bursting else power.between_bursts_s
            if self._rng.random() < 1.0 - math.exp(-period_s / mean_s):
                self._bursting = not self._bursting
        load_w = power.standing_w(bursting=self._bursting) + self.motion_j / period_s
        self.motion_j = 0.0
        return load_w


def _stepped(value: float, step: float) -> float:
    return step * round(value / step) if step > 0 else value
