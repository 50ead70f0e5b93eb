"""Charge and energy drawn, added up from one measurement to the next."""

import msgspec

from robrain.plugins.device.bm2.interface import BatteryMeasurement
from robrain.protocol.model.energy.battery_report import BatteryReport
from robrain.protocol.wire.clock import NS_PER_S


def counted(
    before: BatteryMeasurement | None,
    stamp_ns: int,
    voltage_v: float,
    current_a: float,
    temperature_c: float,
    report: BatteryReport | msgspec.UnsetType = msgspec.UNSET,
    *,
    gap_s: float,
) -> BatteryMeasurement:
    """A measurement with what was drawn until then: it is the mean of the time since the one before.

    A time longer than `gap_s` is not counted, because nobody knows what was drawn meanwhile.
    """
    charge_c, energy_j, from_ns = 0.0, 0.0, stamp_ns
    if before is not None:
        elapsed_s = (stamp_ns - before.stamp_ns) / NS_PER_S
        counted_s = elapsed_s if 0 < elapsed_s <= gap_s else 0.0
        charge_c = before.charge_c + current_a * counted_s
        energy_j = before.energy_j + voltage_v * current_a * counted_s
        from_ns = before.counted_from_ns
    return BatteryMeasurement(stamp_ns, voltage_v, current_a, temperature_c, charge_c, energy_j, from_ns, report)
