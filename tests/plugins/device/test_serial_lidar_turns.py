"""When a serial lidar hands on a turn: whole ones only, and once the odometry of their end is known."""

import pytest

from robrain.plugins.device.scan.interface import LaserScan
from robrain.plugins.device.scan.serial_lidar import WAIT_NS, Ld19
from robrain.protocol.clock import to_seconds
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.serial.ld19 import encode_ld19
from tests.plugins.device.bare_device import BareDevice

PACKETS = 30
"""Of a turn."""


def packets(first: int, end: int, range_m: float) -> bytes:
    """Some packets of a turn, of which each spans 12°."""
    return b"".join(encode_ld19(12.0 * n, 1.0, [range_m] * 12, 3600, n) for n in range(first, end))


class Line:
    """A line on which bytes arrive at once."""

    def __init__(self) -> None:
        self.arrived = b""

    def read(self) -> bytes:
        data, self.arrived = self.arrived, b""
        return data

    def write(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class Lidar(BareDevice):
    def __init__(self) -> None:
        self.line = Line()
        super().__init__(Ld19)
        self.scans: list[LaserScan] = self.told(self.it.scanned)
        self.it.activate()

    def open_serial(self, port: str, baud: int, *, has_dtr: bool = True) -> Line:
        return self.line

    def hear(self, data: bytes, after_s: float = 0.02) -> None:
        self.line.arrived += data
        self.step(after_s)

    def know_odometry(self) -> None:
        """The odometry is known up to now."""
        self.board.odometry = ((0, Pose2D(0.0, 0.0, 0.0)), (self.clock.now_ns(), Pose2D(0.0, 0.0, 0.0)))


@pytest.fixture
def lidar() -> Lidar:
    return Lidar()


def test_the_turn_in_which_the_lidar_is_first_heard_is_handed_on_to_nobody(lidar: Lidar) -> None:
    lidar.hear(packets(10, PACKETS, 1.0))
    lidar.hear(packets(0, PACKETS, 2.0))
    for _ in range(10):
        lidar.hear(b"")
    assert lidar.scans == []
    lidar.hear(packets(0, 1, 3.0))
    lidar.hear(b"", after_s=0.1)
    (scan,) = lidar.scans
    assert set(scan.beam_ranges_m) == {2.0}
    assert len(scan.beam_ranges_m) == lidar.it.parameters.beams


def test_a_lidar_that_is_started_again_drops_its_first_turn_again(lidar: Lidar) -> None:
    lidar.hear(packets(0, PACKETS, 1.0) + packets(0, PACKETS, 1.0))
    lidar.it.deactivate()
    lidar.it.activate()
    lidar.hear(packets(10, PACKETS, 2.0) + packets(0, 1, 2.0))
    lidar.hear(b"", after_s=0.1)
    assert lidar.scans == []


def test_a_turn_waits_until_the_odometry_of_its_end_is_known(lidar: Lidar) -> None:
    lidar.know_odometry()
    lidar.hear(packets(0, PACKETS, 1.0) + packets(0, PACKETS, 2.0))
    lidar.hear(packets(0, 1, 3.0))
    assert lidar.scans == []
    lidar.know_odometry()
    lidar.hear(b"")
    assert [set(scan.beam_ranges_m) for scan in lidar.scans] == [{2.0}]


def test_a_turn_does_not_wait_longer_for_odometry_that_does_not_come(lidar: Lidar) -> None:
    lidar.know_odometry()
    lidar.hear(packets(0, PACKETS, 1.0) + packets(0, PACKETS, 2.0) + packets(0, 1, 3.0))
    lidar.hear(b"", after_s=to_seconds(WAIT_NS))
    assert lidar.scans == []
    lidar.hear(b"", after_s=0.001)
    assert len(lidar.scans) == 1
