"""What the battery manager offers."""

from typing import Protocol

import msgspec


class BatteryMeasurement(msgspec.Struct, frozen=True):
    """One frame of the battery manager. Current is positive while discharging."""

    stamp_ns: int
    voltage_v: float
    current_a: float
    temperature_c: float


class Bm2Interface(Protocol):
    """Measurements of the battery."""

    def latest(self) -> BatteryMeasurement | None:
        """The last measurement; None before the first."""
