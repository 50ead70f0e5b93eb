"""An inertial measurement unit on a serial line.

Its turn rate goes to the odometry by the board, because devices do not call each other; decision 0067.
"""

import math
import struct
from abc import ABC, abstractmethod
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from robrain.agent.errors import HardwareAbsent
from robrain.agent.plugin import external
from robrain.agent.silence import Silence
from robrain.plugins.device.imu import RATE_MAX_RAD_S, ImuAbsent, ImuDevice, ImuMotion
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.line_splitter import LineSplitter
from robrain.protocol.model.checked import Checked
from robrain.protocol.serial.serial_line import SerialLine

HEADER = 0x55
FRAME_BYTES = 11
ACCELERATION, ANGULAR_VELOCITY, LAST_KIND = 0x51, 0x52, 0x5F
FIRST_KIND = 0x50
ACCELERATION_M_S2 = 16 * 9.8 / 32768
"""Of one bit; the full scale is 16 g."""
ANGULAR_VELOCITY_RAD_S = math.radians(2000) / 32768
_VALUES = struct.Struct("<4h")


class ImuCodec(ABC):
    """Finds the measurements in a stream of bytes; it keeps incomplete bytes, of bounded length."""

    def __init__(self) -> None:
        self.rejected = 0
        """Frames or lines with a wrong checksum, or that cannot be read."""
        self.stray_bytes = 0
        """Bytes outside of any frame or line."""

    @abstractmethod
    def feed(self, data: bytes) -> list[ImuMotion]:
        """The measurements that these bytes complete."""


class WitMotionCodec(ImuCodec):
    """An angular velocity is a measurement, with the acceleration that came last before it."""

    def __init__(self) -> None:
        super().__init__()
        self._rest = b""
        self._acceleration: tuple[float, float] | None = None

    def feed(self, data: bytes) -> list[ImuMotion]:
        data, at, found = self._rest + data, 0, []
        while len(data) - at >= FRAME_BYTES:
            frame = data[at : at + FRAME_BYTES]
            if frame[0] != HEADER or not FIRST_KIND <= frame[1] <= LAST_KIND:
                self.stray_bytes += 1
                at += 1
            elif sum(frame[:-1]) & 0xFF != frame[-1]:
                # It may be noise, or a byte is missing: the next frame may begin within this one.
                self.rejected += 1
                at += 1
            else:
                at += FRAME_BYTES
                if (motion := self._read(frame)) is not None:
                    found.append(motion)
        self._rest = data[at:]
        return found

    def _read(self, frame: bytes) -> ImuMotion | None:
        x, y, z, _ = _VALUES.unpack_from(frame, 2)
        if frame[1] == ACCELERATION:
            self._acceleration = x * ACCELERATION_M_S2, y * ACCELERATION_M_S2
        if frame[1] != ANGULAR_VELOCITY:
            return None
        acceleration, self._acceleration = self._acceleration, None
        return ImuMotion(z * ANGULAR_VELOCITY_RAD_S, *(acceleration or ()))


LINE_BYTES_MAX = 256
Column = Annotated[int, Meta(ge=0, le=63)]


class LineFormat(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Format of the lines."""

    prefix: Annotated[str, Meta(max_length=32)] = ""
    """Lines that begin otherwise are ignored; columns are counted from behind it."""
    separator: Annotated[str, Meta(min_length=1, max_length=4)] = ","
    columns: Annotated[int, Meta(ge=0, le=64)] = 0
    """Number of columns of a line; any other is rejected. 0: any that has those named here."""
    yaw_rate_column: Column = 0
    """The first column is 0."""
    yaw_rate_unit: Literal["rad/s", "deg/s"] = "rad/s"
    acceleration_columns: tuple[Column, Column] | None = None
    """Of x and y in m/s²; none if absent."""
    checksum: Literal["none", "nmea"] = "none"
    """At a line's end; `nmea`: `*` and two hexadecimal digits, the bytes between `$` and `*` by XOR."""


class ImuLineCodec(ImuCodec):
    """Lines of text.

    Args:
        wanted: format of the lines.

    """

    def __init__(self, wanted: LineFormat) -> None:
        super().__init__()
        self._wanted = wanted
        self._prefix, self._separator = wanted.prefix.encode(), wanted.separator.encode()
        self._splitter = LineSplitter(LINE_BYTES_MAX, skips_first=True)

    def feed(self, data: bytes) -> list[ImuMotion]:
        found = []
        for line in self._splitter.feed(data):
            if line is None:
                self.rejected += 1
                self.stray_bytes += LINE_BYTES_MAX
            elif (motion := self._read(line.strip())) is not None:
                found.append(motion)
        return found

    def _read(self, line: bytes) -> ImuMotion | None:
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
        return ImuMotion(math.radians(rate) if wanted.yaw_rate_unit == "deg/s" else rate, *accelerations)

    def _checked(self, line: bytes) -> bytes:
        """The line without its checksum (ValueError if that is wrong)."""
        if self._wanted.checksum == "none":
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


class ImuCounters(msgspec.Struct, frozen=True):
    """Counters of the serial line."""

    samples: int
    rejected: int
    """Frames or lines that have a wrong checksum, cannot be read, or are beyond the range of the unit."""
    stray_bytes: int


class SerialImu(ImuDevice):
    """Reads a unit's turn rate and acceleration, and leaves the turn rate to the odometry."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """The line, its protocol, and the mount of the unit."""

        port: Annotated[str, Meta(min_length=1, max_length=4096)] = "/dev/imu"
        """Such as `/dev/ttyUSB0`, or better a name that udev gives; `zenoh:imu` is the simulator's."""
        baud: Annotated[int, Meta(ge=1, le=9_999_999)] = 9600
        protocol: Literal["witmotion", "lines"] = "witmotion"
        lines: LineFormat = LineFormat()
        """For the protocol `lines`."""
        rate_hz: Annotated[float, Meta(gt=0, lt=10000000.0)] = 100.0
        """Measurements a second, which separates those that arrive together."""
        upside_down: bool = False
        mounted_yaw_rad: float = 0.0
        """Direction of the unit's x axis, robot's frame; for the accelerations alone."""
        yaw_sign: Literal[1, -1] = 1
        """-1 for a unit whose rate is positive to the right."""
        silent_s: Annotated[float, Meta(gt=0, lt=10000000.0)] = 0.5
        """Time without a measurement after which the unit counts as gone."""
        start_s: Annotated[float, Meta(gt=0, lt=10000000.0)] = 3.0
        """How long it may be silent after its line was opened; many boards start again then."""

    parameters: Parameters

    def init(self) -> None:
        wanted = self.parameters
        self._line: SerialLine | None = None
        self._period_ns = to_ns(1.0 / wanted.rate_hz)
        self.yaw_sign = wanted.yaw_sign
        self._samples = self._beyond = 0

    def activate(self) -> None:
        wanted = self.parameters
        try:
            self._line = self.env.open_serial(wanted.port, wanted.baud)
        except HardwareAbsent as error:
            raise ImuAbsent(f"no IMU at {wanted.port}: {error}") from error
        is_text = wanted.protocol == "lines"
        self._codec: ImuCodec = ImuLineCodec(wanted.lines) if is_text else WitMotionCodec()
        self.env.board.gyro_contradiction = None
        self._silence = Silence(to_ns(wanted.silent_s))
        self._opened_ns = self._received_ns = self.env.clock.now_ns()

    def step(self) -> None:
        if self._line is None:
            return
        self.check_agreement()
        try:
            data = self._line.read()
        except OSError as error:
            raise ImuAbsent(f"the line to the IMU at {self.parameters.port} is lost: {error}") from error
        now_ns = self.env.clock.now_ns()
        motions = [motion for motion in self._codec.feed(data) if self._is_possible(motion)]
        if motions:
            self._received_ns = now_ns
            self._samples += len(motions)
            for number, motion in enumerate(motions, 1 - len(motions)):
                self.add(motion, now_ns + number * self._period_ns)
            return
        if self._received_ns == self._opened_ns and 0 <= now_ns - self._opened_ns < to_ns(self.parameters.start_s):
            return
        silent_ns = self._silence.since(self._received_ns, now_ns)
        if silent_ns > self._silence.limit_ns:
            noise = self._codec.stray_bytes
            but = f", but {noise} bytes that are none: check baud and wiring" if noise else ""
            raise ImuAbsent(
                f"no measurement for {silent_ns / NS_PER_S:.2f} s from the IMU at {self.parameters.port}{but}"
            )

    def deactivate(self) -> None:
        if self._line is not None:
            self._line.close()
            self._line = None

    @external
    def counters(self) -> ImuCounters:
        """Measurements taken and rejected, and bytes that belong to none."""
        codec = self._codec
        return ImuCounters(self._samples, codec.rejected + self._beyond, codec.stray_bytes)

    def _is_possible(self, motion: ImuMotion) -> bool:
        is_possible = abs(motion.yaw_rate_rad_s) <= RATE_MAX_RAD_S
        self._beyond += not is_possible
        return is_possible
