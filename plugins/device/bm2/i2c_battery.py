"""Batteries measured over I2C: a current sensor INA219, INA226 or INA228, and smart batteries (SBS 1.1)."""

from typing import Annotated, Literal, NamedTuple

import msgspec
from msgspec import Meta
from smbus2 import SMBus

from robrain.agent.plugin import external
from robrain.plugins.device.bm2.interface import ASSUMED_C, BadReading, Reading, plausible
from robrain.plugins.device.bm2.polled_battery import PolledBattery

CONFIGURATION, SHUNT, BUS = 0x00, 0x01, 0x02
"""Numbers of the registers; each holds 16 bits, the higher byte first."""


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
    "ina219": Registers(0x3FFF, 10e-6, 4e-3, 3),  # 32 V, ±320 mV, mean of 128 samples: 136 ms
    "ina226": Registers(0x4727, 2.5e-6, 1.25e-3, 0),  # mean of 64 samples of 2 × 1.1 ms: 141 ms
}


class I2cBattery(PolledBattery):
    """A battery on an I2C bus."""

    class Parameters(PolledBattery.Parameters, frozen=True, forbid_unknown_fields=True):
        """Where it is."""

        bus: Annotated[int, Meta(ge=0, le=255)] = 1
        """Number of the I2C bus: 1 for /dev/i2c-1."""
        address: Annotated[int, Meta(ge=0x08, le=0x77)] = 0x0B

    parameters: Parameters
    name = "battery"
    _smbus: SMBus | None = None

    def init(self) -> None:
        super().init()
        wanted = self.parameters
        self.where = f"the {self.name} at /dev/i2c-{wanted.bus}, address 0x{wanted.address:02x}"

    def open(self) -> None:
        self._smbus = SMBus(self.parameters.bus)
        try:
            self.configure(self._smbus)
        except OSError:
            self.close()
            raise

    def configure(self, smbus: SMBus) -> None:
        """Prepare the readings, after the bus was opened."""
        raise NotImplementedError

    def close(self) -> None:
        if self._smbus is not None:
            self._smbus.close()
            self._smbus = None

    def word(self, register: int) -> int:
        """Contents of a register; SMBus sends the lower byte first."""
        assert self._smbus is not None
        return int(self._smbus.read_word_data(self.parameters.address, register)) & 0xFFFF


def _signed(word: int) -> int:
    return word - 0x10000 if word & 0x8000 else word


class InaBattery(I2cBattery):
    """Reads voltage and current from an INA219 or INA226."""

    class Parameters(I2cBattery.Parameters, frozen=True, forbid_unknown_fields=True):
        """Where it is, and its shunt."""

        chip: Literal["ina219", "ina226"] = "ina219"
        address: Annotated[int, Meta(ge=0x40, le=0x4F)] = 0x40
        shunt_ohm: Annotated[float, Meta(gt=0, lt=1000.0)] = 0.1
        """Of the resistor that the current flows through; 0.1 on the usual boards."""
        current_sign: Literal[1, -1] = 1
        """-1 if the shunt is connected in reverse: positive is discharging."""
        temperature_c: float = ASSUMED_C
        """Assumed temperature of the battery, which is not measured."""

    parameters: Parameters

    def init(self) -> None:
        self._registers, self.name = REGISTERS[self.parameters.chip], self.parameters.chip
        super().init()

    def configure(self, smbus: SMBus) -> None:
        smbus.write_word_data(self.parameters.address, CONFIGURATION, _swapped(self._registers.configuration))

    def read(self) -> Reading:
        if self._swapped_word(CONFIGURATION) != self._registers.configuration:  # it had no power meanwhile
            assert self._smbus is not None
            self.configure(self._smbus)
            raise BadReading("the chip has restarted, and averages less than it was set to")
        registers, wanted = self._registers, self.parameters
        signed = _signed(self._swapped_word(SHUNT))
        if signed in (-0x8000, 0x7FFF):
            raise BadReading("the current is beyond what the shunt can measure")
        voltage_v = (self._swapped_word(BUS) >> registers.bus_shift) * registers.bus_v
        current_a = wanted.current_sign * signed * registers.shunt_v / wanted.shunt_ohm
        return plausible(voltage_v, current_a, assumed_c=wanted.temperature_c)

    def _swapped_word(self, register: int) -> int:
        return _swapped(self.word(register))


def _swapped(word: int) -> int:
    """The other order of two bytes: the chips send the higher one first."""
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


class SmartBattery(I2cBattery):
    """Reads a smart battery, which measures its state of charge itself."""

    class Parameters(I2cBattery.Parameters, frozen=True, forbid_unknown_fields=True):
        """Where it is."""

        pec: bool = False
        """Whether packets carry a checksum (packet error checking), if the battery and the bus's driver can."""

    parameters: Parameters

    name = "smart battery"
    _status: SmartBatteryStatus | None = None

    def configure(self, smbus: SMBus) -> None:
        smbus.pec = int(self.parameters.pec)
        specification = self.word(SPECIFICATION)
        self._volts = 1e-3 * 10.0 ** (specification >> 8 & 0xF)
        self._amperes = 1e-3 * 10.0 ** (specification >> 12 & 0xF)

    def read(self) -> Reading:
        status = self.word(STATUS)
        self._status = SmartBatteryStatus(
            tuple(name for bit, name in STATUS_BITS.items() if status & bit),
            self.word(REMAINING),
            status & ERROR_MASK,
        )
        voltage, current, temperature = self.word(VOLTAGE), self.word(CURRENT), self.word(TEMPERATURE)
        percent, error_percent = self.word(RELATIVE_SOC), self.word(MAX_ERROR)
        return plausible(
            voltage * self._volts,
            -_signed(current) * self._amperes,  # the battery's is positive while charging
            0.1 * temperature + ABSOLUTE_ZERO_C,
            percent / 100 if error_percent <= 100 else None,
            soc_sd=max(SOC_SD_LEAST, error_percent / 200),  # the error counts as two standard deviations
        )

    @external
    def status(self) -> SmartBatteryStatus | None:
        """Alarms, remaining capacity and error code of the last reading; null before the first."""
        return self._status
