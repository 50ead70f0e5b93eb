"""Any frame of a DBC file: named signals, with a counter and a checksum if the sender has them."""

import math
from pathlib import Path
from typing import Any

import cantools

from robrain.plugins.device.mocdevice.frame_map import Checksum
from robrain.protocol.can.frames import BadFrame, FrameCodec, crc8_j1850, database
from robrain.protocol.can.payload import EXTENDED

DBC_BYTES_MAX = 4_000_000
BYTE_ORDER_MARK = b"\xef\xbb\xbf".decode("latin-1")


class SignalFrame:
    """Packs and unpacks the named signals of one frame.

    Args:
        message: the frame, as cantools read it.
        signals: names in the order of `encode` and `decode`.
        counter: name of its counter; empty if it has none.
        checksum: in its last byte.

    Raises:
        ValueError: the frame has no such signal.

    """

    def __init__(self, message: Any, signals: tuple[str, ...], counter: str, checksum: Checksum) -> None:
        known = {signal.name: signal for signal in message.signals}
        for name in (*signals, *([counter] if counter else [])):
            if name not in known:
                raise ValueError(f"{message.name} has no signal {name}; it has {', '.join(known)}")
        self.name: str = message.name
        self.arbitration_id: int = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        self.bits = tuple(known[name].length for name in signals)
        self._message, self._signals, self._counter, self._checksum = message, signals, counter, checksum
        self._start = message.frame_id.to_bytes(4, "big")[2:] if checksum is Checksum.CRC8_J1850_ID else b""

    def encode(self, counter: int, *values: float) -> bytes:
        """The frame's bytes (OverflowError if a value does not fit)."""
        signals = {signal.name: 0.0 for signal in self._message.signals}
        signals |= dict(zip(self._signals, values, strict=True))
        if self._counter:
            signals[self._counter] = counter & 0xFF
        try:
            data: bytes = self._message.encode(signals, scaling=True, padding=False, strict=True)
        except (cantools.database.errors.Error, ValueError) as error:
            raise OverflowError(f"{self.name}: {error}") from error
        if self._checksum is Checksum.NONE:
            return data
        return data[:-1] + bytes((self._sum(data[:-1]),))

    def decode(self, data: bytes) -> tuple[float, ...]:
        """The values of the signals, then the counter if it has one (BadFrame: wrong length or checksum)."""
        if len(data) != self._message.length:
            raise BadFrame(f"{self.name}: expected {self._message.length} bytes, got {len(data)}")
        if self._checksum is not Checksum.NONE and data[-1] != self._sum(data[:-1]):
            raise BadFrame(f"{self.name}: wrong checksum")
        try:
            found = self._message.decode(data, decode_choices=False, scaling=True)
        except (cantools.database.errors.Error, ValueError) as error:
            raise BadFrame(f"{self.name}: {error}") from error
        names = (*self._signals, self._counter) if self._counter else self._signals
        try:
            values = tuple([float(found[name]) for name in names])
        except KeyError as error:
            raise BadFrame(f"{self.name}: no signal {error} in this frame") from error
        if not all(map(math.isfinite, values)):
            raise BadFrame(f"{self.name}: expected finite values, got {values}")
        return values

    def _sum(self, data: bytes) -> int:
        if self._checksum is Checksum.XOR8:
            total = 0
            for byte in data:
                total ^= byte
            return total
        return sum(data) & 0xFF if self._checksum is Checksum.SUM8 else crc8_j1850(self._start + data)


def read_dbc(path: str) -> Any:
    """A DBC file, as cantools reads it.

    Args:
        path: of the file, or the name of one that comes with robrain.

    Raises:
        ValueError: it cannot be read, or is no DBC file.

    """
    file = Path(path).expanduser()
    try:
        if path.isidentifier():
            return database(path)
        if file.stat().st_size > DBC_BYTES_MAX:
            raise ValueError(f"dbc: expected at most {DBC_BYTES_MAX} bytes, {path} is larger")
        text = file.read_text(encoding="latin-1").removeprefix(BYTE_ORDER_MARK)
        return cantools.database.load_string(text, "dbc")
    except OSError as error:
        raise ValueError(f"dbc: cannot read {path}: {error.strerror}") from error
    except (cantools.database.errors.Error, ValueError) as error:
        raise ValueError(f"dbc: {path} is no DBC file: {error}") from error


def signal_frame(
    dbc: Any, frame: str, signals: tuple[str, ...], counter: str, checksum: Checksum
) -> "FrameCodec | SignalFrame":
    """The codec of a frame: a FrameCodec, a tenth of cantools' time, if the frame is laid out like the Robertino's.

    Raises:
        ValueError: there is no such frame or signal.

    """
    try:
        message = dbc.get_message_by_name(frame)
    except KeyError:
        known = ", ".join(message.name for message in dbc.messages)
        raise ValueError(f"there is no frame {frame} in the DBC file; it has {known}") from None
    is_plain = checksum is Checksum.CRC8_J1850_ID and counter == "counter" and not message.is_extended_frame
    names = tuple(signal.name for signal in message.signals)
    if is_plain and names == (*signals, "counter", "checksum"):
        try:
            return FrameCodec(message)
        except ValueError:
            pass  # not whole bytes one after the other: cantools packs it
    return SignalFrame(message, signals, counter, checksum)
