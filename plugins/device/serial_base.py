"""A base whose motor controller is on a serial line: lines by the manifest's words, or frames by a codec class."""

import importlib
import re
import string
from collections.abc import Callable, Sequence
from typing import Annotated, Protocol

import msgspec
from msgspec import Meta

from robrain.algorithms.navigation.wheel_bases import Ackermann, Differential, WheelBase
from robrain.plugins.device.mocdevice.frame_clock import StampedAt
from robrain.plugins.device.mocdevice.frame_map import SIGNALS_MAX, Sign, SignalUnit, each_of
from robrain.plugins.device.mocdevice.interface import BusFault, Counters
from robrain.plugins.device.mocdevice.wheel_device import Counting, OpenLink, WheelDevice, WheelLink, WheelReport
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.line_splitter import LineSplitter
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Twist2D
from robrain.protocol.serial.serial_line import SerialLine

LINE_BYTES_MAX = 256
"""A longer line is discarded."""
Words = Annotated[str, Meta(max_length=200)]


class WheelCodec(Protocol):
    """Bytes of a motor controller on a serial line."""

    rejected: int
    """Lines or frames that were not understood."""

    def command(self, values: Sequence[float]) -> bytes:
        """The base's commands: wheel speeds in rad/s (of a car: rear wheel speed in rad/s, steering angle in rad)."""

    def stop(self) -> bytes:
        """Stop the wheels at once."""

    def poll(self) -> bytes:
        """Ask for the counts; empty if the controller sends them by itself."""

    def feed(self, data: bytes) -> list[tuple[int, ...]]:
        """Read bytes as they came; returns the counts of all wheels in each report that they complete."""


class LineWords(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The lines; by default those of ROSArduinoBridge, with speeds in counts per cycle of its loop of 30 Hz.

    Raises ValueError for invalid words.
    """

    command: Words = "m {0:.0f} {1:.0f}"
    """Python's format of the command, {0} for the first wheel."""
    stop: Words = "m 0 0"
    poll: Words = "e"
    """Question for the counts; empty if they come by themselves."""
    report: Words = r"(-?\d+) (-?\d+)"
    """Regular expression of a whole line with counts, a group for each wheel."""
    ending: Annotated[str, Meta(min_length=1, max_length=2)] = "\r"
    """Of lines that are sent; those that are received may end with any."""
    units: Annotated[tuple[SignalUnit, ...], Meta(min_length=1, max_length=SIGNALS_MAX)] = (SignalUnit.RAD_S,)
    """Of the commands: one for all, or one for each."""
    scale: float = 1.0
    """A value in the command for one in that unit: counts per turn / 30 for ROSArduinoBridge with `turns/s`."""
    signs: Annotated[tuple[Sign, ...], Meta(min_length=1, max_length=SIGNALS_MAX)] = (1,)
    """-1 for a wheel that is mounted in reverse, for commands and counts; of a car for counts alone."""
    command_signs: Annotated[tuple[Sign, ...], Meta(max_length=SIGNALS_MAX)] = ()
    """Of the commands, one for all or one for each; those of `signs` if empty, of a car 1."""
    count_bits: Annotated[int, Meta(ge=8, le=64)] = 32
    """Counts wrap at this length."""

    def __post_init__(self) -> None:
        try:
            re.compile(self.report)
            fields = [field for _, field, _, _ in string.Formatter().parse(self.command) if field is not None]
        except (re.error, ValueError) as error:
            raise ValueError(f"expected a regular expression and a format, got: {error}") from error
        if not fields or not all(field.isdigit() for field in fields):
            raise ValueError(f"command: expected fields such as {{0:.1f}}, got {self.command!r}")
        for words in (self.command, self.stop, self.poll):
            if not words.isascii() or "\n" in words or "\r" in words:
                raise ValueError(f"expected one line of ASCII, got {words!r}")


class WheelLineCodec:
    """See WheelCodec.

    Args:
        words: the lines.
        commands: number of values of a command.
        wheels: number of counts in a report.
        wheel_radius_m: for speeds along the tread.
        are_wheels: whether the commands are for the wheels that count, in their order.

    Raises:
        ValueError: the words are for another number of wheels.

    """

    def __init__(
        self, words: LineWords, commands: int, wheels: int, wheel_radius_m: float, *, are_wheels: bool = True
    ) -> None:
        self.rejected = 0
        self._words, self._report = words, re.compile(words.report.encode())
        if self._report.groups != wheels:
            raise ValueError(f"lines.report: expected {wheels} groups for this base, got {self._report.groups}")
        given_signs = words.command_signs or (words.signs if are_wheels else (1,))
        for what, given, number in (
            ("units", words.units, commands),
            ("signs", words.signs, wheels),
            ("command_signs", given_signs, commands),
        ):
            if len(given) not in (1, number):
                raise ValueError(f"lines.{what}: expected 1 or {number}, got {len(given)}")
        self._signs = each_of(words.signs, wheels)
        self._factors = [
            sign * words.scale * unit.per_si(wheel_radius_m)
            for unit, sign in zip(each_of(words.units, commands), each_of(given_signs, commands), strict=True)
        ]
        try:
            self.command([0.0] * commands)
        except (IndexError, ValueError) as error:
            raise ValueError(f"lines.command: {error}, for {commands} values") from error
        self._splitter = LineSplitter(LINE_BYTES_MAX, skips_first=not words.poll)
        self._modulus = 1 << words.count_bits

    def command(self, values: Sequence[float]) -> bytes:
        """As WheelCodec."""
        words = [factor * value + 0.0 for factor, value in zip(self._factors, values, strict=True)]
        return self._line(self._words.command.format(*words))

    def stop(self) -> bytes:
        """As WheelCodec."""
        return self._line(self._words.stop)

    def poll(self) -> bytes:
        """As WheelCodec."""
        return self._line(self._words.poll) if self._words.poll else b""

    def feed(self, data: bytes) -> list[tuple[int, ...]]:
        """As WheelCodec. Lines that are no report, such as `OK`, are passed over; those too long are rejected."""
        reports = []
        for line in self._splitter.feed(data.replace(b"\r", b"\n")):
            if line is None:
                self.rejected += 1
            elif found := self._report.fullmatch(line.strip()):
                try:
                    counts = [int(group) for group in found.groups()]
                except (TypeError, ValueError):
                    self.rejected += 1
                    continue
                reports.append(
                    tuple([sign * count % self._modulus for sign, count in zip(self._signs, counts, strict=True)])
                )
            elif line.strip():
                self.rejected += not _is_plain(line)
        return reports

    def _line(self, words: str) -> bytes:
        return f"{words}{self._words.ending}".encode()


def _is_plain(line: bytes) -> bool:
    """Whether a line is printable text, such as an acknowledgement or a greeting."""
    return all(32 <= byte < 127 or byte == 9 for byte in line)


NOISE_NS = to_ns(2.0)
"""Bytes without counts for this long are a fault."""


class SerialBase(WheelDevice):
    """Turns velocities into lines or frames on a serial line, and counts into odometry."""

    class Parameters(WheelDevice.Parameters, Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
        """The line, and its protocol."""

        base: WheelBase = Differential(wheel_radius_m=0.033, track_m=0.16, encoder_ticks_per_turn=1440)
        port: str = "/dev/base"
        baud: Annotated[int, Meta(ge=1, le=9_999_999)] = 57_600
        period_s: Annotated[float, Meta(gt=0, lt=1.0)] = 0.05
        """Period of the counts: how often they are asked for, or come."""
        start_s: Annotated[float, Meta(gt=0, lt=60.0)] = 3.0
        """How long the controller may be silent after its line was opened; many boards start again then."""
        lines: LineWords = LineWords()
        """Texts of the commands and replies."""
        codec: Annotated[str, Meta(max_length=200)] = ""
        """`module:Class` of a custom codec instead of `lines`; it is made with the base."""
        count_bits: Annotated[int, Meta(ge=8, le=64)] = 32
        """With `codec`: length at which its counts wrap."""

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


class WheelSerialLink(WheelLink):
    """See WheelLink.

    Args:
        line: closed with the link.
        codec: of the controller.
        plugin: the device, named in faults.
        wanted: port, baud rate, the period of counts and the time that the controller needs to start.
        now_ns: the robot's clock.

    """

    def __init__(
        self, line: SerialLine, codec: WheelCodec, plugin: str, wanted: SerialBase.Parameters, now_ns: Callable[[], int]
    ) -> None:
        self._line, self._codec, self._plugin, self._port = line, codec, plugin, wanted.port
        self._now_ns, self._period_ns, self._baud = now_ns, to_ns(wanted.period_s), wanted.baud
        self._asked_ns: int | None = None
        self._bytes = 0
        """Bytes since the last report."""
        self._started_ns = now_ns() + to_ns(wanted.start_s)
        self._noise_ns = 0
        """When the first of these bytes came, once the controller has had time to start."""
        self._is_cut = False
        """Whether the line has accepted only a part of the last write."""

    def command(self, values: Sequence[float]) -> None:
        """See `WheelLink`."""
        self._write(self._codec.command(values))

    def stop(self) -> None:
        """As WheelLink; behind a command that was cut off the first one may be lost."""
        was_cut, stop = self._is_cut, self._codec.stop()
        self._write(stop * 2 if was_cut else stop)

    def receive(self) -> list[WheelReport]:
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
            elapsed_s = to_seconds(now_ns - self._noise_ns)
            self.broken = BusFault(self._plugin, f"no counts for {elapsed_s:.1f} s: {self.refusal}")
            return []
        if self._asked_ns is None or not 0 <= now_ns - self._asked_ns < self._period_ns:
            self._asked_ns = now_ns
            if asks := self._codec.poll():
                self._write(asks)
        return [WheelReport(each, now_ns) for each in counts]

    @property
    def refusal(self) -> str:
        """See `WheelLink`."""
        what = f"no counts: check the baud rate ({self._baud}), the wiring and `lines` or `codec`"
        return f"{self._bytes} bytes came from {self._port}, but {what}" if self._bytes else ""

    def counters(self, believed: int, rejected: int) -> Counters:
        """See `WheelLink`."""
        return Counters(believed, rejected + self._codec.rejected, 0, 0, 0)

    def close(self) -> None:
        """See `WheelLink`."""
        self._line.close()

    def _write(self, data: bytes) -> None:
        try:
            self._is_cut = not self._line.write(data)
        except OSError as error:
            self._lose(error)

    def _lose(self, error: OSError) -> None:
        self.broken = BusFault(self._plugin, f"the serial line {self._port} is lost: {error}")
