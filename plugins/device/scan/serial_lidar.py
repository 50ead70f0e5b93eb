"""A lidar on a serial line: LD06, LD19 and RPLIDAR differ by their decoder."""

from typing import Annotated, ClassVar

from msgspec import Meta

from robrain.agent.plugin import external
from robrain.algorithms.localization.odometry import PoseTrack
from robrain.plugins.device.scan.lidar_device import LidarDevice, Mount, Placed, ScanMaker
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.serial.ld19 import Ld19Decoder
from robrain.protocol.serial.points import LidarDecoder, LineCounts, Piece, Point
from robrain.protocol.serial.rplidar import RplidarDecoder
from robrain.protocol.serial.serial_line import SerialLine

POLL_S = 0.02
"""Period of the poll for bytes; a turn takes 0.1 s or more."""
ASK_NS = to_ns(1.0)
"""Silence after which a polled sensor is asked again."""
POINTS_MAX = 8_000
"""Most points of a turn; more are dropped and counted (chosen: twice what any of these sensors measures)."""
NOISE_S = 2.0
"""Time of bytes without a valid packet that is a fault."""
ORIGIN = Pose2D(0.0, 0.0, 0.0)
WAIT_NS = to_ns(0.06)
"""Longest time that a turn waits for the odometry of its end; counts come every 20 ms."""


class SerialLidar(LidarDevice):
    """Reads a lidar's line; subclasses name its protocol.

    Points are moved to the robot's place at the end of the turn, by the odometry on the board. Otherwise, at 0.6 m/s
    and five turns a second, they would be up to 0.12 m off. While the robot turns at 1.5 rad/s, they would be 17° off.
    """

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """The line, and how the lidar is mounted."""

        port: str = "/dev/lidar"
        """Such as `/dev/ttyUSB0`, or better a name that udev gives; `zenoh:lidar` is the simulator's."""
        baud: Annotated[int, Meta(ge=1, le=9_999_999)] = 230_400
        silent_s: Annotated[float, Meta(gt=0, lt=10000000)] = 1.0
        """Time without a turn after which the lidar faults."""
        range_max_m: Annotated[float, Meta(gt=0, lt=10000000)] = 8.0
        """Points beyond it count as nothing."""
        beams: Annotated[int, Meta(ge=1, le=4000)] = 240
        """Of a scan, all around."""
        mount: Mount = Mount()
        """Place and direction of the lidar on the robot."""

    decoder: ClassVar[type[LidarDecoder]]
    """Decodes the bytes of this kind of lidar."""
    period_s = POLL_S
    parameters: Parameters
    has_dtr = True
    """Whether DTR is set while the line is open."""

    def init(self) -> None:
        super().init()
        self._line: SerialLine | None = None
        self._dropped = 0

    def begin(self) -> None:
        wanted = self.parameters
        self._decoder = self.decoder()
        self._maker = ScanMaker(wanted.beams, wanted.range_max_m, wanted.mount)
        self._seen: list[tuple[int, list[Point]]] = []
        """Points of this turn, with the time when they came."""
        self._ended: list[tuple[int, list[Point]]] = []
        """Points of the last turn, while it waits for its odometry."""
        self._before: list[tuple[int, list[Point]]] = []
        """Points of the last turn that was passed on."""
        self.env.board.wants_odometry = True
        self._points = 0
        self._is_whole = False
        """Whether the turn began at the sensor's front."""
        self._line = self.env.open_serial(wanted.port, wanted.baud, has_dtr=self.has_dtr)
        self._asked_ns = self.env.clock.now_ns()
        self._arrived = self._counted_ns = 0
        """Bytes since their packets were counted last, and when that was."""
        self._counts: LineCounts | None = None

    def deactivate(self) -> None:
        if self._line is not None:
            self._line.close()
            self._line = None

    def read_turns(self, now_ns: int) -> None:
        line = self._line
        if line is None:
            return
        try:
            data = line.read()
            pieces = self._decoder.feed(data)
            if pieces:
                self._asked_ns = now_ns
            elif now_ns - self._asked_ns > ASK_NS:
                self._asked_ns = now_ns
                self._decoder.ask_again()
            if wanted := self._decoder.to_write():
                line.write(wanted)
        except OSError as error:
            self.fail(f"the lidar's line {self.parameters.port} is lost: {error}")
        self._check_noise(len(data), now_ns)
        for piece in pieces:
            self._add(piece, now_ns)
            if piece.ends_turn:
                self._end_turn(now_ns)
        if self._ended and (self._is_known(self._ended[-1][0]) or now_ns - self._ended[-1][0] > WAIT_NS):
            self._hand_on(now_ns)

    def _check_noise(self, arrived: int, now_ns: int) -> None:
        """Fault if the bytes of two seconds are no packets, or mostly none."""
        self._arrived += arrived
        before, counts, wanted = self._counts, self._decoder.counts, self.parameters
        seconds = to_seconds(now_ns - self._counted_ns)
        if self._arrived and before is not None and (not arrived or seconds < NOISE_S):
            return
        total, self._arrived, self._counted_ns, self._counts = self._arrived, 0, now_ns, counts
        if not total or before is None:
            return
        if counts.packets == before.packets or counts.stray_bytes - before.stray_bytes > total // 2:
            what = f"{total} bytes came from {wanted.port} in {seconds:.1f} s, but no valid packets"
            self.fail(f"{what}: check the baud rate ({wanted.baud}), the wiring and the kind of lidar")

    def _add(self, piece: Piece, now_ns: int) -> None:
        room = max(0, POINTS_MAX - self._points)
        points = piece.points[:room]
        self._dropped += len(piece.points) - len(points)
        self._points += len(points)
        if points and self._seen and self._seen[-1][0] == now_ns:
            self._seen[-1][1].extend(points)
        elif points:
            self._seen.append((now_ns, list(points)))

    def _end_turn(self, now_ns: int) -> None:
        if self._ended:  # the one before still waits
            self._hand_on(now_ns)
        seen, self._seen, self._points = self._seen, [], 0
        was_whole, self._is_whole = self._is_whole, True
        if was_whole and seen:  # otherwise it began within the turn
            self._ended = seen

    def _is_known(self, stamp_ns: int) -> bool:
        """Whether the odometry covers a time."""
        odometry = self.env.board.odometry
        return bool(odometry) and odometry[-1][0] >= stamp_ns

    def _hand_on(self, now_ns: int) -> None:
        """Move the points to the robot's place at the last measurement."""
        seen, self._ended = self._ended, []
        before, self._before = self._before, seen
        odometry, stamp_ns = self.env.board.odometry, seen[-1][0]
        track = PoseTrack(ORIGIN, len(odometry), odometry)
        here = track.pose_at(stamp_ns).inverse()

        def moved(turn: list[tuple[int, list[Point]]]) -> list[Placed]:
            return [(here.compose(track.pose_at(seen_ns)), points) for seen_ns, points in turn]

        scan = self._maker.scan(moved(seen), moved(before), stamp_ns)
        self.record(scan, [round(1000 * range_m) for range_m in scan.beam_ranges_m], now_ns)

    @external
    def line_counts(self) -> LineCounts:
        """Packets, wrong checksums and stray bytes since the line was opened."""
        return self._decoder.counts

    @external
    def dropped_points(self) -> int:
        """Points beyond the most that a turn may have."""
        return self._dropped


class Ld19(SerialLidar):
    """Passes on each turn of LDROBOT's LD06 and LD19."""

    decoder = Ld19Decoder


class Rplidar(SerialLidar):
    """Passes on each turn of Slamtec's RPLIDAR A-series."""

    has_dtr = False  # it stops the motor of an A1
    decoder = RplidarDecoder
