"""Interface of the battery manager, and the common part of its devices."""

from typing import NamedTuple, Protocol

import msgspec

from robrain.agent.plugin import Device, external, unlocked
from robrain.algorithms.energy.battery_report import BatteryReport
from robrain.protocol.clock import NS_PER_S

ASSUMED_C = 25.0
"""Temperature of a battery that does not measure it."""


class BatteryMeasurement(msgspec.Struct, frozen=True):
    """One frame of the battery manager. Current is positive while discharging."""

    stamp_ns: int
    voltage_v: float
    current_a: float
    temperature_c: float
    charge_c: float = 0.0
    """Charge drawn since `counted_from_ns`. Users that poll less often than frames arrive lose nothing."""
    energy_j: float = 0.0
    """The same for energy at the terminals."""
    counted_from_ns: int = 0
    """Stamp of the first frame; another one means that the count started again."""
    report: BatteryReport | msgspec.UnsetType = msgspec.UNSET
    """The battery's report of its charge, and whether its current is measured. It is unset if the current is measured
    and the battery reports no charge."""


class Bm2Interface(Protocol):
    """Measurements of the battery."""

    def latest(self) -> BatteryMeasurement | None:
        """The last measurement; None before the first."""


VOLTAGE_MAX_V = 1000.0
CURRENT_MAX_A = 1000.0
COLDEST_C, HOTTEST_C = -60.0, 120.0
"""Of batteries that report a temperature; beyond it the sensor is broken or absent (chosen)."""


class BadReading(ValueError):
    """Values from which there is no measurement."""


class Reading(NamedTuple):
    """Values read from a battery."""

    voltage_v: float
    current_a: float
    """Positive while discharging."""
    temperature_c: float = ASSUMED_C
    report: BatteryReport | msgspec.UnsetType = msgspec.UNSET


def plausible(
    voltage_v: float,
    current_a: float | None,
    temperature_c: float | None = None,
    soc: float | None = None,
    *,
    assumed_a: float | None = None,
    assumed_c: float = ASSUMED_C,
    soc_sd: float | None = None,
    is_charging: bool | None = None,
) -> Reading:
    """The measurement in the values of a battery; None and NaN are values that it does not measure.

    Args:
        voltage_v: must be plausible.
        current_a: positive while discharging.
        temperature_c: of the battery.
        soc: state of charge that the battery reports, 0 to 1.
        assumed_a: stands for the current; None if there must be one.
        assumed_c: stands for the temperature.
        soc_sd: standard deviation of `soc`; None for a battery that never reports it.
        is_charging: the battery's status, which decides the sign of the current; None without one.

    Raises:
        BadReading: naming the value and the expected range.

    """
    if not 0.0 < voltage_v <= VOLTAGE_MAX_V:
        raise BadReading(f"expected a voltage up to {VOLTAGE_MAX_V:g} V, got {voltage_v:g}")
    has_current = current_a is not None and abs(current_a) <= CURRENT_MAX_A
    drawn_a = current_a if has_current else assumed_a
    if drawn_a is None:
        got = "none" if current_a is None else f"{current_a:g}"
        raise BadReading(f"expected a current up to {CURRENT_MAX_A:g} A, got {got}: give current_a if none is measured")
    if is_charging is not None:
        drawn_a = -abs(drawn_a) if is_charging else abs(drawn_a)
    has_temperature = temperature_c is not None and COLDEST_C <= temperature_c <= HOTTEST_C
    report: BatteryReport | msgspec.UnsetType = msgspec.UNSET
    if soc_sd is not None:
        believed = soc if soc is not None and 0.0 <= soc <= 1.0 else None
        report = BatteryReport(has_current=has_current, soc=believed, soc_sd=soc_sd)
    elif not has_current:
        report = BatteryReport(has_current=False)
    return Reading(voltage_v, drawn_a, temperature_c if has_temperature else assumed_c, report)  # type: ignore[arg-type]


class BatteryDevice(Device):
    """Common part of all batteries: integrates charge and energy."""

    interface = Bm2Interface
    period_s = 0.2
    gap_s = 2.0
    """A longer time between two measurements is not counted, because the charge drawn meanwhile is unknown."""
    _latest: BatteryMeasurement | None = None

    def count(self, reading: Reading, stamp_ns: int) -> None:
        """Add a measurement: it is the mean of the time since the one before."""
        voltage_v, current_a, temperature_c, report = reading
        before, charge_c, energy_j, from_ns = self._latest, 0.0, 0.0, stamp_ns
        if before is not None:
            elapsed_s = (stamp_ns - before.stamp_ns) / NS_PER_S
            counted_s = elapsed_s if 0 < elapsed_s <= self.gap_s else 0.0
            charge_c = before.charge_c + current_a * counted_s
            energy_j = before.energy_j + voltage_v * current_a * counted_s
            from_ns = before.counted_from_ns
        self._latest = BatteryMeasurement(
            stamp_ns, voltage_v, current_a, temperature_c, charge_c, energy_j, from_ns, report
        )

    @external
    @unlocked
    def latest(self) -> BatteryMeasurement | None:
        """The last measurement; null before the first."""
        return self._latest
