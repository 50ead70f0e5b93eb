"""The frames of a base, ready to be packed and unpacked: what a `FrameMap` says of a DBC file, checked once."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from robrain.plugins.device.mocdevice.frame_map import FrameMap, FrameSignals, Measure
from robrain.plugins.device.mocdevice.interface import ControllerStatus
from robrain.plugins.device.mocdevice.signal_frame import SignalFrame, read_dbc, signal_frames
from robrain.protocol.can.frames import FrameCodec, known_identifiers
from robrain.protocol.can.payload import EXTENDED

STATUS_FIELDS = ControllerStatus.__struct_fields__
SPEED_TICKS_PER_RAD = 100_000
"""Speeds are added up in ticks of this size."""
SPEED_MODULUS = 1 << 48

Codec = FrameCodec | SignalFrame


class Wheels(NamedTuple):
    """A frame with the signals of wheels."""

    codec: Codec
    factors: tuple[float, ...]
    """Commands: a signal's value for a base's value of 1 in SI units; encoders: the other way round, or the sign of a
    count."""


class WheelFrames:
    """The codecs of a frame map, for one base.

    Args:
        wanted: the map.
        commands: number of values that the base is commanded by.
        wheels: number of wheels that count.
        wheel_radius_m: for units along the tread.

    Raises:
        ValueError: naming the key: the DBC file has no such frame or signal, or their number does not fit the base.

    """

    def __init__(self, wanted: FrameMap, commands: int, wheels: int, wheel_radius_m: float) -> None:
        dbc = read_dbc(wanted.dbc)
        is_speed = wanted.measure is Measure.SPEED

        def codecs(what: str, frame: str, signals: tuple[str, ...]) -> list[Codec]:
            try:
                return signal_frames(dbc, frame, signals, wanted.counter, wanted.checksum)
            except ValueError as error:
                raise ValueError(f"frames.{what}: {error}") from error

        def codec(what: str, frame: str, signals: tuple[str, ...]) -> Codec:
            found = codecs(what, frame, signals)
            if len(found) > 1:
                raise ValueError(f"frames.{what}: no frame {frame} has all of {', '.join(signals)}: it is multiplexed")
            return found[0]

        def wheels_of(what: str, frames: Sequence[FrameSignals], number: int, exponent: int) -> list[Wheels]:
            there = sum(len(one.signals) for one in frames)
            if there != number:
                raise ValueError(f"frames.{what}: expected {number} signals for this base, got {there}")
            parts = []
            for one in frames:
                factors = [
                    sign * unit.per_si(wheel_radius_m) ** exponent
                    for unit, sign in zip(_each(one.units, one), _each(one.signs, one), strict=True)
                ]
                for part in codecs(what, one.frame, one.signals):
                    parts.append(Wheels(part, tuple(factors[: len(part.signals)])))
                    del factors[: len(part.signals)]
            return parts

        self.commands = wheels_of("commands", wanted.commands, commands, 1)
        self.encoders = wheels_of("encoders", wanted.encoders, wheels, -1 if is_speed else 0)
        self.modulus = SPEED_MODULUS if is_speed else _modulus(self.encoders)
        """Counts wrap at this."""
        self.stop, self.stop_values = None, ()
        if wanted.stop.frame:
            names = tuple(wanted.stop.values)
            self.stop, self.stop_values = codec("stop", wanted.stop.frame, names), tuple(wanted.stop.values.values())
            _check_holds("stop.values", self.stop, self.stop_values)
        self.status, self.status_fields, self.failed = None, (), frozenset(())
        if wanted.status.frame:
            names = _status_signals(dbc, wanted.status.frame, wanted.status.state)
            self.status = codec("status", wanted.status.frame, names)
            self.status_fields = tuple("state" if name == wanted.status.state else name for name in names)
            self.failed = frozenset(wanted.status.failed)
        self.known = known_identifiers() | frozenset(
            message.frame_id | (EXTENDED if message.is_extended_frame else 0) for message in dbc.messages
        )
        """Identifiers of the frames in the DBC file, and of robrain's other devices on the bus."""
        self.has_counter, self.is_speed, self.period_s = bool(wanted.counter), is_speed, wanted.encoder_period_s

    stop: Codec | None
    stop_values: tuple[float, ...]
    status: Codec | None
    status_fields: tuple[str, ...]
    """Fields of ControllerStatus, in the order of the codec's values."""
    failed: frozenset[int]

    def check_limits(self, limits: Sequence[float]) -> None:
        """Raise ValueError, naming the keys, if the frames cannot hold commands of these sizes (SI units)."""
        begin = 0
        for wheels in self.commands:
            end = begin + len(wheels.factors)
            most = [factor * limit for factor, limit in zip(wheels.factors, limits[begin:end], strict=True)]
            for sign in (1.0, -1.0):
                _check_holds("commands, at wheel_speed_max_rad_s", wheels.codec, [sign * value for value in most])
            begin = end


def _check_holds(what: str, codec: Codec, values: Sequence[float]) -> None:
    try:
        codec.encode(0, *values)
    except (OverflowError, ValueError) as error:
        raise ValueError(f"frames.{what}: {error}") from error


def _each(values: tuple[Any, ...], frame: FrameSignals) -> tuple[Any, ...]:
    return values * len(frame.signals) if len(values) == 1 else values


def _modulus(encoders: Sequence[Wheels]) -> int:
    lengths = {bits for one in encoders for bits in one.codec.bits[: len(one.factors)]}
    if len(lengths) > 1:
        raise ValueError(f"frames.encoders: expected counts of one length, got {sorted(lengths)} bits")
    return 1 << lengths.pop()


def _status_signals(dbc: Any, frame: str, state: str) -> tuple[str, ...]:
    """The state, then the other signals whose names are those of ControllerStatus."""
    found = next((message for message in dbc.messages if message.name == frame), None)
    ids = {signal.name: signal.multiplexer_ids for signal in found.signals} if found is not None else {}
    together = [name for name in ids if ids[name] in (None, ids.get(state))]
    return (state, *(name for name in together if name in STATUS_FIELDS and name != state))
