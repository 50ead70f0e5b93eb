"""Common parts of all lidar protocols."""

from typing import NamedTuple, Protocol

import msgspec


class Point(NamedTuple):
    """One measurement, as the sensor reports it."""

    angle_rad: float
    """Counter-clockwise from the sensor's front, not wrapped to any interval."""
    range_m: float
    """0 if nothing came back."""


class Piece(NamedTuple):
    """Points that were measured in sequence."""

    points: list[Point]
    ends_turn: bool
    """Whether the sensor passes its front after them."""


class LineCounts(msgspec.Struct, frozen=True):
    """Counters of a decoder."""

    packets: int = 0
    bad_checksums: int = 0
    stray_bytes: int = 0
    """Bytes that belong to no packet."""

    def plus(self, packets: int, stray_bytes: int, bad_checksums: int = 0) -> "LineCounts":
        """The counters after further input."""
        return LineCounts(self.packets + packets, self.bad_checksums + bad_checksums, self.stray_bytes + stray_bytes)


class LidarDecoder(Protocol):
    """Bytes in, points out."""

    counts: LineCounts

    def feed(self, data: bytes) -> list[Piece]:
        """Decode bytes as they came; returns the points that they complete."""

    def ask_again(self) -> None:
        """The sensor is silent: ask once more, if it has to be asked."""

    def to_write(self) -> bytes:
        """Bytes to send to the sensor now; empty if there are none."""
