"""A battery model with more detail than the robots' model: four lithium-ion cells in series.

- Two wells of charge (KiBaM): Manwell & McGowan, Lead acid battery storage model for hybrid energy systems, Solar
  Energy 50 (1993). Bound charge follows available charge only slowly: high loads get less, a rest restores some.
- Open-circuit voltage over the *available* charge: the curve of Chen & Rincón-Mora, Accurate electrical battery
  model, IEEE Transactions on Energy Conversion 21 (2006), times four.
- A resistance and one RC pair (Thevenin's circuit, same paper), and a one-state hysteresis. Source of the hysteresis:
  Plett, Extended Kalman filtering for battery management systems, part 2, Journal of Power Sources 134, 2004.
- Resistance and the flow between the wells follow the temperature (Arrhenius), which the battery's own losses raise.
- Age: less capacity, more resistance.

The curve is published; the other figures are chosen for a pack of this size, not measured on one.
"""

import math
from collections.abc import Callable
from typing import Annotated

import can
import numpy as np
from msgspec import Meta

from robrain.protocol.can.frame_port import frame_port
from robrain.protocol.can.frames import codec
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import NotNegative, Positive, Share
from robrain.sim.firmware.power_model import PowerModel

J_PER_WH = 3600.0
CELLS = 4
NOMINAL_V = 15.22
"""Mean of the open-circuit voltage over the charge: factor from ampere hours to watt hours."""
REFERENCE_C = 25.0
KELVIN = 273.15
ACTIVATION_K = 2500.0
"""Activation energy over the gas constant, for resistance and diffusion: twice the resistance at about 0 °C."""
CUT_OFF_AFTER_S = 1.0
"""Time below the cut-off voltage before the protection trips, so that no peak of the motors trips it."""
BACK_AT_SOC = 0.05
"""A battery that has cut off gives power again from this charge on."""
TAPER = 0.05
"""Charging has ended when the current at full voltage is this share of the capacity per hour."""


class GaugeSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Measurement errors of the battery manager. Raises ValueError where it is built with a negative one."""

    voltage_noise_v: NotNegative = 0.008
    voltage_offset_v: NotNegative = 0.005
    """Standard deviation; drawn once for each robot, like the other offsets."""
    voltage_step_v: NotNegative = 0.004
    """Step of its analogue-to-digital converter: 12 bits over 16.4 V."""
    current_noise_a: NotNegative = 0.01
    current_offset_a: NotNegative = 0.003
    current_gain: NotNegative = 0.005
    """Standard deviation of the relative error of the shunt."""
    current_step_a: NotNegative = 0.002
    temperature_noise_c: NotNegative = 0.2


class BatterySpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[robot.battery]`: a pack of four lithium-ion cells. Raises ValueError for impossible values."""

    capacity_wh: Positive = 20.0
    """Rated capacity when new: at the cells, from full to empty, discharged very slowly."""
    soc_at_start: Share = 1.0
    capacity_fade: Annotated[float, Meta(ge=0, lt=1)] = 0.0
    """Share of the rated capacity lost by age."""
    resistance_growth: NotNegative = 0.0
    """Share by which the resistances have grown by age."""
    resistance_ohm: Positive = 0.10
    """At 25 °C, when new."""
    relaxation_ohm: Positive = 0.04
    relaxation_s: Positive = 30.0
    """Time constant of the RC pair."""
    available_share: Annotated[float, Meta(gt=0, lt=1)] = 0.9
    """Share of the charge in the well that the load draws from: KiBaM's c."""
    flow_per_s: Positive = 1.0 / 600.0
    """Rate at which the wells level out at 25 °C: KiBaM's k′."""
    hysteresis_v: NotNegative = 0.008
    """Half the distance between the curves of charging and discharging."""
    curve_shift_v: float = 0.0
    """Offset of this pack's curve from the published one."""
    ambient_c: float = 22.0
    heat_capacity_j_per_k: Positive = 400.0
    heat_loss_w_per_k: NotNegative = 0.3
    cut_off_v: Positive = 12.0
    """Voltage at the terminals below which the protection opens."""
    charge_v: float = 16.4
    """Voltage at the terminals at which the charger holds (constant voltage)."""
    charge_a: Positive = 1.5
    """Greatest charging current (constant current)."""
    gauge: GaugeSpec = GaugeSpec()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.cut_off_v < self.charge_v < math.inf:
            raise ValueError(f"expected charge_v above cut_off_v, got {self.charge_v} and {self.cut_off_v}")


class SimulatedBattery:
    """State of one battery, advanced by `step`."""

    def __init__(self, spec: BatterySpec) -> None:
        self.spec = spec
        self.capacity_c = spec.capacity_wh * J_PER_WH / NOMINAL_V * (1.0 - spec.capacity_fade)
        """Charge between full and empty, at its age."""
        share = spec.available_share
        self._available_c = share * spec.soc_at_start * self.capacity_c
        self._bound_c = (1.0 - share) * spec.soc_at_start * self.capacity_c
        self._relaxation_v = 0.0
        self._hysteresis = 0.0
        self._below_s = 0.0
        self.current_a = 0.0
        """Positive while discharging."""
        self.voltage_v = self._open_v()
        """At the terminals."""
        self.temperature_c = spec.ambient_c
        self.delivered_j = 0.0
        """Energy that the load has drawn from the terminals so far; charging does not reduce it."""
        self.is_cut_off = spec.soc_at_start <= 0.0
        """The protection is open: the load gets nothing."""

    @property
    def soc(self) -> float:
        """State of charge: both wells over the capacity at this age, 0 to 1."""
        return (self._available_c + self._bound_c) / self.capacity_c

    def drain(self, soc: float) -> None:
        """Lose charge at once, down to a state of charge from 0 to 1; a battery that has less keeps it."""
        share = min(1.0, soc / max(self.soc, 1e-9))
        self._available_c *= share
        self._bound_c *= share

    def step(self, load_w: float, supply_w: float, duration_s: float) -> None:
        """Feed a constant load for a while, with the help of a charger that gives up to `supply_w`."""
        spec = self.spec
        warmth = math.exp(ACTIVATION_K * (1.0 / (self.temperature_c + KELVIN) - 1.0 / (REFERENCE_C + KELVIN)))
        growth = (1.0 + spec.resistance_growth) * warmth
        resistance_ohm, relaxation_ohm = spec.resistance_ohm * growth, spec.relaxation_ohm * growth
        behind_v = self._open_v() - self._relaxation_v
        if self.is_cut_off:
            load_w = 0.0
        lacking_w = load_w - supply_w
        if lacking_w > 0:
            # P = (E - I·R)·I; the smaller root is the working point. Past E²/4R the load pulls the voltage down to E/2.
            room = max(0.0, behind_v * behind_v - 4.0 * resistance_ohm * lacking_w)
            current_a = (behind_v - math.sqrt(room)) / (2.0 * resistance_ohm)
            self.delivered_j += (behind_v - current_a * resistance_ohm) * current_a * duration_s
        else:
            room_c = max(0.0, self.capacity_c - self._available_c - self._bound_c)
            current_a = -min(self._charging_a(-lacking_w, behind_v, resistance_ohm), room_c / duration_s)
        self.delivered_j += min(load_w, supply_w) * duration_s
        self.current_a = current_a
        self.voltage_v = behind_v - current_a * resistance_ohm

        self._flow(current_a, duration_s, spec.flow_per_s / warmth)
        decay = math.exp(-duration_s / spec.relaxation_s)
        self._relaxation_v = decay * self._relaxation_v + (1.0 - decay) * current_a * relaxation_ohm
        turned = math.exp(-HYSTERESIS_RATE * abs(current_a) * duration_s / self.capacity_c)
        self._hysteresis = turned * self._hysteresis - (1.0 - turned) * math.copysign(1.0, current_a)
        loss_w = current_a * (current_a * resistance_ohm + self._relaxation_v)
        cooling_w = spec.heat_loss_w_per_k * (self.temperature_c - spec.ambient_c)
        self.temperature_c += (loss_w - cooling_w) * duration_s / spec.heat_capacity_j_per_k
        self._protect(duration_s)

    def _open_v(self) -> float:
        available = self._available_c / (self.spec.available_share * self.capacity_c)
        return open_circuit_v(available) + self.spec.curve_shift_v + self.spec.hysteresis_v * self._hysteresis

    def _charging_a(self, power_w: float, behind_v: float, resistance_ohm: float) -> float:
        spec = self.spec
        room = math.sqrt(behind_v * behind_v + 4.0 * resistance_ohm * power_w)
        by_power_a = (room - behind_v) / (2.0 * resistance_ohm)
        by_voltage_a = max(0.0, (spec.charge_v - behind_v) / resistance_ohm)
        if by_voltage_a < TAPER * self.capacity_c / 3600.0:
            return 0.0
        return min(by_power_a, by_voltage_a, spec.charge_a)

    def _flow(self, current_a: float, duration_s: float, rate_per_s: float) -> None:
        # Manwell & McGowan's solution for a constant current, with q0 = available + bound.
        share, grown = self.spec.available_share, rate_per_s * duration_s
        left = math.exp(-grown)
        total_c = self._available_c + self._bound_c
        available_c = self._available_c * left
        available_c += (total_c * rate_per_s * share - current_a) * (1.0 - left) / rate_per_s
        available_c -= current_a * share * (grown - 1.0 + left) / rate_per_s
        self._available_c = max(0.0, available_c)
        self._bound_c = max(0.0, total_c - current_a * duration_s - available_c)

    def _protect(self, duration_s: float) -> None:
        if self.is_cut_off:
            self.is_cut_off = self.current_a >= 0 or self.soc < BACK_AT_SOC
            return
        self._below_s = self._below_s + duration_s if self.voltage_v < self.spec.cut_off_v else 0.0
        if self._below_s >= CUT_OFF_AFTER_S or self._available_c <= 0:
            self.is_cut_off = True
            self._below_s = 0.0


HYSTERESIS_RATE = 50.0
"""Two per cent of the capacity turn most of the hysteresis over."""


def open_circuit_v(available: float) -> float:
    """Voltage of the pack at rest over the share of the charge that is available; a little beyond 0 and 1 as well.

    >>> round(open_circuit_v(1.0), 2)
    16.41
    """
    cell_v = 3.685 - 1.031 * math.exp(-35.0 * available)
    cell_v += available * (0.2156 + available * (-0.1178 + available * 0.3201))
    return CELLS * cell_v


STATUS_PERIOD_S = 0.2

Reading = tuple[float, float, float]
"""Volts, amperes, degrees Celsius."""


class Gauge:
    """Measures with offsets that are drawn once, and with noise.

    Args:
        spec: errors of the gauge.
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
        """Measured values for the true values."""
        spec = self._spec
        noise_v, noise_a, noise_c = self._rng.standard_normal(3).tolist()
        return (
            _stepped(voltage_v + self._offset_v + spec.voltage_noise_v * noise_v, spec.voltage_step_v),
            _stepped(self._gain * current_a + self._offset_a + spec.current_noise_a * noise_a, spec.current_step_a),
            temperature_c + spec.temperature_noise_c * noise_c,
        )


class BatteryManager:
    """Adds up the robot's draw and reports the battery at 5 Hz; from a separate reserve when the battery has cut off.

    Args:
        bus: the robot's bus.
        battery: what it manages.
        power: power draw of the robot by activity.
        tick_s: length of a tick.
        rng: of the gauge's errors and of the computer's bursts.

    """

    def __init__(
        self,
        bus: can.BusABC,
        battery: SimulatedBattery,
        power: PowerModel,
        tick_s: float,
        rng: np.random.Generator,
    ) -> None:
        self.battery = battery
        self.supply_w = 0.0
        """Current power of a charger."""
        self.lie: Callable[[Reading], Reading] | None = None
        """A fault of the gauge: the value that it reports in place of the measured one."""
        self.load = Load(power, rng)
        self._port = frame_port(bus)
        self._gauge = Gauge(battery.spec.gauge, rng)
        self.period_ticks = max(1, round(STATUS_PERIOD_S / tick_s))
        self._period_s = self.period_ticks * tick_s
        self._codec = codec("BatteryStatus")
        self._sent = 0

    def measure(self, motion_j: float) -> None:
        """Load the battery with the draw of the period that ends now, and send the status.

        Args:
            motion_j: energy of the robot's motion in the period.

        """
        battery, period_s = self.battery, self._period_s
        battery.step(self.load.mean_power_w(motion_j, period_s), self.supply_w, period_s)
        reading = self._gauge.read(battery.voltage_v, battery.current_a, battery.temperature_c)
        if self.lie is not None:
            reading = self.lie(reading)
        voltage_v, current_a, temperature_c = reading
        self._port.send_data(
            self._codec.arbitration_id, self._codec.encode(self._sent, voltage_v, current_a, temperature_c)
        )
        self._sent += 1


class Load:
    """Power draw of the robot: its motion, and a computer that has bursts of work.

    Args:
        power: terms of the robot's power.
        rng: gives the times of bursts.

    """

    def __init__(self, power: PowerModel, rng: np.random.Generator) -> None:
        self._power = power
        self._rng = rng
        self._bursting = False

    def mean_power_w(self, motion_j: float, period_s: float) -> float:
        """Mean power of the period that ends now, with this energy of motion."""
        power = self._power
        if power.burst_w:
            mean_s = power.burst_s if self._bursting else power.between_bursts_s
            if self._rng.random() < 1.0 - math.exp(-period_s / mean_s):
                self._bursting = not self._bursting
        return power.idle_total_w(bursting=self._bursting) + motion_j / period_s


def _stepped(value: float, step: float) -> float:
    return step * round(value / step) if step > 0 else value
