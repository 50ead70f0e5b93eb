"""Voltage and current of a battery by a current monitor on an I2C bus: INA219 or INA226, by Texas Instruments.

Registers, scales and configurations are those of the data sheets SBOS448G (INA219) and SBOS547A (INA226).
"""

from enum import StrEnum
from typing import Annotated, Literal, NamedTuple

import msgspec
from msgspec import Meta
from smbus2 import SMBus

from robrain.plugins.device.bm2.counting import BadReading, Reading, plausible
from robrain.plugins.device.bm2.interface import ASSUMED_C
from robrain.plugins.device.bm2.polled_battery import PolledBattery
from robrain.protocol.model.ranges import check_finite, check_positive

CONFIGURATION, SHUNT, BUS = 0x00, 0x01, 0x02
"""Numbers of the registers; each holds 16 bits, the higher byte first."""


class Chip(StrEnum):
    """Which monitor it is."""

    INA219 = "ina219"
    INA226 = "ina226"


class Registers(NamedTuple):
    """What is in a chip's registers."""

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

    class Parameters(PolledBattery.Parameters, msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """Where it is, and its shunt."""

        chip: Chip = Chip.INA219
        bus: Annotated[int, Meta(ge=0, le=255)] = 1
        """Number of the I2C bus: 1 for /dev/i2c-1."""
        address: Annotated[int, Meta(ge=0x40, le=0x4F)] = 0x40
        shunt_ohm: float = 0.1
        """Of the resistor that the current flows through; 0.1 on the usual boards."""
        current_sign: Literal[1, -1] = 1
        """-1 if the shunt is connected the other way round: positive is discharging."""
        temperature_c: float = ASSUMED_C
        """Taken for the battery's, which is not measured."""

        def __post_init__(self) -> None:
            super().__post_init__()
            check_positive(self, "shunt_ohm", below=1000.0)
            check_finite(self, "temperature_c")

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
