"""A smart battery on an I2C bus: the registers of the Smart Battery Data Specification, revision 1.1, over SMBus."""

from typing import Annotated

import msgspec
from msgspec import Meta
from smbus2 import SMBus

from robrain.agent.plugin import external
from robrain.plugins.device.bm2.counting import Reading, plausible
from robrain.plugins.device.bm2.polled_battery import PolledBattery

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
    """What a smart battery reports beside its measurements."""

    alarms: tuple[str, ...]
    remaining: int
    """Remaining capacity in mAh; in 10 mWh if the battery is set to count energy."""
    error_code: int
    """Of its last command; 0 for none."""


class SmartBattery(PolledBattery):
    """Reads a smart battery, which finds its state of charge itself."""

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
            soc_sd=max(SOC_SD_LEAST, error_percent / 200),  # the error is taken for two standard deviations
        )

    @external
    def status(self) -> SmartBatteryStatus | None:
        """Alarms, remaining capacity and error code of the last reading; null before the first."""
        return self._status

    def _word(self, register: int) -> int:
        assert self._smbus is not None
        return self._smbus.read_word_data(self.parameters.address, register) & 0xFFFF
