"""A battery that Linux knows: the files below /sys/class/power_supply (power_supply_class.rst of the kernel).

The battery of a laptop, of a UPS board or of a phone that drives a robot; also one of which only the voltage is known.
"""

import errno
import math
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.plugins.device.bm2.counting import BadReading, Reading, plausible
from robrain.plugins.device.bm2.polled_battery import PolledBattery
from robrain.protocol.model.ranges import check_positive

VALUE_BYTES_MAX = 64
"""Longer values than this are none."""
MICRO = 1e-6
NO_VALUE = (errno.ENODATA, errno.EINVAL, errno.EOPNOTSUPP)
"""What drivers answer for a file that is there and has no value at the moment."""
CHARGING, DISCHARGING, IDLE = "Charging", "Discharging", ("Full", "Not charging")
"""Status files; they decide the sign of the current, which drivers report in either way."""


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
        current_ua, power_uw = _optional(folder / "current_now"), _optional(folder / "power_now")
        measured_a = None
        if current_ua is not None:
            measured_a = -MICRO * current_ua  # the kernel's is negative while discharging, where the status is unknown
        elif power_uw is not None and voltage_v > 0:
            measured_a = MICRO * abs(power_uw) / voltage_v
        is_idle = status in IDLE
        temperature_d = _optional(folder / "temp")  # in tenths of a degree
        percent = _optional(folder / "capacity") if wanted.believes_soc else None
        return plausible(
            voltage_v,
            None if measured_a is None else measured_a * (not is_idle),
            None if temperature_d is None else 0.1 * temperature_d,
            None if percent is None else percent / 100,
            assumed_a=wanted.current_a * (not is_idle),
            soc_sd=wanted.soc_sd,
            is_charging={CHARGING: True, DISCHARGING: False}.get(status or ""),
        )


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


def _optional(path: Path) -> float | None:
    try:
        return _number(path)
    except BadReading:
        return None


def _number(path: Path) -> float | None:
    try:
        text = _text(path)
        return None if text is None else float(int(text))
    except BadReading:
        raise
    except ValueError as error:
        raise BadReading(f"{path.name}: expected a whole number, got {text!r}") from error
    except OSError as error:
        if error.errno not in NO_VALUE:
            raise
        return None
