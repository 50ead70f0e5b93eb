"""A base whose motor controller is on a serial line: lines by the manifest, or frames by a codec class."""

import importlib
from collections.abc import Callable, Sequence, Sized
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.algorithms.navigation.wheel_bases import Ackermann, Differential, WheelBase
from robrain.plugins.device.mocdevice.errors import BusFault, MotionFault
from robrain.plugins.device.mocdevice.frame_clock import StampedAt
from robrain.plugins.device.mocdevice.interface import ControllerStatus, Counters
from robrain.plugins.device.mocdevice.odometry import Counting
from robrain.plugins.device.mocdevice.wheel_device import OpenLink, WheelDevice
from robrain.plugins.device.mocdevice.wheel_link import WheelReport
from robrain.plugins.device.serial_base.line_codec import LineWords, WheelCodec, WheelLineCodec
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.model.geometry import Twist2D
from robrain.protocol.model.ranges import check_positive
from robrain.protocol.serial.serial_line import SerialLine

NOISE_NS = to_ns(2.0)
"""Bytes without counts for this long are a fault."""


class SerialBase(WheelDevice):
    """Turns velocities into lines or frames on a serial line, and counts into odometry."""

    class Parameters(WheelDevice.Parameters, msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
        """The line, and what is spoken on it."""

        base: WheelBase = Differential(wheel_radius_m=0.033, track_m=0.16, encoder_ticks_per_turn=1440)
        port: str = "/dev/base"
        baud: int = 57_600
        period_s: float = 0.05
        """Period of the counts: how often they are asked for, or come."""
        start_s: float = 3.0
        """How long the controller may be silent after its line was opened; many boards start again then."""
        lines: LineWords = LineWords()
        """What is said and heard."""
        codec: Annotated[str, Meta(max_length=200)] = ""
        """`module:Class` of a codec of one's own instead of `lines`; it is made with the base."""
        count_bits: Annotated[int, Meta(ge=8, le=64)] = 32
        """With `codec`: length at which its counts wrap."""

        def __post_init__(self) -> None:
            super().__post_init__()
            check_positive(self, "baud", below=10_000_000)
            check_positive(self, "period_s", below=1.0)
            check_positive(self, "start_s", below=60.0)

    parameters: Parameters

    def init(self) -> None:
        super().init()
        self.period_s = min(self.period_s, self.parameters.period_s)

    def open_link(self) -> OpenLink:
        wanted, base = self.parameters, self.parameters.base
        bits = wanted.lines.count_bits
        if wanted.codec:
            made: WheelCodec = _codec_class(wanted.codec)(base)
            bits = wanted.count_bits
        else:
            commands = len(base.commands(Twist2D(), wanted.wheel_speed_max_rad_s))
            are_wheels = not isinstance(base, Ackermann)
            made = WheelLineCodec(wanted.lines, commands, base.wheels, base.wheel_radius_m, are_wheels=are_wheels)
        line = self.env.open_serial(wanted.port, wanted.baud)
        link = WheelSerialLink(line, made, self.env.plugin, wanted, self.env.clock.now_ns)
        where = f"the controller at {wanted.port} is silent, or what it says is not understood"
        counting = Counting(1 << bits, base.rad_per_tick)
        return OpenLink(link, where, counting, wanted.period_s, StampedAt.ARRIVAL, start_s=wanted.start_s)


def _codec_class(path: str) -> Callable[[WheelBase], WheelCodec]:
    module, _, name = path.partition(":")
    try:
        made: Callable[[WheelBase], WheelCodec] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"codec: expected module:Class that can be imported, got {path!r}: {error}") from error
    return made


class WheelSerialLink:
    """See WheelLink.

    Args:
        line: closed with the link.
        codec: of the controller.
        plugin: the device, named in faults.
        wanted: port, baud rate, the period of counts and the time that the controller needs to start.
        now_ns: the robot's clock.

    """

    pending: Sized = (None,)

    def __init__(
        self, line: SerialLine, codec: WheelCodec, plugin: str, wanted: SerialBase.Parameters, now_ns: Callable[[], int]
    ) -> None:
        self.status: ControllerStatus | None = None
        self.statuses, self.has_failed = 0, False
        self.broken: MotionFault | None = None
        self._line, self._codec, self._plugin, self._port = line, codec, plugin, wanted.port
        self._now_ns, self._period_ns, self._baud = now_ns, to_ns(wanted.period_s), wanted.baud
        self._asked_ns: int | None = None
        self._bytes = 0
        """Bytes since the last report."""
        self._started_ns = now_ns() + to_ns(wanted.start_s)
        self._noise_ns = 0
        """When the first of these bytes came, once the controller has had time to start."""
        self._is_cut = False
        """Whether the line has taken only a part of what was written last."""

    def command(self, values: Sequence[float]) -> None:
        """As WheelLink."""
        self._write(self._codec.command(values))

    def stop(self) -> None:
        """As WheelLink; behind a command that was cut off the first one may be lost."""
        was_cut, stop = self._is_cut, self._codec.stop()
        self._write(stop * 2 if was_cut else stop)

    def take(self) -> list[WheelReport]:
        """As WheelLink; the counts are asked for when it is time."""
        if self.broken is not None:
            return []
        now_ns = self._now_ns()
        try:
            data = self._line.read()
        except OSError as error:
            self._lose(error)
            return []
        counts = self._codec.feed(data)
        if not self._bytes:
            self._noise_ns = max(now_ns, self._started_ns)
        self._bytes = 0 if counts else self._bytes + len(data)
        if data and now_ns - self._noise_ns > NOISE_NS and self._bytes:
            took_s = to_seconds(now_ns - self._noise_ns)
            self.broken = BusFault(self._plugin, f"no counts for {took_s:.1f} s: {self.refusal}")
            return []
        if self._asked_ns is None or not 0 <= now_ns - self._asked_ns < self._period_ns:
            self._asked_ns = now_ns
            if asks := self._codec.poll():
                self._write(asks)
        return [WheelReport(each, now_ns) for each in counts]

    @property
    def refusal(self) -> str:
        """As WheelLink."""
        what = f"no counts: check the baud rate ({self._baud}), the wiring and `lines` or `codec`"
        return f"{self._bytes} bytes came from {self._port}, but {what}" if self._bytes else ""

    def counters(self, believed: int, rejected: int) -> Counters:
        """As WheelLink."""
        return Counters(believed, rejected + self._codec.rejected, 0, 0, 0)

    def close(self) -> None:
        """As WheelLink."""
        self._line.close()

    def _write(self, data: bytes) -> None:
        try:
            self._is_cut = not self._line.write(data)
        except OSError as error:
            self._lose(error)

    def _lose(self, error: OSError) -> None:
        self.broken = BusFault(self._plugin, f"the serial line {self._port} is lost: {error}")
