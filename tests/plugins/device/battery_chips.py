"""Chips that measure a battery, with the registers of their data sheets."""

import errno


class SmartBatteryChip:
    """A smart battery, revision 1.1 of its specification. Current is positive while discharging, as elsewhere here."""

    def __init__(self, *, voltage_scale: int = 0, current_scale: int = 0) -> None:
        self.voltage_v, self.current_a, self.temperature_c = 15.0, 1.0, 25.0
        self.soc, self.error_percent, self.remaining_mah = 0.8, 2, 2000
        self.status = 0x00C0
        self._scales = voltage_scale, current_scale

    def word(self, register: int) -> int:
        """As I2cChip."""
        volts, amperes = (1000.0 / 10.0**scale for scale in self._scales)
        words: dict[int, int] = {
            0x08: round(10 * (self.temperature_c + 273.15)),
            0x09: round(self.voltage_v * volts),
            0x0A: round(-self.current_a * amperes) & 0xFFFF,
            0x0C: self.error_percent,
            0x0D: round(100 * self.soc),
            0x0F: self.remaining_mah,
            0x16: self.status,
            0x1A: 0x31 | self._scales[0] << 8 | self._scales[1] << 12,
        }
        if register not in words:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        return words[register]

    def write(self, register: int, word: int) -> None:
        """As I2cChip; it accepts no writes."""
        raise OSError(errno.EREMOTEIO, "Remote I/O error")


class InaChip:
    """An INA219, or an INA226, over a shunt. It sends the higher byte first."""

    def __init__(self, *, is_226: bool = False, shunt_ohm: float = 0.1) -> None:
        self.voltage_v, self.current_a = 12.0, 0.5
        self._is_226, self._shunt_ohm = is_226, shunt_ohm
        self.restart()

    def restart(self) -> None:
        """Lose power, and regain it: the configuration is lost."""
        self.configuration = 0x4127 if self._is_226 else 0x399F

    def word(self, register: int) -> int:
        """As I2cChip."""
        shunt_v = self.current_a * self._shunt_ohm
        if register == 0x00:
            value = self.configuration
        elif register == 0x01:
            bits = round(shunt_v / (2.5e-6 if self._is_226 else 10e-6))
            value = max(-0x8000, min(0x7FFF, bits)) & 0xFFFF
        elif register == 0x02:
            # The INA219 has the end of a conversion in bit 1.
            value = round(self.voltage_v / 1.25e-3) if self._is_226 else round(self.voltage_v / 4e-3) << 3 | 2
        else:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        return (value & 0xFF) << 8 | value >> 8

    def write(self, register: int, word: int) -> None:
        """As I2cChip."""
        if register == 0x00:
            self.configuration = (word & 0xFF) << 8 | word >> 8
