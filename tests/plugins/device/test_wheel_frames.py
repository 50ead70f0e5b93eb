"""A base by description: other frames, units, signs, checksums and byte orders than the Robertino's."""

import math
import struct
from pathlib import Path
from typing import Any

import can
import msgspec
import pytest

from robrain.algorithms.navigation.wheel_bases import Differential
from robrain.plugins.device.mocdevice.frame_map import (
    Checksum,
    FrameMap,
    FrameSignals,
    OtherPart,
    SignalFrame,
    SignalUnit,
    StatusFrame,
    StopFrame,
    read_dbc,
    signal_frames,
)
from robrain.plugins.device.mocdevice.interface import BusFault
from robrain.plugins.device.mocdevice.mocdevice import MocDevice
from robrain.protocol.can.frames import BadFrame, codec, crc8_j1850
from robrain.protocol.model.geometry import Twist2D
from robrain.sim.firmware.described_controller import TWO_WHEELS as FRAMES
from tests.plugins.device.bare_device import BareDevice

BASE = Differential(wheel_radius_m=0.1, track_m=0.4, encoder_ticks_per_turn=1000)
RPM_PER_RAD_S = 60.0 / math.tau
DBC = """VERSION ""
NS_ :
BS_:
BU_: Host Motor
BO_ 2147484000 Speeds: 6 Host
 SG_ right : 0|16@1- (0.01,0) [-300|300] "m/s" Motor
 SG_ left : 16|16@1- (0.01,0) [-300|300] "m/s" Motor
 SG_ alive : 32|8@1+ (1,0) [0|255] "" Motor
 SG_ sum : 40|8@1+ (1,0) [0|255] "" Motor
BO_ 1001 Measured: 6 Motor
 SG_ left : 0|16@1- (0.01,0) [-300|300] "rad/s" Host
 SG_ right : 16|16@1- (0.01,0) [-300|300] "rad/s" Host
 SG_ alive : 32|8@1+ (1,0) [0|255] "" Host
 SG_ sum : 40|8@1+ (1,0) [0|255] "" Host
BO_ 1002 Halt: 3 Host
 SG_ brake : 0|8@1+ (1,0) [0|255] "" Motor
 SG_ alive : 8|8@1+ (1,0) [0|255] "" Motor
 SG_ sum : 16|8@1+ (1,0) [0|255] "" Motor
"""


def two_wheels(**changes: Any) -> BareDevice:
    device = BareDevice(MocDevice, base=BASE, frames=FRAMES, **changes)
    device.it.activate()
    return device


def counts(device: BareDevice, left: int | None, right: int | None, after_s: float = 0.02) -> None:
    """Both encoders speak, or one."""
    device.wait(after_s)
    for name, signal, value in (("LeftEncoder", "left_counts", left), ("RightEncoder", "right_counts", right)):
        if value is None:
            continue
        message = read_dbc("two_wheels").get_message_by_name(name)
        speed = signal.replace("counts", "speed_rpm")
        data = message.encode({signal: value, speed: 0.0})
        frame = can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=False)
        frame.timestamp = device.clock.now_ns() / 1e9
        device.bus.arrived.append(frame)
    device.it.step()


def test_commands_are_in_the_units_of_the_file_and_a_stop_is_a_command_of_nothing() -> None:
    device = two_wheels()
    device.it.drive(Twist2D(0.5, 0.3, 1.0))
    device.it.stop()
    first, second = device.bus.sent
    wanted = read_dbc("two_wheels").get_message_by_name("DriveCommand")
    assert first.arbitration_id == wanted.frame_id
    found = wanted.decode(first.data)
    assert found["left_rpm"] == pytest.approx((0.5 - 0.2) / 0.1 * RPM_PER_RAD_S, abs=0.05)
    assert found["right_rpm"] == pytest.approx((0.5 + 0.2) / 0.1 * RPM_PER_RAD_S, abs=0.05)
    assert set(wanted.decode(second.data).values()) == {0.0}


def test_counts_of_both_frames_make_the_odometry_and_wrap_at_their_32_bits() -> None:
    device, half = two_wheels(), 1 << 31
    begin = half - 30
    counts(device, begin, begin)
    for step in range(1, 51):
        there = (begin + 20 * step + half) % (1 << 32) - half
        counts(device, there, there)
    pose = device.it.pose()
    assert pose.x_m == pytest.approx(1000 * math.tau / 1000 * 0.1)
    assert (pose.y_m, pose.yaw_rad) == (0.0, 0.0)
    assert device.it.velocity().forward_m_s == pytest.approx(20 * math.tau / 1000 * 0.1 / 0.02)
    counters = device.it.counters()
    assert (counters.believed, counters.rejected, counters.foreign) == (51, 0, 0)


@pytest.mark.parametrize("values", [(32.1, 0.0), (0.0, -32.1), (math.nan, 0.0), (1.0,), (1.0, 1.0, 1.0)])
def test_commands_for_wheels_beyond_their_limit_or_for_other_wheels_are_refused_and_not_sent(
    values: tuple[float, ...],
) -> None:
    device = two_wheels(wheel_speed_max_rad_s=32.0)
    device.it.drive_wheels((32.0, -32.0))
    with pytest.raises(ValueError, match=r"expected 2 commands within ±32, got \["):
        device.it.drive_wheels(values)
    assert len(device.bus.sent) == 1


@pytest.mark.parametrize("lost", [1, 5, 15])
def test_lost_frames_without_a_counter_are_noticed_by_time_and_are_no_jump(lost: int) -> None:
    device, per_frame = two_wheels(), 60  # 19 rad/s
    counts(device, 0, 0)
    counts(device, per_frame, per_frame)
    there = (2 + lost) * per_frame
    counts(device, there, there, after_s=0.02 * (1 + lost))
    rad_per_count = math.tau / 1000
    assert device.it.velocity().forward_m_s == pytest.approx(per_frame * rad_per_count * 0.1 / 0.02)
    assert device.it.pose().x_m == pytest.approx(there * rad_per_count * 0.1)
    assert device.it.counters().rejected == 0


def test_counts_of_two_rounds_are_no_report() -> None:
    device = two_wheels()
    for left, right, believed in ((0, None, 0), (None, 0, 0), (1, 1, 1)):
        counts(device, left, right)
        assert device.it.counters().believed == believed


def test_a_state_that_the_map_calls_failed_is_a_fault_of_the_motors() -> None:
    device = two_wheels()
    message = read_dbc("two_wheels").get_message_by_name("DriveState")
    for state in (0, 1, 3):
        data = message.encode({"state": state, "fault": 0})
        device.bus.arrived.append(can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=False))
        if state != 3:
            device.it.step()
            assert device.it.status().state == state
    with pytest.raises(Exception, match="its power stage has failed"):
        device.it.step()


@pytest.fixture
def own(tmp_path: Path) -> FrameMap:
    """Speeds in m/s on an extended identifier, the left motor mounted the other way round, sums as checksums."""
    path = tmp_path / "own.dbc"
    path.write_text(DBC)
    return FrameMap(
        dbc=str(path),
        commands=(FrameSignals(frame="Speeds", signals=("left", "right"), units=(SignalUnit.M_S,), signs=(-1, 1)),),
        encoders=(FrameSignals(frame="Measured", signals=("left", "right"), signs=(-1, 1)),),
        measure="speed",
        stop=StopFrame(frame="Halt", values={"brake": 1}),
        status=StatusFrame(frame=""),
        counter="alive",
        checksum=Checksum.SUM8,
    )


def test_signs_units_and_checksums_of_an_own_file(own: FrameMap) -> None:
    device = BareDevice(MocDevice, base=BASE, frames=own)
    device.it.activate()
    device.it.drive(Twist2D(0.5))
    device.it.stop()
    first, second = device.bus.sent
    assert first.is_extended_id
    assert first.arbitration_id == 2147484000 - (1 << 31)
    assert list(first.data) == [50, 0, 206, 255, 1, (50 + 206 + 255 + 1) & 0xFF]
    assert (second.arbitration_id, list(second.data)) == (1002, [1, 2, 3])


def test_measured_speeds_are_added_up_to_odometry(own: FrameMap) -> None:
    device = BareDevice(MocDevice, base=BASE, frames=own)
    device.it.activate()
    for number in range(51):
        device.wait(0.02)
        data = bytes((256 - 200 & 0xFF, 255, 200, 0, number))  # 2 rad/s, the left motor the other way round
        frame = can.Message(arbitration_id=1001, data=data + bytes((sum(data) & 0xFF,)), is_extended_id=False)
        frame.timestamp = device.clock.now_ns() / 1e9
        device.bus.arrived.append(frame)
        device.it.step()
    pose = device.it.pose()
    assert pose.x_m == pytest.approx(2.0 * 0.1 * 50 * 0.02, rel=0.001)
    assert pose.yaw_rad == pytest.approx(0.0, abs=1e-9)


def signals(frame: str, *names: str) -> tuple[FrameSignals, ...]:
    return (FrameSignals(frame=frame, signals=names),)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"dbc": "/no/such.dbc"}, "dbc: cannot read /no/such.dbc: No such file or directory"),
        ({"dbc": "tricycle"}, "dbc: cannot read tricycle"),
        ({"commands": signals("Go", "a", "b")}, "frames.commands: there is no frame Go .* it has DriveCommand"),
        ({"commands": signals("DriveCommand", "left_rpm", "b")}, "DriveCommand has no signal b"),
        ({"commands": signals("DriveCommand", "left_rpm")}, "frames.commands: expected 2 signals .* got 1"),
        ({"encoders": signals("LeftEncoder", "left_counts", "left_speed_rpm")}, r"of one length, got \[16, 32\]"),
        ({"stop": StopFrame(frame="Stop")}, "frames.stop: there is no frame Stop"),
        ({"status": StatusFrame(frame="DriveState", state="mood")}, "frames.status: DriveState has no signal mood"),
    ],
)
def test_what_does_not_fit_the_file_or_the_base_is_refused_by_key(changes: dict[str, Any], why: str) -> None:
    device = BareDevice(MocDevice, base=BASE, frames=msgspec.structs.replace(FRAMES, **changes))
    with pytest.raises(ValueError, match=why):
        device.it.activate()


def test_a_file_that_is_no_dbc_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "no.dbc"
    path.write_text("BO_ what is this")
    with pytest.raises(ValueError, match=f"dbc: {path} is no DBC file"):
        read_dbc(str(path))


def test_frames_laid_out_like_the_robertinos_are_packed_as_by_its_own_codec() -> None:
    plain, message = codec("WheelCommand"), read_dbc("robertino").get_message_by_name("WheelCommand")
    general = SignalFrame(message, plain.signals, "counter", Checksum.CRC8_J1850_ID)
    data = plain.encode(7, 1.5, -2.25, 0.125)
    assert general.encode(7, 1.5, -2.25, 0.125) == data
    assert general.decode(data) == pytest.approx(plain.decode(data))
    with pytest.raises(BadFrame, match="wrong checksum"):
        general.decode(data[:-1] + bytes((data[-1] ^ 1,)))
    with pytest.raises(BadFrame, match="expected 8 bytes, got 7"):
        general.decode(data[:-1])
    with pytest.raises(OverflowError, match="WheelCommand"):
        general.encode(0, 1e9, 0.0, 0.0)


def test_checksums_are_those_of_their_names() -> None:
    dbc = read_dbc("robertino")
    message = dbc.get_message_by_name("Stop")
    body = SignalFrame(message, ("latched",), "counter", Checksum.NONE).encode(5, 1)[:-1]
    for kind, expected in (
        (Checksum.XOR8, 1 ^ 5),
        (Checksum.SUM8, 6),
        (Checksum.CRC8_J1850, crc8_j1850(body)),
        (Checksum.CRC8_J1850_ID, crc8_j1850(message.frame_id.to_bytes(2, "big") + body)),
    ):
        (frame,) = signal_frames(dbc, "Stop", ("latched",), "counter", kind)
        assert frame.encode(5, 1)[-1] == expected


MORE = """
BO_ 1021 Real: 8 Motor
 SG_ left : 0|32@1- (1,0) [0|0] "rad/s" Host
 SG_ right : 32|32@1- (1,0) [0|0] "rad/s" Host
BO_ 1022 Mixed: 4 Motor
 SG_ kind M : 0|8@1+ (1,0) [0|255] "" Host
 SG_ left m0 : 8|16@1- (1,0) [0|0] "" Host
 SG_ other m1 : 8|16@1- (1,0) [0|0] "" Host
SIG_VALTYPE_ 1021 left : 1;
SIG_VALTYPE_ 1021 right : 1;
"""


def test_values_that_are_no_numbers_and_signals_that_a_frame_lacks_make_it_a_bad_frame(tmp_path: Path) -> None:
    path = tmp_path / "more.dbc"
    path.write_text(DBC + MORE)
    dbc = read_dbc(str(path))
    real = SignalFrame(dbc.get_message_by_name("Real"), ("left", "right"), "", Checksum.NONE)
    assert real.decode(struct.pack("<2f", 1.5, -2.5)) == (1.5, -2.5)
    for bad in (math.nan, math.inf):
        with pytest.raises(BadFrame, match="Real: expected finite values"):
            real.decode(struct.pack("<2f", 1.5, bad))
    mixed = SignalFrame(dbc.get_message_by_name("Mixed"), ("left",), "", Checksum.NONE)
    assert mixed.decode(b"\x00\x05\x00\x00") == (5.0,)
    with pytest.raises(OtherPart, match="Mixed: its kind is 1"):
        mixed.decode(b"\x01\x05\x00\x00")


def test_values_that_the_frames_cannot_hold_are_refused_at_the_start_by_key(own: FrameMap) -> None:
    stop = StopFrame(frame="Halt", values={"brake": 256})
    large = msgspec.structs.replace(BASE, wheel_radius_m=0.5)
    with pytest.raises(ValueError, match=r"frames.stop.values: Halt"):
        BareDevice(MocDevice, base=BASE, frames=msgspec.structs.replace(own, stop=stop)).it.activate()
    with pytest.raises(ValueError, match=r"frames.commands, at wheel_speed_max_rad_s: Speeds"):
        BareDevice(MocDevice, base=large, frames=own, wheel_speed_max_rad_s=610.0).it.activate()
    BareDevice(MocDevice, base=large, frames=own, wheel_speed_max_rad_s=590.0).it.activate()  # 295 of 300 m/s


def test_a_bus_is_left_also_if_the_stop_cannot_be_sent() -> None:
    device = two_wheels()
    device.it._link.stop = lambda: 1 / 0
    with pytest.raises(ZeroDivisionError):
        device.it.deactivate()
    assert not device.bus.is_open


MAKERS = """VERSION ""
NS_ :
BS_:
BU_: Host Motor
BO_ 512 Drive: 4 Host
 SG_ left : 0|16@1- (0.1,0) [0|0] "rpm" Motor
 SG_ right : 16|16@1- (0.1,0) [0|0] "rpm" Motor
BO_ 513 Encoder: 5 Motor
 SG_ wheel M : 0|8@1+ (1,0) [0|3] "" Host
 SG_ left m0 : 8|32@1- (1,0) [0|0] "" Host
 SG_ right m1 : 8|32@1- (1,0) [0|0] "" Host
 SG_ long m2 : 8|64@1- (1,0) [0|0] "" Host
BO_ 514 Selected: 5 Host
 SG_ motor M : 0|8@1+ (1,0) [0|3] "" Motor
 SG_ left m1 : 8|16@1- (0.1,0) [0|0] "rpm" Motor
 SG_ right m2 : 8|16@1- (0.1,0) [0|0] "rpm" Motor
BO_ 600 Unused: 2 Motor
 SG_ one : 0|16@1- (1,0) [0|0] "" Host
 SG_ two : 8|16@1- (1,0) [0|0] "" Host
BO_ 601 Overlap: 8 Motor
 SG_ left : 0|32@1- (1,0) [0|0] "" Host
 SG_ right : 16|32@1- (1,0) [0|0] "" Host
 SG_ far : 48|32@1- (1,0) [0|0] "" Host
"""


def frames_of_makers(path: Path, **changes: Any) -> FrameMap:
    path.write_text(MAKERS)
    settings: dict[str, Any] = {
        "commands": (FrameSignals(frame="Drive", signals=("left", "right"), units=(SignalUnit.RPM,)),),
        "encoders": (FrameSignals(frame="Encoder", signals=("left", "right")),),
    }
    plain: dict[str, Any] = {"counter": "", "checksum": Checksum.NONE, "stop": StopFrame(frame="")}
    return FrameMap(dbc=str(path), status=StatusFrame(frame=""), **{**settings, **plain, **changes})


@pytest.mark.parametrize(
    ("signals", "why"),
    [
        (("left", "far"), "frames.encoders: Overlap: The signal far does not fit in message Overlap"),
        (("left", "right"), "frames.encoders: Overlap: The signals .* are overlapping in message Overlap"),
    ],
)
def test_a_signal_that_cannot_be_used_is_named_at_the_start(tmp_path: Path, signals: tuple[str, ...], why: str) -> None:
    encoders = (FrameSignals(frame="Overlap", signals=signals),)
    device = BareDevice(MocDevice, base=BASE, frames=frames_of_makers(tmp_path / "makers.dbc", encoders=encoders))
    with pytest.raises(ValueError, match=why):
        device.it.activate()


@pytest.mark.parametrize(
    ("identifier", "data", "why"),
    [
        (513, b"\0\0", "frames were refused: Encoder: expected 5 bytes, got 2"),
        (513, b"\0" * 5, "frames came, but not all counts of Encoder"),
        (77, b"\0" * 5, "frames came, but not all counts of Encoder"),
        (None, b"", "is cut or its controller gone"),
    ],
)
def test_refused_frames_are_no_silence(tmp_path: Path, identifier: int | None, data: bytes, why: str) -> None:
    device = BareDevice(MocDevice, base=BASE, frames=frames_of_makers(tmp_path / "makers.dbc"))
    device.it.activate()
    for wheel in (0, 1):
        counts = struct.pack("<Bi", wheel, 5)
        device.bus.arrived.append(can.Message(device.clock.now_ns() / 1e9, 513, False, data=counts))
    device.it.step()

    def pass_a_second() -> None:
        for _ in range(10):
            device.wait(0.1)
            if identifier is not None:
                device.bus.arrived.append(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
            device.it.step()

    with pytest.raises(BusFault, match=why):
        pass_a_second()
