"""A base on a serial line: an Arduino's lines on a pty, broken lines, a plug that is pulled, a codec of one's own."""

import math
import os
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import pytest

from robrain.agent.errors import HardwareAbsent
from robrain.algorithms.navigation.wheel_bases import Differential, WheelBase
from robrain.plugins.device.mocdevice.frame_map import SignalUnit
from robrain.plugins.device.mocdevice.interface import BusFault
from robrain.plugins.device.serial_base import LineWords, SerialBase, WheelLineCodec, WheelSerialLink
from robrain.protocol.model.geometry import Twist2D
from robrain.sim.firmware.line_plug import SerialPlug
from tests.plugins.device.bare_device import BareDevice

BASE = Differential(wheel_radius_m=0.05, track_m=0.2, encoder_ticks_per_turn=600)
WORDS = LineWords(units=(SignalUnit.TURNS_S,), scale=20.0)  # counts per cycle of 1/30 s
CYCLES_S = 30.0


class Arduino(BareDevice):
    """The device, and at the other end of its line a controller as ROSArduinoBridge is."""

    def __init__(self, folder: Path, **parameters: Any) -> None:
        self.plug = SerialPlug(folder / "base")
        self.counts = [0.0, 0.0]
        self.speeds = (0.0, 0.0)
        self.heard: list[bytes] = []
        super().__init__(SerialBase, port=str(self.plug.path), base=BASE, **({"lines": WORDS} | parameters))

    def turn(self, seconds: float) -> None:
        """Let the wheels turn, answer what was asked, and step the device, in steps of 20 ms."""
        for _ in range(round(seconds / 0.02)):
            self.counts = [
                count + speed * CYCLES_S * 0.02 for count, speed in zip(self.counts, self.speeds, strict=True)
            ]
            self.answer()
            self.step(0.02)

    def wait_in_silence(self, seconds: float) -> None:
        """Step the device, and answer nothing."""
        for _ in range(round(seconds / 0.02)):
            self.step(0.02)

    def answer(self) -> None:
        left = b""
        for _ in range(50):  # the kernel passes bytes on when it likes
            left += self.plug.receive()
            if left.endswith(b"\r"):
                break
            os.sched_yield()
        for line in left.split(b"\r")[:-1]:
            self.heard.append(line)
            if line == b"e":
                self.plug.send(b"%d %d\r\n" % tuple(map(int, self.counts)))
            elif line.startswith(b"m"):
                first, second = map(int, line.split()[1:])
                self.speeds = float(first), float(second)
                self.plug.send(b"OK\r\n")


@pytest.fixture
def arduino(tmp_path: Path) -> Iterator[Arduino]:
    one = Arduino(tmp_path)
    one.it.activate()
    yield one
    one.it.deactivate()
    one.plug.pull_out()


def test_it_is_driven_by_lines_and_its_counts_are_the_odometry(arduino: Arduino) -> None:
    arduino.turn(0.3)
    for _ in range(20):
        arduino.it.drive(Twist2D(0.3, 0.0, 0.0))
        arduino.turn(0.1)
    assert b"m 19 19" in arduino.heard  # 0.3 m/s are 0.955 turns/s, 20 counts a cycle each
    driven_m = arduino.counts[0] / 600 * math.tau * 0.05
    assert driven_m > 0.5
    assert arduino.it.pose().x_m == pytest.approx(driven_m, abs=0.03)
    assert arduino.it.pose().yaw_rad == 0.0
    assert arduino.it.velocity().forward_m_s == pytest.approx(0.3, rel=0.2)
    assert arduino.it.is_fresh()
    arduino.it.stop()
    arduino.turn(0.2)
    assert arduino.heard.count(b"m 0 0") == 1
    assert arduino.speeds == (0.0, 0.0)


def test_a_plug_that_is_pulled_is_a_fault_and_the_odometry_goes_on_when_it_is_back(arduino: Arduino) -> None:
    arduino.turn(0.3)
    arduino.it.drive(Twist2D(0.3))
    arduino.turn(0.5)
    before = arduino.it.pose()
    assert before.x_m > 0.05
    arduino.plug.pull_out()
    with pytest.raises(BusFault, match=r"the serial line .* is lost"):
        arduino.turn(1.0)
    arduino.it.deactivate()
    with pytest.raises(HardwareAbsent):
        arduino.it.activate()
    arduino.speeds = (0.0, 0.0)
    arduino.plug.plug_in()
    arduino.it.activate()
    arduino.turn(0.3)
    assert arduino.it.pose().x_m >= before.x_m
    assert arduino.it.pose().x_m == pytest.approx(arduino.counts[0] / 600 * math.tau * 0.05, abs=0.02)
    arduino.it.drive(Twist2D(0.3))
    arduino.turn(0.5)
    assert arduino.it.pose().x_m > before.x_m + 0.05


def test_a_controller_that_says_nothing_any_more_is_a_fault(arduino: Arduino) -> None:
    arduino.it.env.board.T_odom_robot = arduino.it.pose()
    arduino.it.deactivate()
    arduino.it.activate()
    arduino.wait_in_silence(2.9)  # many boards start again when their line is opened
    with pytest.raises(BusFault, match=r"no encoder frame for .*: the controller at .* is silent"):
        arduino.wait_in_silence(1.2)


@pytest.mark.parametrize("spoke_s", [0.0, 0.5])
def test_bytes_without_counts_are_a_fault_that_says_what_to_check(arduino: Arduino, spoke_s: float) -> None:
    arduino.turn(spoke_s)

    def noise(seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            arduino.plug.send(b"\xf0\x80\xff\x1c")
            arduino.step(0.02)

    with pytest.raises(
        BusFault, match=r"\d{2,} bytes came from .*base, but no counts: .* baud rate \(57600\), the wiring"
    ):
        noise(5.2)  # a board may take 3 s to start, and say anything meanwhile


class Frames:
    """Frames of a sync byte, two 32-bit counts and a sum."""

    def __init__(self, base: WheelBase) -> None:
        self.rejected = 0

    def command(self, values: Sequence[float]) -> bytes:
        return b"\xaa" + struct.pack("<2f", *values)

    def stop(self) -> bytes:
        return self.command((0.0, 0.0))

    def poll(self) -> bytes:
        return b""

    def feed(self, data: bytes) -> list[tuple[int, ...]]:
        return [struct.unpack("<2I", data[1:9])] if len(data) == 9 else []


def test_a_class_of_ones_own_speaks_frames(tmp_path: Path) -> None:
    one = Arduino(tmp_path, codec=f"{__name__}:Frames")
    import sys

    sys.modules.setdefault(__name__, sys.modules[Frames.__module__])
    one.it.activate()
    for step in range(10):
        one.plug.send(b"\xaa" + struct.pack("<2I", 10 * step, 10 * step))
        for _ in range(50):
            one.step(0.001)
        one.wait(0.0)
    assert one.it.pose().x_m == pytest.approx(90 / 600 * math.tau * 0.05)
    one.it.deactivate()
    one.plug.pull_out()


def test_a_wheel_that_is_mounted_the_other_way_round_is_commanded_and_counted_backwards() -> None:
    codec = WheelLineCodec(msgspec.structs.replace(WORDS, signs=(1, -1), count_bits=16), 2, 2, 0.05)
    assert codec.command([math.tau, math.tau]) == b"m 20 -20\r"
    assert codec.feed(b"100 -50\r\n-100 50\r\n") == [(100, 50), ((1 << 16) - 100, (1 << 16) - 50)]


def test_of_a_controller_that_sends_by_itself_the_first_line_may_be_cut_and_is_left() -> None:
    codec = WheelLineCodec(msgspec.structs.replace(WORDS, poll=""), 2, 2, 0.05)
    assert codec.feed(b"23 998\r\n1023 998\r\n") == [(1023, 998)]


def test_a_stop_behind_a_command_that_was_cut_off_is_sent_twice() -> None:
    class Full:
        takes = False
        sent: ClassVar[list[bytes]] = []

        def write(self, data: bytes) -> bool:
            self.sent.append(data)
            return self.takes

    line: Any = Full()
    link = WheelSerialLink(line, WheelLineCodec(WORDS, 2, 2, 0.05), "mocdevice", SerialBase.Parameters(), lambda: 0)
    link.command([0.0, 0.0])
    line.takes = True
    link.stop()
    link.stop()
    assert line.sent[1:] == [b"m 0 0\rm 0 0\r", b"m 0 0\r"]


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"report": "("}, "regular expression"),
        ({"command": "m {speed}"}, "expected fields such as"),
        ({"command": "m 1 1"}, "expected fields such as"),
        ({"command": "m {0"}, "format"),
        ({"stop": "a\nb"}, "one line of ASCII"),
        ({"count_bits": 4}, ">= 8"),
    ],
)
def test_words_that_make_no_line_are_refused(changes: dict[str, Any], why: str) -> None:
    with pytest.raises(msgspec.ValidationError, match=why):
        msgspec.convert(changes, LineWords)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (LineWords(report=r"(\d+)"), "lines.report: expected 2 groups for this base, got 1"),
        (LineWords(command="m {0} {1} {2}"), "lines.command: .*for 2 values"),
        (LineWords(signs=(1, 1, 1)), "lines.signs: expected 1 or 2, got 3"),
    ],
)
def test_words_for_another_number_of_wheels_are_refused(words: LineWords, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        WheelLineCodec(words, 2, 2, 0.05)
