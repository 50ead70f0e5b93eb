"""What the battery manager offers."""

from typing import Protocol

import msgspec

from robrain.algorithms.energy.battery_report import BatteryReport

ASSUMED_C = 25.0
"""Temperature of a battery that does not measure it."""


class BatteryMeasurement(msgspec.Struct, frozen=True):
    """One frame of the battery manager. Current is positive while discharging."""

    stamp_ns: int
    voltage_v: float
    current_a: float
    temperature_c: float
    charge_c: float = 0.0
    """Charge drawn since `counted_from_ns`: nothing is lost to whoever looks less often than frames come."""
    energy_j: float = 0.0
    """The same for energy at the terminals."""
    counted_from_ns: int = 0
    """Stamp of the first frame; another one means that the count started again."""
    report: BatteryReport | msgspec.UnsetType = msgspec.UNSET
    """What the battery says of its charge, and whether its current is measured; unset if it is, and it says nothing."""


class Bm2Interface(Protocol):
    """Measurements of the battery."""

    def latest(self) -> BatteryMeasurement | None:
        """The last measurement; None before the first."""
