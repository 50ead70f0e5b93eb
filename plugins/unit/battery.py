"""Battery: state of charge and remaining energy, with an interval, from checked measurements."""

from typing import Protocol

import msgspec

from robrain.agent.event import Event
from robrain.agent.plugin import Unit, external
from robrain.algorithms.energy.battery_report import NOTHING_MORE, BatteryReport
from robrain.algorithms.energy.battery_tracker import BatteryTracker, GaugeLimits, TrackedReading
from robrain.algorithms.energy.consumption import Drawn
from robrain.algorithms.energy.soc_filter import PackModel
from robrain.plugins.device.bm2.interface import BatteryMeasurement, Bm2Interface
from robrain.protocol.clock import to_seconds
from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.model.ranges import Share


class BatteryAlarm(msgspec.Struct, frozen=True):
    """An event of the battery for other plugins."""

    why: str
    soc: float
    remaining_j: float
    voltage_v: float


class BatteryInterface(Protocol):
    """Remaining energy, and power drawn."""

    low: Event[BatteryAlarm]
    cut_off: Event[BatteryAlarm]
    """The battery is at its end, or has cut the motors off."""
    implausible: Event[BatteryAlarm]
    """The measurements are no longer believed."""

    def state(self) -> BatteryState | None:
        """The estimated state of the battery; None before the first measurement."""

    def drawn(self) -> Drawn | None:
        """Energy drawn so far, as of the last measurement; None before the first."""


CHARGING_BELOW_A = -0.05


class Battery(Unit):
    """Estimates the remaining energy, and warns when it is low or unknown."""

    class Parameters(PackModel, frozen=True, kw_only=True, forbid_unknown_fields=True):
        """The pack's datasheet, warning levels, and limits of belief.

        Chosen; set those of your battery.
        """

        soc_at_start: Share | None = None
        """Estimated from the voltage if absent."""
        low_soc: Share = 0.25
        cut_off_soc: Share = 0.05
        hysteresis_soc: Share = 0.05
        """A warning is repeated only after the charge has been this far above its threshold."""
        gauge: GaugeLimits = GaugeLimits()

    low = Event[BatteryAlarm](outside=True)
    cut_off = Event[BatteryAlarm](outside=True)
    implausible = Event[BatteryAlarm](outside=True)

    interface = BatteryInterface
    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        self._tracker = BatteryTracker(self.parameters, self.parameters.gauge, self.parameters.soc_at_start)
        self._last: BatteryMeasurement | None = None
        self._reported_ns = self._received_ns = 0
        self._energy_j = 0.0
        self._drawn: Drawn | None = None
        self._is_low = self._is_cut_off = self._is_doubted = False

    def activate(self) -> None:
        self._bm2 = self.env.use("bm2", Bm2Interface)

    def step(self) -> None:
        measured, last, now_ns = self._bm2.latest() or self._last, self._last, self.env.clock.now_ns()
        if measured is None:
            return
        if last is None:
            self._tracker.begin(_values(measured), _report(measured))
            self._received_ns = now_ns
        elif measured.stamp_ns != last.stamp_ns:
            self._follow(last, measured)
            self._received_ns = now_ns
        else:
            # By the robot's own clock: that of the frames may be another one.
            self._tracker.no_reading(to_seconds(now_ns - self._received_ns), to_seconds(now_ns - self._reported_ns))
        self._reported_ns = now_ns
        self._last = measured
        self._publish(measured)

    @external
    def state(self) -> BatteryState | None:
        """Voltage, current, temperature, charge and remaining energy with its interval; null before the first."""
        return self.env.board.battery

    def drawn(self) -> Drawn | None:
        """Energy drawn so far, as of the last measurement; None before the first."""
        return self._drawn

    def _follow(self, last: BatteryMeasurement, measured: BatteryMeasurement) -> None:
        elapsed_s = to_seconds(measured.stamp_ns - last.stamp_ns)
        if elapsed_s <= 0:  # the clock of the frames was set back
            return
        charge_c, energy_j = measured.charge_c - last.charge_c, measured.energy_j - last.energy_j
        if measured.counted_from_ns != last.counted_from_ns:
            charge_c = measured.current_a * elapsed_s
            energy_j = measured.voltage_v * charge_c
        self._energy_j += energy_j
        self._tracker.follow(_values(measured), charge_c, elapsed_s, _report(measured))

    def _publish(self, measured: BatteryMeasurement) -> None:
        believed = self._tracker.filter
        reason, soc = self._tracker.doubt_reason, believed.soc
        charging = measured.current_a < CHARGING_BELOW_A
        remaining_j, low_j, high_j = believed.interval_j()
        self.env.board.battery = BatteryState(
            voltage_v=measured.voltage_v,
            current_a=measured.current_a,
            temperature_c=measured.temperature_c,
            # More digits would exceed the accuracy.
            soc=round(soc, 5),
            remaining_j=round(remaining_j, 1),
            remaining_low_j=round(low_j, 1),
            remaining_high_j=round(high_j, 1),
            soc_sd=round(believed.soc_sd, 5),
            health=round(believed.health, 4),
            charging=charging and not reason,
            implausible=reason,
        )
        # A guessed value teaches nothing about the cost of work.
        report = measured.report
        is_own = not reason and measured.current_a > 0 and (isinstance(report, msgspec.UnsetType) or report.has_current)
        self._drawn = Drawn(measured.stamp_ns, self._energy_j, is_own)
        self._warn(reason, soc, remaining_j, measured.voltage_v)

    def _warn(self, reason: str, soc: float, remaining_j: float, voltage_v: float) -> None:
        parameters = self.parameters
        if reason and not self._is_doubted:
            self.implausible.notify(BatteryAlarm(reason, soc, remaining_j, voltage_v))
        self._is_doubted = bool(reason)
        if soc <= parameters.low_soc and not self._is_low:
            self._is_low = True
            low_reason = f"{100 * soc:.0f} % left, low is {100 * parameters.low_soc:g} %"
            self.low.notify(BatteryAlarm(low_reason, soc, remaining_j, voltage_v))
        elif soc > parameters.low_soc + parameters.hysteresis_soc:
            self._is_low = False
        is_under = not reason and voltage_v < parameters.cut_off_v
        if (soc <= parameters.cut_off_soc or is_under) and not self._is_cut_off:
            self._is_cut_off = True
            off_reason = f"{voltage_v:.2f} V and {100 * soc:.0f} % left"
            self.cut_off.notify(BatteryAlarm(off_reason, soc, remaining_j, voltage_v))
        elif soc > parameters.cut_off_soc + parameters.hysteresis_soc and not is_under:
            self._is_cut_off = False


def _values(measured: BatteryMeasurement) -> TrackedReading:
    return TrackedReading(measured.voltage_v, measured.current_a, measured.temperature_c)


def _report(measured: BatteryMeasurement) -> BatteryReport:
    return NOTHING_MORE if isinstance(measured.report, msgspec.UnsetType) else measured.report
