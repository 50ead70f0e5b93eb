"""Which frames and signals of a DBC file carry the commands, counts and status of a base.

The defaults are those of the Robertino's controller (`protocol/can/robertino.dbc`).
"""

import copy
import math
from collections.abc import Sequence
from enum import StrEnum
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import cantools
import msgspec
from cantools.database.can import Message
from msgspec import Meta

from robrain.protocol.can.frames import BadFrame, FrameCodec, crc8_j1850, database
from robrain.protocol.can.payload import EXTENDED
from robrain.protocol.model.checked import Checked

SIGNALS_MAX = 8
Sign = Literal[1, -1]
SignalName = Annotated[str, Meta(min_length=1, max_length=128)]
FrameOrNone = Annotated[str, Meta(max_length=128)]
Signals = Annotated[tuple[SignalName, ...], Meta(min_length=1, max_length=SIGNALS_MAX)]


T = TypeVar("T")


class SignalUnit(StrEnum):
    """Of a signal."""

    RAD_S = "rad/s"
    RPM = "rpm"
    TURNS_S = "turns/s"
    M_S = "m/s"
    """Of the wheel's tread."""
    RAD = "rad"
    """Of a steering angle."""
    DEG = "deg"

    def per_si(self, wheel_radius_m: float) -> float:
        """A value in this unit for 1 rad/s of a wheel, or 1 rad of a steering angle."""
        return {
            SignalUnit.RPM: 60.0 / math.tau,
            SignalUnit.TURNS_S: 1.0 / math.tau,
            SignalUnit.M_S: wheel_radius_m,
            SignalUnit.DEG: math.degrees(1.0),
        }.get(self, 1.0)


def each_of(values: tuple[T, ...], number: int) -> tuple[T, ...]:
    """A value for each of this number of signals, from one for all or one for each."""
    return values * number if len(values) == 1 else values


class Checksum(StrEnum):
    """Of the bytes before the last, in the last byte."""

    NONE = "none"
    CRC8_J1850_ID = "crc8_j1850_id"
    """CRC-8 SAE J1850 over the identifier (two bytes, the higher first) and the data."""
    CRC8_J1850 = "crc8_j1850"
    XOR8 = "xor8"
    SUM8 = "sum8"


class FrameSignals(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One frame, with a signal for each wheel in it."""

    frame: SignalName
    signals: Signals
    units: tuple[SignalUnit, ...] = (SignalUnit.RAD_S,)
    """One for each signal, or one for all."""
    signs: tuple[Sign, ...] = (1,)
    """-1 for a wheel whose motor or encoder turns in reverse; one for each signal, or one for all."""

    def __post_init__(self) -> None:
        for name in ("units", "signs"):
            if len(getattr(self, name)) not in (1, len(self.signals)):
                raise ValueError(f"expected 1 or {len(self.signals)} {name}, got {len(getattr(self, name))}")


class StopFrame(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The frame that stops the wheels at once; signals that are not named are 0."""

    frame: FrameOrNone
    """Empty if there is none: the commands are then all 0."""
    values: dict[SignalName, float] = {}


class StatusFrame(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The frame in which the controller reports its state."""

    frame: FrameOrNone
    """Empty if there is none."""
    state: SignalName = "state"
    failed: tuple[int, ...] = (3,)
    """Values of `state` that mean that the power stage has failed."""


class FrameMap(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Parameters, including those that the frames have in common."""

    dbc: Annotated[str, Meta(min_length=1, max_length=4096)] = "robertino"
    """Path of the DBC file; or `robertino`, `two_wheels`, `four_wheels` or `car`, which come with robrain."""
    commands: Annotated[tuple[FrameSignals, ...], Meta(min_length=1, max_length=SIGNALS_MAX)] = (
        FrameSignals(frame="WheelCommand", signals=("wheel_1_rad_s", "wheel_2_rad_s", "wheel_3_rad_s")),
    )
    """Frames that are sent, one after the other; their signals together are the base's commands in order."""
    encoders: Annotated[tuple[FrameSignals, ...], Meta(min_length=1, max_length=SIGNALS_MAX)] = (
        FrameSignals(frame="WheelEncoders", signals=("wheel_1_ticks", "wheel_2_ticks", "wheel_3_ticks")),
    )
    """Frames that are received, in any order; together they are the counts. `units` are for `measure = "speed"`."""
    measure: Literal["counts", "speed"] = "counts"
    """Of an encoder signal. Counts wrap with its length. Speeds are added up by the frames' times, which is less
    exact, as the speed between two frames is not known."""
    stop: StopFrame = StopFrame(frame="Stop", values={"latched": 0})
    status: StatusFrame = StatusFrame(frame="MotorStatus")
    counter: str = "counter"
    """Name of the signal that counts a sender's frames, 8 bits; empty if there is none."""
    checksum: Checksum = Checksum.CRC8_J1850_ID
    encoder_period_s: Annotated[float, Meta(gt=0, lt=10.0)] = 0.02
    """Period of the encoder frames."""


DBC_BYTES_MAX = 4_000_000
BYTE_ORDER_MARK = b"\xef\xbb\xbf".decode("latin-1")


class OtherPart(BadFrame):
    """A valid frame whose multiplexer selects other signals."""


class SignalFrame:
    """Packs and unpacks the named signals of one frame; where it is multiplexed, those that occur together.

    Args:
        message: the frame, as cantools read it.
        signals: names in the order of `encode` and `decode`.
        counter: name of its counter; empty if it has none.
        checksum: in its last byte.

    Raises:
        ValueError: the frame has no such signal, or the signals cannot be used together.

    """

    def __init__(self, message: Any, signals: tuple[str, ...], counter: str, checksum: Checksum) -> None:
        known = {signal.name: signal for signal in message.signals}
        for name in (*signals, *([counter] if counter else [])):
            if name not in known:
                raise ValueError(f"{message.name} has no signal {name}; it has {', '.join(known)}")
        self.name: str = message.name
        self.arbitration_id: int = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        self.bits = tuple(known[name].length for name in signals)
        self.signals = signals
        self._message, self._selected = _sound(message, (*signals, counter) if counter else signals)
        self._counter, self._checksum = counter, checksum
        self._start = message.frame_id.to_bytes(4, "big")[2:] if checksum is Checksum.CRC8_J1850_ID else b""

    def encode(self, counter: int, *values: float) -> bytes:
        """The frame's bytes (OverflowError if a value does not fit)."""
        signals = {signal.name: 0.0 for signal in self._message.signals}
        signals |= {name: float(min(ids)) for name, ids in self._selected.items()}
        signals |= dict(zip(self.signals, values, strict=True))
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
        for name, ids in self._selected.items():
            if found[name] not in ids:
                raise OtherPart(f"{self.name}: its {name} is {found[name]}: other signals")
        names = (*self.signals, self._counter) if self._counter else self.signals
        values = tuple([float(found[name]) for name in names])
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
        return cantools.database.load_string(text, "dbc", strict=False)
    except OSError as error:
        raise ValueError(f"dbc: cannot read {path}: {error.strerror}") from error
    except (cantools.database.errors.Error, ValueError) as error:
        raise ValueError(f"dbc: {path} is no DBC file: {error}") from error


def signal_frames(
    dbc: Any, frame: str, signals: tuple[str, ...], counter: str, checksum: Checksum
) -> "list[FrameCodec | SignalFrame]":
    """The codecs of a frame, one for each run of signals that its multiplexer selects together.

    A frame that is laid out like the Robertino's has a FrameCodec, which takes a tenth of cantools' time.

    Raises:
        ValueError: there is no such frame or signal, or the signals cannot be used together.

    """
    try:
        message = dbc.get_message_by_name(frame)
    except KeyError:
        known = ", ".join(message.name for message in dbc.messages)
        raise ValueError(f"there is no frame {frame} in the DBC file; it has {known}") from None
    selectors = {signal.name: signal.multiplexer_ids for signal in message.signals}
    runs = [tuple(run) for _, run in groupby(signals, selectors.get)]
    is_plain = checksum is Checksum.CRC8_J1850_ID and counter == "counter" and not message.is_extended_frame
    if is_plain and len(runs) == 1 and tuple(selectors) == (*signals, "counter", "checksum"):
        try:
            return [FrameCodec(message)]
        except ValueError:
            pass  # not whole bytes one after the other: cantools packs it
    return [SignalFrame(message, run, counter, checksum) for run in runs]


def _sound(message: Any, names: Sequence[str]) -> tuple[Any, dict[str, set[int]]]:
    """The frame with signals that can be packed and unpacked, and the values of its multiplexers for these signals.

    Args:
        message: the frame, as cantools read it.
        names: the signals that are used.

    Raises:
        ValueError: one of them does not fit into the frame, two overlap, or a frame never has both.

    """
    known = {signal.name: signal for signal in message.signals}
    selected: dict[str, set[int]] = {}
    for name in names:
        signal = known[name]
        while signal.multiplexer_ids is not None:
            selector = signal.multiplexer_signal
            selected[selector] = selected.get(selector, set(signal.multiplexer_ids)) & set(signal.multiplexer_ids)
            if not selected[selector]:
                raise ValueError(
                    f"{message.name}: no frame has all of {', '.join(names)}: {selector} selects among them"
                )
            signal = known[selector]
    used = [_alone(known[name]) for name in dict.fromkeys((*selected, *names))]
    for signals in (used,) if message.is_multiplexed() else (message.signals, used):
        try:
            whole = Message(
                message.frame_id, message.name, message.length, signals, is_extended_frame=message.is_extended_frame,
                is_fd=message.is_fd,
            )  # fmt: skip
        except cantools.database.errors.Error as error:
            if signals is used:
                raise ValueError(f"{message.name}: {error}") from error
        else:
            return whole, selected
    raise AssertionError("the last of the two returns or raises")


def _alone(signal: Any) -> Any:
    """A signal that no multiplexer selects."""
    alone = copy.copy(signal)
    alone.is_multiplexer, alone.multiplexer_ids, alone.multiplexer_signal = False, None, None
    return alone
