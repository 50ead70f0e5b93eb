"""Motor controllers that speak lines of text, as those of many Arduino bases do: `m 120 120`, `e`, `1023 998`.

The words are the manifest's. A class of one's own with the functions of WheelCodec serves for anything else.
"""

import re
import string
from collections.abc import Sequence
from typing import Annotated, Protocol

import msgspec
from msgspec import Meta

from robrain.plugins.device.mocdevice.frame_map import SIGNALS_MAX, Sign, SignalUnit

LINE_BYTES_MAX = 256
"""A longer line is none."""
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
        """Take in bytes as they came; the counts of all wheels in each report that they complete."""


class LineWords(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The lines; by default those of ROSArduinoBridge, with speeds in counts per cycle of its loop of 30 Hz.

    Raises ValueError for words that no line can be made of.
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
    """-1 for a wheel that is mounted the other way round, for commands and counts; of a car for counts alone."""
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
        units = words.units * commands if len(words.units) == 1 else words.units
        self._signs = words.signs * wheels if len(words.signs) == 1 else words.signs
        signs = given_signs * commands if len(given_signs) == 1 else given_signs
        self._factors = [
            sign * words.scale * unit.per_si(wheel_radius_m) for unit, sign in zip(units, signs, strict=True)
        ]
        try:
            self.command([0.0] * commands)
        except (IndexError, ValueError) as error:
            raise ValueError(f"lines.command: {error}, for {commands} values") from error
        self._left = b""
        self._skips = not words.poll
        """Whether what comes until the next ending is the rest of a line: one that was given up, or the first one of a
        controller that sends by itself, which may have begun before it was heard."""
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
        *lines, self._left = (self._left + data).replace(b"\r", b"\n").split(b"\n")
        if lines and self._skips:
            del lines[0]
            self._skips = False
        if self._skips:
            self._left = b""
        elif len(self._left) > LINE_BYTES_MAX:
            self._left, self._skips = b"", True
            self.rejected += 1
        for line in lines:
            if len(line) > LINE_BYTES_MAX:
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
