"""An I2C bus with simulated chips, behind the functions of smbus2's `SMBus` that robrain's devices use."""

import errno
from typing import Protocol

CRC_POLYNOMIAL = 0x07
"""Of the packet error code: SMBus specification 3.1, section 6.4."""


class I2cChip(Protocol):
    """A chip with registers of 16 bits."""

    def word(self, register: int) -> int:
        """Value of a register; the byte that is sent first is the lower one (OSError if there is no such register)."""

    def write(self, register: int, word: int) -> None:
        """Write a register, in the same order of bytes."""


class I2cBus:
    """A bus; `open` replaces the class `SMBus`."""

    def __init__(self) -> None:
        self.chips: dict[int, I2cChip] = {}
        """By address; a chip that is taken out is unplugged."""
        self.is_there = True
        """Whether the computer has the bus."""
        self.flips: list[int] = []
        """Bits that are flipped by noise in the next words that are read, one in each."""
        self.opened = self.closed = 0

    def open(self, number: int) -> "I2cHandle":
        """Open the bus (OSError if it is not there)."""
        if not self.is_there:
            raise FileNotFoundError(errno.ENOENT, "No such file or directory", f"/dev/i2c-{number}")
        self.opened += 1
        return I2cHandle(self)


class I2cHandle:
    """An open bus."""

    def __init__(self, bus: I2cBus) -> None:
        self.pec = 0
        self._bus: I2cBus | None = bus
        self._is_dead = False
        """The bus was unplugged: this handle is of no use any more."""

    def read_word_data(self, address: int, register: int) -> int:
        """Read a register; with `pec` a packet with a wrong checksum is OSError, as the kernel has it."""
        bus = self._there(address)
        sent = bus.chips[address].word(register)
        code = _packet_code(address, register, sent)
        read = sent ^ 1 << bus.flips.pop(0) if bus.flips else sent
        if self.pec and code != _packet_code(address, register, read):
            raise OSError(errno.EBADMSG, "Bad message")
        return read

    def write_word_data(self, address: int, register: int, word: int) -> None:
        """Write a register."""
        self._there(address).chips[address].write(register, word)

    def close(self) -> None:
        """Leave the bus."""
        if self._bus is not None:
            self._bus.closed += 1
            self._bus = None

    def _there(self, address: int) -> I2cBus:
        if self._bus is not None and not self._bus.is_there:
            self._is_dead = True
        if self._bus is None or self._is_dead:
            raise OSError(errno.ENODEV, "No such device")
        if address not in self._bus.chips:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        return self._bus


def _packet_code(address: int, register: int, word: int) -> int:
    """CRC-8 of a whole read: both addresses, the register, the word's bytes."""
    register_code = 0
    for byte in (address << 1, register, address << 1 | 1, word & 0xFF, word >> 8):
        register_code ^= byte
        for _ in range(8):
            register_code = (register_code << 1 ^ (CRC_POLYNOMIAL if register_code & 0x80 else 0)) & 0xFF
    return register_code
