"""A battery that Linux knows: the files below /sys/class/power_supply (power_supply_class.rst of the kernel).

The battery of a laptop, of a UPS board or of a phone that drives a robot; also one of which only the voltage is known.
"""

import errno
import math
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.plugins.device.bm2.interface import ASSUMED_C
from robrain.plugins.device.bm2.polled_battery import BadReading, PolledBattery, Reading
from robrain.protocol.model.energy.battery_report import BatteryReport
from robrain.protocol.model.ranges import check_positive

VALUE_BYTES_MAX = 64
"""Longer values than this are none."""
MICRO = 1e-6
NO_VALUE = (errno.ENODATA, errno.EINVAL, errno.EOPNOTSUPP)
"""What drivers answer for a file that is there and has no value at the moment."""
CHARGING, DISCHARGING = "Charging", "Discharging"


class PowerSupply(PolledBattery):
    """Reads a battery of the kernel's power supply class."""

    class Parameters(PolledBattery.Parameters, msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """Which battery, and what is taken for measured where it is not."""

        name: Annotated[str, Meta(max_length=64, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.:-]*$|^$")] = ""
        """Of the folder, such as `BAT0`; empty: the first battery that supplies the computer."""
        folder: Annotated[str, Meta(min_length=1, max_length=4096)] = "/sys/class/power_supply"
        current_a: float = 1.0
        """Taken as drawn, or as charging, if the battery does not report its current."""
        soc_sd: float = 0.05
        """Standard deviation of the state of charge that the kernel reports."""
        believes_soc: bool = True
        """Whether to use it: some drivers only guess it from the voltage, which the estimate does better."""

        def __post_init__(self) -> None:
            super().__post_init__()
            check_positive(self, "soc_sd", below=1.0)
            if not 0 <= self.current_a < math.inf:
                raise ValueError(f"expected a finite current_a >= 0, got {self.current_a}")

    parameters: Parameters

    def init(self) -> None:
        super().init()
        self._folder: Path | None = None
        self.where = f"{self.parameters.folder}/{self.parameters.name}"

    def open(self) -> None:
        folder, name = Path(self.parameters.folder), self.parameters.name
        if name:
            self._folder = folder / name
            return
        for each in sorted(folder.iterdir()):
            if _text(each / "type") == "Battery" and _text(each / "scope") != "Device":  # of a mouse, or the like
                self._folder = each
                self.where = str(each)
                return
        raise FileNotFoundError(f"no battery in {folder}")

    def close(self) -> None:
        self._folder = None

    def read(self) -> Reading:
        folder, wanted = self._folder, self.parameters
        assert folder is not None
        if _text(folder / "present") == "0":
            raise FileNotFoundError("no battery is inserted")
        voltage_uv = _number(folder / "voltage_now")
        if voltage_uv is None:
            raise FileNotFoundError(f"{folder} has no voltage_now")
        voltage_v, status = MICRO * voltage_uv, _text(folder / "status")
        current_ua, power_uw = _number(folder / "current_now"), _number(folder / "power_now")
        measured_a = MICRO * current_ua if current_ua is not None else None
        if measured_a is None and power_uw is not None and voltage_v > 0:
            measured_a = MICRO * power_uw / voltage_v
        current_a = _signed(wanted.current_a if measured_a is None else measured_a, status)
        temperature_d = _number(folder / "temp")  # in tenths of a degree
        percent = _number(folder / "capacity") if wanted.believes_soc else None
        if percent is not None and not 0 <= percent <= 100:
            raise BadReading(f"expected a capacity of 0 to 100 %, got {percent:g}")
        return Reading(
            voltage_v,
            current_a,
            ASSUMED_C if temperature_d is None else 0.1 * temperature_d,
            BatteryReport(
                has_current=measured_a is not None,
                soc=None if percent is None else percent / 100,
                soc_sd=wanted.soc_sd,
            ),
        )


def _signed(current_a: float, status: str | None) -> float:
    """Positive while discharging: drivers do not agree on the sign, but all report the status."""
    if status == CHARGING:
        return -abs(current_a)
    if status == DISCHARGING:
        return abs(current_a)
    return 0.0 if status in ("Full", "Not charging") else current_a


def _text(path: Path) -> str | None:
    """What is in a file, without the line's end; None if there is no such file."""
    try:
        with path.open("rb") as file:
            data = file.read(VALUE_BYTES_MAX + 1)
    except FileNotFoundError:
        return None
    if len(data) > VALUE_BYTES_MAX:
        raise BadReading(f"{path.name}: expected at most {VALUE_BYTES_MAX} bytes")
    return data.decode("ascii", "replace").strip()


def _number(path: Path) -> float | None:
    try:
        text = _text(path)
        return None if text is None else float(int(text))
    except ValueError as error:
        raise BadReading(f"{path.name}: expected a whole number, got {text!r}") from error
    except OSError as error:
        if isinstance(error, BadReading) or error.errno not in NO_VALUE:
            raise
        return None
