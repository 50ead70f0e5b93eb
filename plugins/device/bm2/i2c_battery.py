"""Batteries measured over I2C: a current sensor INA219, INA226 or INA228, and smart batteries (SBS 1.1)."""

from enum import StrEnum
from typing import Annotated, Literal, NamedTuple

import msgspec
from msgspec import Meta
from smbus2 import SMBus

from robrain.agent.plugin import external
from robrain.plugins.device.bm2.interface import ASSUMED_C, BadReading, Reading, plausible
from robrain.plugins.device.bm2.polled_battery import PolledBattery
from robrain.protocol.model.checked import Checked

CONFIGURATION, SHUNT, BUS = 0x00, 0x01, 0x02
"""Numbers of the registers; each holds 16 bits, the higher byte first."""


class Chip(StrEnum):
    """Which monitor it is."""

    INA219 = "ina219"
    INA226 = "ina226"


class Registers(NamedTuple):
    """Contents of a chip's registers."""

    configuration: int
    """Continuous, and averaged over about the time between two readings."""
    shunt_v: float
    """Of one bit."""
    bus_v: float
    bus_shift: int
    """Bits of the bus voltage's register that are not of the voltage."""


REGISTERS = {
    Chip.INA219: Registers(0x3FFF, 10e-6, 4e-3, 3),  # 32 V, ±320 mV, mean of 128 samples: 136 ms
    Chip.INA226: Registers(0x4727, 2.5e-6, 1.25e-3, 0),  # mean of 64 samples of 2 × 1.1 ms: 141 ms
}


class InaBattery(PolledBattery):
    """Reads voltage and current from an INA219 or INA226."""

    class Parameters(PolledBattery.Parameters, Checked, frozen=True, forbid_unknown_fields=True):
        """Where it is, and its shunt."""

        chip: Chip = Chip.INA219
        bus: Annotated[int, Meta(ge=0, le=255)] = 1
        """Number of the I2C bus: 1 for /dev/i2c-1."""
        address: Annotated[int, Meta(ge=0x40, le=0x4F)] = 0x40
        shunt_ohm: Annotated[float, Meta(gt=0, lt=1000.0)] = 0.1
        """Of the resistor that the current flows through; 0.1 on the usual boards."""
        current_sign: Literal[1, -1] = 1
        """-1 if the shunt is connected in reverse: positive is discharging."""
        temperature_c: float = ASSUMED_C
        """Assumed temperature of the battery, which is not measured."""

    parameters: Parameters

    def init(self) -> None:
        super().init()
        self._smbus: SMBus | None = None
        wanted = self.parameters
        self._registers = REGISTERS[wanted.chip]
        self.where = f"the {wanted.chip} at /dev/i2c-{wanted.bus}, address 0x{wanted.address:02x}"

    def open(self) -> None:
        self._smbus = SMBus(self.parameters.bus)
        try:
            self._configure()
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        if self._smbus is not None:
            self._smbus.close()
            self._smbus = None

    def read(self) -> Reading:
        if self._word(CONFIGURATION) != self._registers.configuration:  # it had no power meanwhile
            self._configure()
            raise BadReading("the chip has restarted, and averages less than it was set to")
        registers, wanted = self._registers, self.parameters
        shunt = self._word(SHUNT)
        signed = shunt - 0x10000 if shunt & 0x8000 else shunt
        if signed in (-0x8000, 0x7FFF):
            raise BadReading("the current is beyond what the shunt can measure")
        voltage_v = (self._word(BUS) >> registers.bus_shift) * registers.bus_v
        current_a = wanted.current_sign * signed * registers.shunt_v / wanted.shunt_ohm
        return plausible(voltage_v, current_a, assumed_c=wanted.temperature_c)

    def _configure(self) -> None:
        assert self._smbus is not None
        self._smbus.write_word_data(self.parameters.address, CONFIGURATION, _swapped(self._registers.configuration))

    def _word(self, register: int) -> int:
        assert self._smbus is not None
        return _swapped(self._smbus.read_word_data(self.parameters.address, register) & 0xFFFF)


def _swapped(word: int) -> int:
    """The other order of two bytes: SMBus sends the lower one first."""
    return (word & 0xFF) << 8 | word >> 8


TEMPERATURE, VOLTAGE, CURRENT, MAX_ERROR = 0x08, 0x09, 0x0A, 0x0C
RELATIVE_SOC, REMAINING, STATUS, SPECIFICATION = 0x0D, 0x0F, 0x16, 0x1A
"""Numbers of the registers."""
STATUS_BITS = {
    0x8000: "over charged",
    0x4000: "terminate charge",
    0x1000: "over temperature",
    0x0800: "terminate discharge",
    0x0200: "remaining capacity low",
    0x0100: "remaining time low",
}
"""Alarms in the register of the status."""
ERROR_MASK = 0x000F
SOC_SD_LEAST = 0.01
"""Batteries round to whole percents."""
ABSOLUTE_ZERO_C = -273.15


class SmartBatteryStatus(msgspec.Struct, frozen=True):
    """Reports of a smart battery beside its measurements."""

    alarms: tuple[str, ...]
    remaining: int
    """Remaining capacity in mAh; in 10 mWh if the battery is set to count energy."""
    error_code: int
    """Of its last command; 0 for none."""


class SmartBattery(PolledBattery):
    """Reads a smart battery, which measures its state of charge itself."""

    class Parameters(PolledBattery.Parameters, msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """Where it is."""

        bus: Annotated[int, Meta(ge=0, le=255)] = 1
        """Number of the I2C bus: 1 for /dev/i2c-1."""
        address: Annotated[int, Meta(ge=0x08, le=0x77)] = 0x0B
        pec: bool = False
        """Whether packets carry a checksum (packet error checking), if the battery and the bus's driver can."""

    parameters: Parameters

    def init(self) -> None:
        super().init()
        self._smbus: SMBus | None = None
        self._status: SmartBatteryStatus | None = None
        wanted = self.parameters
        self.where = f"the smart battery at /dev/i2c-{wanted.bus}, address 0x{wanted.address:02x}"

    def open(self) -> None:
        self._smbus = SMBus(self.parameters.bus)
        try:
            self._smbus.pec = int(self.parameters.pec)
            specification = self._word(SPECIFICATION)
        except OSError:
            self.close()
            raise
        self._volts = 1e-3 * 10.0 ** (specification >> 8 & 0xF)
        self._amperes = 1e-3 * 10.0 ** (specification >> 12 & 0xF)

    def close(self) -> None:
        if self._smbus is not None:
            self._smbus.close()
            self._smbus = None

    def read(self) -> Reading:
        status = self._word(STATUS)
        self._status = SmartBatteryStatus(
            tuple(name for bit, name in STATUS_BITS.items() if status & bit),
            self._word(REMAINING),
            status & ERROR_MASK,
        )
        voltage, current, temperature = self._word(VOLTAGE), self._word(CURRENT), self._word(TEMPERATURE)
        percent, error_percent = self._word(RELATIVE_SOC), self._word(MAX_ERROR)
        signed = current - 0x10000 if current & 0x8000 else current
        return plausible(
            voltage * self._volts,
            -signed * self._amperes,  # the battery's is positive while charging
            0.1 * temperature + ABSOLUTE_ZERO_C,
            percent / 100 if error_percent <= 100 else None,
            soc_sd=max(SOC_SD_LEAST, error_percent / 200),  # the error counts as two standard deviations
        )

    @external
    def status(self) -> SmartBatteryStatus | None:
        """Alarms, remaining capacity and error code of the last reading; null before the first."""
        return self._status

    def _word(self, register: int) -> int:
        assert self._smbus is not None
        return self._smbus.read_word_data(self.parameters.address, register) & 0xFFFF
