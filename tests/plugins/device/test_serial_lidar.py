"""LD19 and RPLIDAR on a pty: scans in the robot's frame, a line that is pulled out and plugged in again."""

import math
import os
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robrain.agent.errors import HardwareAbsent
from robrain.plugins.device.scan.interface import LaserScan
from robrain.plugins.device.scan.lidar_device import LidarFault, Mount, ScanMaker
from robrain.plugins.device.scan.serial_lidar import Ld19, Rplidar, SerialLidar
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.serial.ld19 import encode_ld19
from robrain.protocol.serial.points import Point
from robrain.protocol.serial.rplidar import DESCRIPTOR, MOTOR, SCAN, STOP, encode_rplidar
from tests.plugins.device.bare_device import BareDevice


class OnPty(BareDevice):
    """A lidar device whose line is a pty; the test is the sensor."""

    def __init__(self, device_class: type[SerialLidar], folder: Path, **parameters: Any) -> None:
        self.path = folder / "lidar"
        self.plug_in()
        super().__init__(device_class, port=str(self.path), **parameters)

    def plug_in(self) -> None:
        self._master, slave = os.openpty()
        os.set_blocking(self._master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(slave))
        self._slave = slave

    def pull_out(self) -> None:
        os.close(self._master)
        os.close(self._slave)
        self.path.unlink()

    def send(self, data: bytes) -> None:
        os.write(self._master, data)

    def heard(self) -> bytes:
        try:
            return os.read(self._master, 100)
        except BlockingIOError:
            return b""

    def steps(self, count: int) -> None:
        for _ in range(count):
            self.step(0.02)

    def wait_for(self, turns: int = 1, send: bytes = b"") -> LaserScan:
        """Step until so many turns were handed on; the kernel passes bytes on when it likes."""
        stamps = {scan.stamp_ns for scan in [self.it.latest()] if scan is not None}
        before = len(stamps)
        if send:
            self.send(send)
        for _ in range(2_000):
            self.step(0.02)
            if (scan := self.it.latest()) is not None:
                stamps.add(scan.stamp_ns)
                if len(stamps) >= before + turns:
                    return scan
            os.sched_yield()
        raise AssertionError("no turn comes")


@pytest.fixture
def lidar(tmp_path: Path) -> Iterator[Any]:
    made: list[OnPty] = []

    def make(device_class: type[SerialLidar] = Ld19, **parameters: Any) -> OnPty:
        made.append(OnPty(device_class, tmp_path, **parameters))
        made[-1].it.activate()
        return made[-1]

    yield make
    for one in made:
        one.it.deactivate()


def ld19_turns(count: int, at_left_m: float = 2.0, elsewhere_m: float = 3.0) -> bytes:
    """Turns that see something within 30° of the robot's left, which is 270° clockwise."""
    angles = [packet * 12.0 + point for packet in range(30) for point in range(12)]
    ranges = [at_left_m if abs(angle - 270.0) < 30.0 else elsewhere_m for angle in angles]
    packets = [encode_ld19(n * 12.0, 1.0, ranges[12 * n : 12 * n + 12], 3600, n) for n in range(30)]
    return b"".join(packets) * count


def at(scan: LaserScan, degrees: float) -> float:
    """Range in a direction of the robot's frame."""
    return min(
        zip(scan.beam_angles_rad, scan.beam_ranges_m, strict=True),
        key=lambda beam: abs(math.remainder(beam[0] - math.radians(degrees), math.tau)),
    )[1]


def test_turn_is_a_scan_counter_clockwise_in_the_robots_frame(lidar: Any) -> None:
    one = lidar()
    scan = one.wait_for(send=ld19_turns(3))
    assert at(scan, 90.0) == 2.0
    assert {at(scan, degrees) for degrees in (0.0, 180.0, -90.0)} == {3.0}
    assert len(scan.beam_ranges_m) == 240
    assert list(scan.beam_angles_rad) == sorted(scan.beam_angles_rad)
    assert one.it.line_counts().bad_checksums == 0


def test_rplidar_is_asked_to_scan_and_its_nodes_are_the_same_scan(lidar: Any) -> None:
    one = lidar(Rplidar)
    for _ in range(500):
        one.step(0.02)
        if one.heard() == STOP + MOTOR + SCAN:
            break
    else:
        raise AssertionError("it was not asked")
    ranges = [2.0 if abs(angle - 270) < 30 else 3.0 for angle in range(360)]
    nodes = encode_rplidar(range(360), ranges)
    scan = one.wait_for(send=DESCRIPTOR + 3 * nodes)
    assert (at(scan, 90.0), at(scan, -90.0)) == (2.0, 3.0)


def test_line_that_is_pulled_out_is_a_fault_and_is_used_again_when_it_is_back(lidar: Any) -> None:
    one = lidar()
    one.wait_for(send=ld19_turns(3))
    troubles = one.told(one.it.trouble)
    one.pull_out()
    with pytest.raises(LidarFault, match=f"the lidar's line {one.path} is lost"):
        one.steps(100)
    assert f"the lidar's line {one.path} is lost" in troubles[0]
    one.it.deactivate()
    with pytest.raises(HardwareAbsent):  # as the host tries, once a second
        one.it.activate()
    one.plug_in()
    one.it.activate()
    assert at(one.wait_for(send=ld19_turns(3)), 90.0) == 2.0


@pytest.mark.parametrize("kind", [Ld19, Rplidar])
def test_bytes_that_are_no_packets_are_a_fault_with_causes(kind: type[SerialLidar], tmp_path: Path) -> None:
    device = OnPty(kind, tmp_path)
    device.it.activate()
    rng = np.random.default_rng(1)

    def pass_seconds(seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            device.send(rng.bytes(100))
            device.step(0.02)

    try:
        pass_seconds(1.8)
        with pytest.raises(LidarFault, match=r"\d{4,} bytes came from .*lidar in 2.0 s, .* the baud rate \(\d+\)"):
            pass_seconds(0.5)
    finally:
        device.it.deactivate()
        device.pull_out()


@pytest.mark.parametrize(("stray", "is_fault"), [(40, False), (60, True)])
def test_line_of_which_more_than_half_is_noise_is_a_fault(lidar: Any, stray: int, is_fault: bool) -> None:
    one, packet = lidar(), encode_ld19(0.0, 1.0, [3.0] * 12, 3600, 0)
    with pytest.raises(LidarFault) if is_fault else nullcontext():
        for _ in range(300):
            one.send(bytes(stray) + packet)
            one.step(0.02)


HERE = Pose2D(0.0, 0.0, 0.0)
BEAMS = 18
"""Of 20° each; the first looks back."""


def scan_of(*points: Point, before: tuple[Point, ...] = ()) -> LaserScan:
    return ScanMaker(BEAMS, 8.0, Mount()).scan([(HERE, points)], [(HERE, before)], 0)


@pytest.mark.parametrize(
    ("points", "before", "beams"),
    [
        (
            [(-3.13, 2.0), (-0.7, 2.0), (0.01, 2.0), (2.9, 2.0)],
            (),
            [(-3.13, 2.0), (-0.7, 2.0), (0.01, 2.0), (2.9, 2.0)],
        ),
        ([(3.1, 2.0), (-1.0, 3.0)], (), [(3.1 - math.tau, 2.0), (-1.0, 3.0)]),  # right behind
        ([(0.10, 3.0), (0.02, 1.0), (-0.05, 2.0)], (), [(0.02, 1.0)]),  # of a beam the nearest
        ([(0.02, 1.0)], [(0.04, 0.5), (0.72, 2.0)], [(0.02, 1.0), (0.72, 2.0)]),  # what this turn lacks
    ],
)
def test_points_count_at_their_own_angles_and_not_at_those_of_their_beams(points: Any, before: Any, beams: Any) -> None:
    scan = scan_of(*[Point(*point) for point in points], before=tuple(Point(*point) for point in before))
    assert list(zip(scan.beam_angles_rad, scan.beam_ranges_m, strict=True)) == [pytest.approx(beam) for beam in beams]


@pytest.mark.parametrize("range_m", [0.0, 2.0])
def test_points_of_a_robot_that_has_turned_since_are_turned_as_well(range_m: float) -> None:
    turned = Pose2D(0.0, 0.0, 0.5)
    scan = ScanMaker(BEAMS, 8.0, Mount()).scan([(turned, (Point(0.3, range_m),))], (), 0)
    assert (scan.beam_angles_rad, scan.beam_ranges_m) == (pytest.approx([0.8]), (range_m or 8.0,))
