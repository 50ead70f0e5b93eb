"""The frames on the robot's bus, as the DBC file beside this module describes them.

Each frame ends with an 8-bit counter and a CRC-8 (SAE J1850) over its identifier and the bytes before; cantools
packs and unpacks the rest.
"""

from functools import cache
from importlib import resources
from typing import Any

import can
import cantools

from robrain.protocol.wire.errors import RobrainError

DBC_FILE = "robertino.dbc"

_CRC8_POLYNOMIAL = 0x1D
_CRC8_START = 0xFF
_CRC8_XOR_OUT = 0xFF


class BadFrame(RobrainError):
    """A frame that must not be believed: wrong length or checksum."""


class FrameCodec:
    """Packs and unpacks one frame of the DBC file, with its counter and checksum.

    Args:
        message: the frame, as cantools read it; its last two signals are `counter` and `checksum`, a byte each.

    """

    def __init__(self, message: Any) -> None:
        self.name: str = message.name
        self.arbitration_id: int = message.frame_id
        self._message = message
        self._length: int = message.length
        self._crc_start = _crc8(_CRC8_START, self.arbitration_id.to_bytes(2, "big"))

    def pack(self, counter: int, **values: float) -> can.Message:
        """A frame with these signals (physical units); `counter` wraps at 256.

        Raises:
            OverflowError, ValueError: a value that its field cannot hold.

        """
        data = bytearray(self._message.encode({**values, "counter": counter & 0xFF, "checksum": 0}, strict=False))
        data[-1] = self._checksum(data)
        return can.Message(arbitration_id=self.arbitration_id, data=data, is_extended_id=False)

    def unpack(self, frame: can.Message) -> dict[str, float]:
        """The signals by name (physical units), with `counter` and `checksum`.

        Raises:
            BadFrame: the length or the checksum is wrong.

        """
        data = frame.data
        if len(data) != self._length:
            raise BadFrame(f"{self.name}: expected {self._length} bytes, got {len(data)}")
        if data[-1] != self._checksum(data):
            raise BadFrame(f"{self.name}: wrong checksum")
        signals: dict[str, float] = self._message.decode(data, decode_choices=False)
        return signals

    def _checksum(self, data: bytearray) -> int:
        return _crc8(self._crc_start, data[:-1]) ^ _CRC8_XOR_OUT


@cache
def database() -> Any:
    """The DBC file, as cantools reads it."""
    text = resources.files(__package__).joinpath(DBC_FILE).read_text(encoding="utf-8")
    return cantools.database.load_string(text, "dbc")


@cache
def codec(name: str) -> FrameCodec:
    """The codec of the frame with that name in the DBC file."""
    return FrameCodec(database().get_message_by_name(name))


@cache
def known_identifiers() -> frozenset[int]:
    """The identifiers of all frames in the DBC file."""
    return frozenset(message.frame_id for message in database().messages)


@cache
def _crc8_table() -> tuple[int, ...]:
    def shifted(register: int) -> int:
        for _ in range(8):
            register = ((register << 1) ^ _CRC8_POLYNOMIAL if register & 0x80 else register << 1) & 0xFF
        return register

    return tuple(shifted(register) for register in range(256))


def _crc8(register: int, data: bytes | bytearray) -> int:
    # 0.3 µs for a frame; crccheck's own loop, against which the tests hold it, takes 5 µs.
    table = _crc8_table()
    for byte in data:
        register = table[register ^ byte]
    return register
