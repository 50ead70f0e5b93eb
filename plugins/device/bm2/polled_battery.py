"""Common part of all polled batteries, for any values and any bus.

A reading that fails is tried again at the next step, with the bus opened again; `battery` continues by its estimate
meanwhile. After `silent_s` without a reading the device faults, and the manifest's restart policy tries until the
battery answers.
"""

import errno
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.agent.plugin import external
from robrain.agent.silence import Silence
from robrain.plugins.device.bm2.interface import BadReading, BatteryDevice, Reading, plausible
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import NotNegative


class BatteryAbsent(OSError):
    """Nothing can be read from the battery. A fault like others: the plugin is started again later."""


class ReadCounters(msgspec.Struct, frozen=True):
    """Counters of the readings."""

    readings: int
    rejected: int
    """Readings that cannot be believed."""
    failed: int
    """Attempts in which nothing could be read."""
    last_error: str


class PolledBattery(BatteryDevice):
    """Reads a battery periodically; subclasses open and read it."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """Common parameters of all polled batteries."""

        silent_s: Annotated[float, Meta(gt=0, lt=3600.0)] = 5.0
        """Time without a reading after which the battery counts as gone."""

    parameters: Parameters

    where = "the battery"
    """Name of the polled battery, such as `the smart battery at /dev/i2c-1, 0x0b`."""

    def open(self) -> None:
        """Open the battery's bus or files (OSError if that fails)."""
        raise NotImplementedError

    def close(self) -> None:
        """Close it; harmless if it is not open."""
        raise NotImplementedError

    def read(self) -> Reading:
        """One reading (OSError if that fails, BadReading if it is not plausible)."""
        raise NotImplementedError

    def init(self) -> None:
        self._is_open = False
        self._readings = self._rejected = self._failed = 0
        self._last_error = ""

    def activate(self) -> None:
        self._silence = Silence(to_ns(self.parameters.silent_s))
        self._received_ns = self.env.clock.now_ns()
        try:
            self._read_once(self._received_ns)
        except (OSError, BadReading) as error:
            self._record_failure(error)
            self._close()
            raise BatteryAbsent(f"nothing can be read from {self.where}: {self._last_error}") from error

    def step(self) -> None:
        now_ns = self.env.clock.now_ns()
        try:
            self._read_once(now_ns)
        except (OSError, BadReading) as error:
            self._record_failure(error)
            silent_ns = self._silence.since(self._received_ns, now_ns)
            if silent_ns > self._silence.limit_ns:
                what = f"nothing read for {silent_ns / NS_PER_S:.1f} s from {self.where}: {self._last_error}"
                raise BatteryAbsent(what) from error

    def deactivate(self) -> None:
        self._close()

    @external
    def counters(self) -> ReadCounters:
        """Readings taken, rejected and failed, and the last error."""
        return ReadCounters(self._readings, self._rejected, self._failed, self._last_error)

    def _read_once(self, now_ns: int) -> None:
        if not self._is_open:
            self.open()
            self._is_open = True
        reading = self.read()
        self._readings += 1
        self._received_ns = now_ns
        self.count(reading, now_ns)

    def _record_failure(self, error: OSError | BadReading) -> None:
        self._last_error = getattr(error, "strerror", None) or str(error) or type(error).__name__
        if isinstance(error, BadReading):
            self._rejected += 1
        else:
            self._failed += 1
            self._close()

    def _close(self) -> None:
        if self._is_open:
            self._is_open = False
            self.close()


VALUE_BYTES_MAX = 64
"""Longer values than this are none."""
MICRO = 1e-6
NO_VALUE = (errno.ENODATA, errno.EINVAL, errno.EOPNOTSUPP)
"""Errors of drivers for an existing file that has no value at the moment."""
CHARGING, DISCHARGING, IDLE = "Charging", "Discharging", ("Full", "Not charging")
"""Status files; they decide the sign of the current, which drivers report with either sign."""


class PowerSupply(PolledBattery):
    """Reads a battery of the kernel's power supply class."""

    class Parameters(PolledBattery.Parameters, frozen=True, forbid_unknown_fields=True):
        """The battery, and assumed values of unmeasured quantities."""

        name: Annotated[str, Meta(max_length=64, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.:-]*$|^$")] = ""
        """Of the folder, such as `BAT0`; empty: the first battery that supplies the computer."""
        folder: Annotated[str, Meta(min_length=1, max_length=4096)] = "/sys/class/power_supply"
        current_a: NotNegative = 1.0
        """Taken as drawn, or as charging, if the battery does not report its current."""
        soc_sd: Annotated[float, Meta(gt=0, lt=1.0)] = 0.05
        """Standard deviation of the state of charge that the kernel reports."""
        believes_soc: bool = True
        """Whether to use it: some drivers only guess it from the voltage, which the estimate does better."""

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
    """Contents of a file, without the line's end; None if there is no such file."""
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
