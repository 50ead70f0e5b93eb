"""Measurements as lines of text, such as a microcontroller prints them: numbers between separators."""

import math
from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.plugins.device.imu.imu_codec import Motion

LINE_BYTES_MAX = 256
Column = Annotated[int, Meta(ge=0, le=63)]


class RateUnit(StrEnum):
    """Of a turn rate."""

    RAD_S = "rad/s"
    DEG_S = "deg/s"


class LineChecksum(StrEnum):
    """At a line's end."""

    NONE = "none"
    NMEA = "nmea"
    """`*` and two hexadecimal digits: the bytes between `$` and `*` by XOR."""


class LineFormat(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the lines look."""

    prefix: Annotated[str, Meta(max_length=32)] = ""
    """Lines that begin otherwise are ignored; columns are counted from behind it."""
    separator: Annotated[str, Meta(min_length=1, max_length=4)] = ","
    columns: Annotated[int, Meta(ge=0, le=64)] = 0
    """Number of columns of a line; any other is rejected. 0: any that has those named here."""
    yaw_rate_column: Column = 0
    """The first column is 0."""
    yaw_rate_unit: RateUnit = RateUnit.RAD_S
    acceleration_columns: tuple[Column, Column] | None = None
    """Of x and y in m/s²; none if absent."""
    checksum: LineChecksum = LineChecksum.NONE


class LineCodec:
    """See ImuCodec.

    Args:
        wanted: how the lines look.

    """

    def __init__(self, wanted: LineFormat) -> None:
        self.rejected = self.stray_bytes = 0
        self._wanted = wanted
        self._prefix, self._separator = wanted.prefix.encode(), wanted.separator.encode()
        self._left = b""
        self._skips = True
        """Until the next line begins: the first one may have begun before it was heard."""

    def feed(self, data: bytes) -> list[Motion]:
        """As ImuCodec."""
        *lines, left = (self._left + data).split(b"\n")
        found = []
        for line in lines:
            if self._skips:
                self.stray_bytes += len(line)
                self._skips = False
            elif len(line) > LINE_BYTES_MAX:
                self.rejected += 1
            elif (motion := self._read(line.strip())) is not None:
                found.append(motion)
        if len(left) > LINE_BYTES_MAX:
            self.stray_bytes += len(left)
            left, self._skips = b"", True
        self._left = left
        return found

    def _read(self, line: bytes) -> Motion | None:
        wanted = self._wanted
        if not line.startswith(self._prefix) or not line:
            return None
        try:
            words = self._checked(line)[len(self._prefix) :].split(self._separator)
            if wanted.columns and len(words) != wanted.columns:
                raise ValueError
            rate = _number(words[wanted.yaw_rate_column])
            accelerations = [_number(words[column]) for column in wanted.acceleration_columns or ()]
        except (ValueError, IndexError):
            self.rejected += 1
            return None
        return Motion(math.radians(rate) if wanted.yaw_rate_unit is RateUnit.DEG_S else rate, *accelerations)

    def _checked(self, line: bytes) -> bytes:
        """The line without its checksum (ValueError if that is wrong)."""
        if self._wanted.checksum is LineChecksum.NONE:
            return line
        body, star, digits = line.rpartition(b"*")
        total = 0
        for byte in body.removeprefix(b"$"):
            total ^= byte
        if not star or len(digits) != 2 or int(digits, 16) != total:
            raise ValueError
        return body


def _number(word: bytes) -> float:
    value = float(word)
    if not math.isfinite(value):
        raise ValueError
    return value
