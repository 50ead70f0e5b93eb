"""Lidar logs in the format of CARMEN: one message a line, of which odometry and scans are read.

| FLASER n [ranges] x y theta odom_x odom_y odom_theta STAMP host logger_stamp
| ROBOTLASER1 type start fov step range_max accuracy mode n [ranges] m [remissions]
|     laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv safety safety turn STAMP host logger_stamp
| ODOM x y theta tv rv accel STAMP host logger_stamp

Metres, radians, seconds; see http://carmen.sourceforge.net/logger_playback.html. Other messages are passed over.
"""

import math
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.deploy.errors import LogError
from robrain.protocol.model.geometry import Pose2D

BYTES_MAX = 1 << 28
LINE_BYTES_MAX = 1 << 17
LINES_MAX = 1_000_000
BEAMS_MIN, BEAMS_MAX = 2, 4096
RANGE_MAX_M = 80.0
"""FLASER does not give the lidar's range; SICK lidars report 81.9 m for a beam without a return."""
PLACE_MAX_M, STAMP_MAX_S = 1e6, 1e10
DURATION_MAX_S = 6 * 3600.0


class LoggedScan(msgspec.Struct, frozen=True, eq=False):
    """One turn of the lidar; ranges (N,) of 0 are beams without data."""

    angles_rad: NDArray[np.float64]
    ranges_m: NDArray[np.float64]
    range_max_m: float


class LogEntry(msgspec.Struct, frozen=True, eq=False):
    """The robot's pose by odometry, and the lidar's scan from there, if there is one."""

    stamp_s: float
    """Of the log's clock; the stamp of the measurement, not of the logger."""
    odometry: Pose2D
    scan: LoggedScan | None


class CarmenLog(msgspec.Struct, frozen=True, eq=False):
    """A log that was read, by stamp."""

    name: str
    entries: list[LogEntry]

    @property
    def scans(self) -> int:
        """Number of its scans."""
        return sum(entry.scan is not None for entry in self.entries)

    @property
    def duration_s(self) -> float:
        """From the first entry to the last."""
        return self.entries[-1].stamp_s - self.entries[0].stamp_s


def read_carmen_log(path: Path) -> CarmenLog:
    """Read a log.

    The pose of a scan is that of the lidar by odometry, so that the localised body has the lidar at its centre. Entries
    are sorted by stamp: some loggers wrote them in another order.

    Raises:
        LogError: the file cannot be read, is too large, a line is wrong, or there are not two scans in it.

    """
    entries = [entry for number, line in numbered_lines(path) if (entry := _entry(path, number, line)) is not None]
    entries.sort(key=lambda entry: entry.stamp_s)
    log = CarmenLog(path.name, entries)
    if log.scans < 2:
        raise LogError(f"{path}: expected at least two scans, FLASER or ROBOTLASER1, got {log.scans}")
    if log.duration_s > DURATION_MAX_S:
        raise LogError(
            f"{path}: expected a log of at most {DURATION_MAX_S:g} s, its stamps span {log.duration_s:.0f} s"
        )
    return log


def numbered_lines(path: Path) -> Iterator[tuple[int, str]]:
    """The lines of a text file, from 1; no comments and no empty ones.

    Raises:
        LogError: it cannot be read, or a limit of this module is exceeded.

    """
    try:
        with path.open("rb") as file:
            size, number = 0, 0
            while line := file.readline(LINE_BYTES_MAX + 1):
                number += 1
                size += len(line)
                if len(line) > LINE_BYTES_MAX:
                    raise LogError(f"{path}: line {number}: expected at most {LINE_BYTES_MAX} bytes in a line")
                if size > BYTES_MAX or number > LINES_MAX:
                    raise LogError(f"{path}: expected at most {BYTES_MAX >> 20} MiB and {LINES_MAX} lines")
                text = line.decode("ascii", "replace").strip()
                if text and not text.startswith("#"):
                    yield number, text
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error


def number_of(word: str, least: float, most: float) -> float:
    """A word as a number (ValueError if it is none, or out of bounds)."""
    number = float(word)
    if not least <= number <= most:  # NaN is not, either
        raise ValueError(f"expected a number from {least:g} to {most:g}, got {word[:40]!r}")
    return number


def _entry(path: Path, number: int, line: str) -> LogEntry | None:
    kind, *words = line.split()
    read = READERS.get(kind)
    if read is None:
        return None
    try:
        return read(_Words(words))
    except ValueError as error:
        raise LogError(f"{path}: line {number}: {kind}: {error}") from error


class _Words:
    """The words of a line, read one after the other; ValueError for an impossible value."""

    def __init__(self, words: list[str]) -> None:
        self._words = words
        self._at = 0

    def number(self, least: float, most: float) -> float:
        if self._at >= len(self._words):
            raise ValueError(f"the line ends after {len(self._words)} words")
        self._at += 1
        return number_of(self._words[self._at - 1], least, most)

    def count(self, least: int, most: int) -> int:
        count = self.number(least, most)
        if count != int(count):
            raise ValueError(f"expected a whole number, got {count:g}")
        return int(count)

    def array(self, count: int, least: float, most: float) -> NDArray[np.float64]:
        words = self._words[self._at : self._at + count]
        if len(words) < count:
            raise ValueError(f"expected {count} readings, the line ends after {len(words)}")
        self._at += count
        numbers = np.array(words, np.float64)
        if not np.all((numbers >= least) & (numbers <= most)):
            raise ValueError(f"expected readings from {least:g} to {most:g}")
        return numbers

    def pose(self) -> Pose2D:
        x_m, y_m, yaw_rad = (self.number(-PLACE_MAX_M, PLACE_MAX_M) for _ in range(3))
        return Pose2D(x_m, y_m, math.remainder(yaw_rad, math.tau))

    def stamp_s(self) -> float:
        return self.number(0.0, STAMP_MAX_S)


def _flaser(words: _Words) -> LogEntry:
    beams = words.count(BEAMS_MIN, BEAMS_MAX)
    ranges_m = words.array(beams, 0.0, PLACE_MAX_M)
    words.pose()  # of the lidar as some other program had it
    odometry = words.pose()
    # An even number of beams over 180° leaves out the last: 180 of them are 1° apart as 181 are.
    step_rad = math.pi / (beams - beams % 2)
    return LogEntry(words.stamp_s(), odometry, _scan(-math.pi / 2, step_rad, ranges_m, RANGE_MAX_M))


def _robotlaser(words: _Words) -> LogEntry:
    words.number(-1e9, 1e9)  # kind of lidar
    start_rad = words.number(-math.tau, math.tau)
    words.number(0.0, 7.0)  # field of view
    step_rad = words.number(1e-5, math.pi)
    range_max_m = words.number(0.01, PLACE_MAX_M)
    words.number(0.0, PLACE_MAX_M)  # accuracy
    words.number(-1e9, 1e9)  # remission mode
    beams = words.count(BEAMS_MIN, BEAMS_MAX)
    if (beams - 1) * step_rad > math.tau:
        raise ValueError(f"expected beams within one turn, got {beams} that are {step_rad:g} rad apart")
    ranges_m = words.array(beams, 0.0, PLACE_MAX_M)
    words.array(words.count(0, BEAMS_MAX), -1e9, 1e9)
    odometry = words.pose()
    words.pose()  # of the robot
    words.array(5, -1e9, 1e9)  # velocities, safety distances, axis of turning
    return LogEntry(words.stamp_s(), odometry, _scan(start_rad, step_rad, ranges_m, range_max_m))


def _odom(words: _Words) -> LogEntry:
    odometry = words.pose()
    words.array(3, -1e9, 1e9)
    return LogEntry(words.stamp_s(), odometry, None)


def _scan(start_rad: float, step_rad: float, ranges_m: NDArray[np.float64], range_max_m: float) -> LoggedScan:
    # A missing range of a real lidar means a dark, slanting or near surface as often as no surface.
    known_m = np.where(ranges_m < range_max_m, ranges_m, 0.0)
    angles_rad = start_rad + step_rad * np.arange(len(ranges_m), dtype=np.float64)
    return LoggedScan(angles_rad, known_m, range_max_m)


READERS = {"FLASER": _flaser, "ROBOTLASER1": _robotlaser, "ODOM": _odom}
