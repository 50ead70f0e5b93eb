"""The frames on the robot's bus, as the DBC file beside this module describes them.

Each frame ends with an 8-bit counter and a CRC-8 (SAE J1850) over its identifier and the bytes before. The layout comes
from cantools, which reads the file (the tests compare the bytes with cantools' output).
"""

import struct
from functools import cache
from importlib import resources
from operator import mul, truediv
from typing import Any

import can
import cantools

from robrain.protocol.errors import RobrainError

ROBERTINO = "robertino"

_CRC8_POLYNOMIAL = 0x1D
_CRC8_START = 0xFF
_CRC8_XOR_OUT = 0xFF
_BYTES = tuple(bytes((value,)) for value in range(256))


class BadFrame(RobrainError):
    """A frame with a wrong length or checksum."""


class FrameCodec:
    """Packs and unpacks one frame of the DBC file, with its counter and checksum.

    `encode` and `decode` convert between the bytes and the signals in the order of the file. `pack` and `unpack` do the
    same by name and for whole frames, and are slower.

    Args:
        message: the frame, as cantools read it; its last two signals are `counter` and `checksum`, a byte each.

    Raises:
        ValueError: its signals do not fill whole bytes in order, the lowest byte first.

    """

    def __init__(self, message: Any) -> None:
        self.name: str = message.name
        self.arbitration_id: int = message.frame_id
        signals = message.signals[:-1]
        self.signals: tuple[str, ...] = tuple(signal.name for signal in signals[:-1])
        """Names of the signals in their order, without `counter` and `checksum`."""
        self.bits: tuple[int, ...] = tuple(signal.length for signal in signals[:-1])
        """Length of each of these."""
        self._length: int = message.length
        self._layout = _layout(message)
        """Of all bytes but the checksum."""
        self._scales = tuple(signal.scale if signal.scale != 1 else 1 for signal in signals)
        # 0.3 µs for a frame; crccheck's own loop, against which the tests hold it, takes 5 µs.
        self.crc_table = table = _crc8_table()
        """The next register of the checksum, for the register before XOR the next byte."""
        register = _CRC8_START
        for byte in self.arbitration_id.to_bytes(2, "big"):
            register = table[register ^ byte]
        self.crc_start = register
        """Register of the checksum after the identifier; the checksum is the inverse of the last register."""

    def encode(self, counter: int, *values: float) -> bytes:
        """The frame's bytes with these values (physical units), in the order of `signals`; `counter` wraps at 256.

        Raises:
            TypeError: there are more or fewer values than signals.
            OverflowError, ValueError: a value that its field cannot hold.

        """
        if len(values) != len(self.signals):
            raise TypeError(f"{self.name}: expected {len(self.signals)} values, got {len(values)}")
        try:
            data = self._layout.pack(*map(round, map(truediv, values, self._scales)), counter & 0xFF)
        except struct.error as error:
            raise OverflowError(f"{self.name}: {values}: {error}") from error
        register, table = self.crc_start, self.crc_table
        for byte in data:
            register = table[register ^ byte]
        return data + _BYTES[register ^ _CRC8_XOR_OUT]

    def decode(self, data: bytes | bytearray) -> tuple[float, ...]:
        """The values (physical units) in the order of `signals`, then the counter.

        Raises:
            BadFrame: the length or the checksum is wrong.

        """
        if len(data) != self._length:
            raise BadFrame(f"{self.name}: expected {self._length} bytes, got {len(data)}")
        register, table = self.crc_start, self.crc_table
        for byte in data[:-1]:
            register = table[register ^ byte]
        if data[-1] != register ^ _CRC8_XOR_OUT:
            raise BadFrame(f"{self.name}: wrong checksum")
        return tuple(map(mul, self._layout.unpack_from(data), self._scales))

    def pack(self, counter: int, **values: float) -> can.Message:
        """A frame with these signals (physical units); `counter` wraps at 256.

        Raises:
            KeyError: a signal is missing.
            OverflowError, ValueError: a value that its field cannot hold.

        """
        data = self.encode(counter, *[values[name] for name in self.signals])
        return can.Message(arbitration_id=self.arbitration_id, data=data, is_extended_id=False)

    def unpack(self, frame: can.Message) -> dict[str, float]:
        """The signals by name (physical units), with `counter` and `checksum`.

        Raises:
            BadFrame: the length or the checksum is wrong.

        """
        values = self.decode(frame.data)
        return dict(zip((*self.signals, "counter", "checksum"), (*values, frame.data[-1]), strict=True))


def _layout(message: Any) -> struct.Struct:
    """Of the bytes before the checksum. A tenth of cantools' time, for each of a hundred frames a second and robot."""
    codes, next_bit = "<", 0
    for signal in message.signals:
        code = _CODES.get((signal.length, signal.is_signed))
        is_plain = signal.byte_order == "little_endian" and signal.offset == 0 and not signal.is_float
        if code is None or signal.start != next_bit or not is_plain or signal.choices:
            raise ValueError(f"{message.name}: expected {signal.name} to fill whole bytes after the signal before it")
        codes, next_bit = codes + code, next_bit + signal.length
    if next_bit != 8 * message.length:
        raise ValueError(f"{message.name}: expected signals for {message.length} bytes, got {next_bit / 8:g}")
    return struct.Struct(codes[:-1])


_CODES = {(8, False): "B", (8, True): "b", (16, False): "H", (16, True): "h"}
"""struct's code for each length in bits, unsigned and signed."""


@cache
def database(name: str = ROBERTINO) -> Any:
    """A DBC file of this folder, as cantools reads it (FileNotFoundError if there is none of that name)."""
    text = resources.files(__package__).joinpath(f"{name}.dbc").read_text(encoding="utf-8")
    return cantools.database.load_string(text, "dbc")


@cache
def codec(name: str) -> FrameCodec:
    """The codec of the frame with that name in the DBC file."""
    return FrameCodec(database().get_message_by_name(name))


@cache
def known_identifiers() -> frozenset[int]:
    """The identifiers of all frames in the DBC file."""
    return frozenset(message.frame_id for message in database().messages)


def crc8_j1850(data: bytes) -> int:
    """CRC-8 SAE J1850 of some bytes.

    >>> hex(crc8_j1850(b"123456789"))
    '0x4b'
    """
    register, table = _CRC8_START, _crc8_table()
    for byte in data:
        register = table[register ^ byte]
    return register ^ _CRC8_XOR_OUT


@cache
def _crc8_table() -> tuple[int, ...]:
    def shifted(register: int) -> int:
        for _ in range(8):
            register = ((register << 1) ^ _CRC8_POLYNOMIAL if register & 0x80 else register << 1) & 0xFF
        return register

    return tuple(shifted(register) for register in range(256))
