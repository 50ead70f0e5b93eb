"""Which frames and signals of a DBC file carry the commands, counts and status of a base.

The defaults are those of the Robertino's controller (`protocol/can/robertino.dbc`).
"""

import math
from enum import StrEnum
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import check_positive

SIGNALS_MAX = 8
Sign = Literal[1, -1]
SignalName = Annotated[str, Meta(min_length=1, max_length=128)]
FrameOrNone = Annotated[str, Meta(max_length=128)]
Signals = Annotated[tuple[SignalName, ...], Meta(min_length=1, max_length=SIGNALS_MAX)]


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


class Counted(StrEnum):
    """What an encoder signal carries."""

    COUNTS = "counts"
    """Counts that wrap with the signal's length."""
    SPEED = "speed"
    """Speeds, which are added up by the frames' times; less exact, as the speed between two frames is not known."""


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
    """-1 for a wheel whose motor or encoder turns the other way; one for each signal, or one for all."""

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
    """Values of `state` that say that the power stage has failed."""


class FrameMap(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All of it, with what the frames have in common."""

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
    measure: Counted = Counted.COUNTS
    stop: StopFrame = StopFrame(frame="Stop", values={"latched": 0})
    status: StatusFrame = StatusFrame(frame="MotorStatus")
    counter: str = "counter"
    """Name of the signal that counts a sender's frames, 8 bits; empty if there is none."""
    checksum: Checksum = Checksum.CRC8_J1850_ID
    encoder_period_s: float = 0.02
    """Period of the encoder frames."""

    def __post_init__(self) -> None:
        check_positive(self, "encoder_period_s", below=10.0)
