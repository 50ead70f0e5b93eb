"""An inertial measurement unit on a serial line: the real driver, and a unit's bytes on a pseudo terminal."""

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.plugins.device.imu import ImuAbsent, ImuContradicted, ImuMotion
from robrain.plugins.device.serial_imu import (
    ANGULAR_VELOCITY_RAD_S,
    FRAME_BYTES,
    ImuLineCodec,
    LineFormat,
    SerialImu,
    WitMotionCodec,
)
from robrain.sim.firmware.line_plug import SerialPlug
from robrain.sim.firmware.wit_imu import wit_frame
from tests.plugins.device.bare_device import BareDevice
from tests.waiting import PATIENCE_S

TURN = wit_frame(0x52, 11, 22, 1638, 2500)
"""About 100 degrees a second to the left."""
RATE_RAD_S = 1638 * ANGULAR_VELOCITY_RAD_S


# -- frames -----------------------------------------------------------------------------------------------------


def test_acceleration_comes_with_the_turn_rate_behind_it_and_other_frames_are_passed_over() -> None:
    codec = WitMotionCodec()
    first, second = codec.feed(
        wit_frame(0x50, 0, 0, 0, 0) + wit_frame(0x51, 2048, -4096, 16384, 0) + TURN + wit_frame(0x53, 1, 2, 3, 4) + TURN
    )
    assert (first.x_m_s2, first.y_m_s2) == (pytest.approx(9.8), pytest.approx(-19.6))
    assert second == ImuMotion(pytest.approx(RATE_RAD_S))
    assert (codec.rejected, codec.stray_bytes) == (0, 0)


@pytest.mark.parametrize("byte", range(FRAME_BYTES))
def test_a_byte_that_was_changed_costs_its_frame_alone(byte: int) -> None:
    codec = WitMotionCodec()
    broken = bytearray(TURN)
    broken[byte] ^= 0x10
    assert codec.feed(TURN + bytes(broken) + TURN + TURN) == [ImuMotion(pytest.approx(RATE_RAD_S))] * 3
    assert codec.rejected + codec.stray_bytes > 0


@given(st.lists(st.binary(max_size=30), max_size=8), st.integers(1, 13))
def test_noise_between_frames_of_any_cut_is_survived(noise: list[bytes], cut: int) -> None:
    codec, found = WitMotionCodec(), []
    stream = b"".join(each + TURN for each in noise) + TURN * 4
    for begin in range(0, len(stream), cut):
        found += codec.feed(stream[begin : begin + cut])
    # Noise may look like a frame and swallow the beginning of a true one, but not of all that follow.
    assert found[-2:] == [ImuMotion(pytest.approx(RATE_RAD_S))] * 2


# -- lines ------------------------------------------------------------------------------------------------------


def nmea(body: str) -> bytes:
    total = 0
    for byte in body.encode():
        total ^= byte
    return f"${body}*{total:02X}\r\n".encode()


@pytest.mark.parametrize("line", [b"x", b"", b"nan,1", b"inf,1", b"1,2,3", b"1", b"\xff\xfe,1", b"9" * 300])
def test_lines_that_are_no_numbers_are_rejected(line: bytes) -> None:
    codec = ImuLineCodec(LineFormat(columns=2))
    assert codec.feed(b"\n" + line + b"\n0.25,7\n") == [ImuMotion(0.25)]
    assert codec.rejected == (line != b"")


def test_lines_with_a_wrong_checksum_are_rejected() -> None:
    codec = ImuLineCodec(LineFormat(prefix="$G,", checksum="nmea"))
    good = nmea("G,0.125")
    spoiled = [good[:index] + bytes((good[index] ^ 1,)) + good[index + 1 :] for index in range(1, len(good) - 2)]
    assert codec.feed(b"\n" + good + b"".join(spoiled) + b"$G,0.125\n" + good) == [ImuMotion(0.125)] * 2
    assert codec.rejected >= len(spoiled) - 3


# -- the device -------------------------------------------------------------------------------------------------


class Unit:
    """A unit on a pseudo terminal, and the device that reads it."""

    def __init__(self, folder: Path, **parameters: Any) -> None:
        self.plug = SerialPlug(folder / "ttyUSB0")
        self.device = BareDevice(SerialImu, port=str(self.plug.path), **parameters)

    def say(self, data: bytes, after_s: float = 0.02) -> Any:
        """Have bytes arrive, and the device step."""
        assert self.plug.send(data) == len(data)
        deadline_s = time.monotonic() + PATIENCE_S
        while self.device.it._line._port.in_waiting < len(data) and time.monotonic() < deadline_s:
            time.sleep(0.0005)  # the kernel hands them over in its own time
        self.device.step(after_s)
        return self.device.it.latest()


@pytest.fixture
def unit(tmp_path: Path) -> Iterator[Any]:
    made: list[Unit] = []

    def build(**parameters: Any) -> Unit:
        made.append(Unit(tmp_path, **parameters))
        made[-1].device.it.activate()
        return made[-1]

    yield build
    for one in made:
        one.device.it.deactivate()
        one.plug.pull_out()


def test_turn_rates_are_left_for_the_odometry_with_their_times(unit: Any) -> None:
    one = unit(rate_hz=200.0)
    found = one.say(TURN * 3)
    now_ns = one.device.clock.now_ns()
    assert found.yaw_rate_rad_s == pytest.approx(RATE_RAD_S)
    rates = list(one.device.board.yaw_rates)
    assert [rate.stamp_ns for rate in rates] == [now_ns - 10_000_000, now_ns - 5_000_000, now_ns]
    assert [rate.rad_s for rate in rates] == [pytest.approx(RATE_RAD_S)] * 3
    one.say(TURN * 8)
    stamps = [rate.stamp_ns for rate in one.device.board.yaw_rates]
    assert stamps == sorted(set(stamps))


def test_a_unit_upside_down_that_looks_to_the_left_is_put_right(unit: Any) -> None:
    one = unit(upside_down=True, mounted_yaw_rad=math.pi / 2)
    found = one.say(wit_frame(0x51, 2048, 4096, 0, 0) + TURN)
    assert found.yaw_rate_rad_s == pytest.approx(-RATE_RAD_S)
    assert (found.forward_m_s2, found.left_m_s2) == (pytest.approx(19.6), pytest.approx(9.8))


def test_a_rate_that_no_unit_measures_is_rejected(unit: Any) -> None:
    one = unit(protocol="lines")
    assert one.say(b"\n0.5\n1e9\n").yaw_rate_rad_s == 0.5
    assert one.device.it.counters().rejected == 1


def test_noise_alone_is_a_fault_that_names_the_unit(unit: Any) -> None:
    one, rng = unit(), np.random.default_rng(1)
    one.say(TURN)
    for _ in range(24):
        one.say(rng.bytes(50))
    with pytest.raises(ImuAbsent, match=r"no measurement for 0\.\d\d s from the IMU at .*ttyUSB0, but \d+ bytes that"):
        one.device.step(0.2)
    assert len(one.device.board.yaw_rates) < 5


def test_a_unit_that_is_pulled_out_is_a_fault_and_goes_on_when_it_is_in_again(unit: Any) -> None:
    one = unit()
    one.say(TURN)
    one.plug.pull_out()
    with pytest.raises(ImuAbsent, match=r"the line to the IMU at .*ttyUSB0 is lost"):
        one.device.step(0.02)
    one.device.it.deactivate()
    with pytest.raises(ImuAbsent, match=r"no IMU at .*ttyUSB0"):
        one.device.it.activate()
    one.plug.plug_in()
    one.device.it.activate()
    assert one.say(TURN[5:] + TURN).yaw_rate_rad_s == pytest.approx(RATE_RAD_S)


@pytest.mark.parametrize(
    ("ratio", "says"), [(-0.98, "-0.98 times as far .* upside down"), (57.3, "57 times .* check the unit of its turn")]
)
def test_a_unit_that_contradicts_the_wheels_is_a_fault_until_it_starts_again(
    unit: Any, ratio: float, says: str
) -> None:
    one = unit()
    one.say(TURN)
    one.device.board.gyro_contradiction = ratio
    with pytest.raises(ImuContradicted, match=says):
        one.say(TURN)
    one.device.it.deactivate()
    one.device.it.activate()
    assert one.say(TURN[5:] + TURN).yaw_rate_rad_s == pytest.approx(RATE_RAD_S)
