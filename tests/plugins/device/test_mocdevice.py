import math
from itertools import pairwise

import pytest

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.can.frames import codec
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.table.topics import ROBOT_STATE

BASE = OmniBase()
WHEELS = ("wheel_1", "wheel_2", "wheel_3")


class Controller:
    """The other end of the bus: tells encoder counts as firmware would, one frame a tick."""

    def __init__(self, stage, start=(0, 0, 0)):
        self.bus = stage.bus()
        self.counts = list(start)
        self.sent = 0

    def frame(self):
        ticks = {f"{wheel}_ticks": count % 65536 for wheel, count in zip(WHEELS, self.counts, strict=True)}
        self.sent += 1
        return codec("WheelEncoders").pack(self.sent, **ticks)

    def turn(self, *ticks):
        self.counts = [count + turned for count, turned in zip(self.counts, ticks, strict=True)]
        self.bus.send(self.frame())


def device(host):
    return host.manager.get("mocdevice").plugin


def counted(one, *names):
    counters = one.call("mocdevice", "counters")
    return [counters[name] for name in names]


def ticks_for(displacement):
    """Encoder ticks of a displacement (m, m, rad)."""
    return [turn_rad / BASE.rad_per_tick for turn_rad in BASE.wheel_speeds_rad_s(displacement)]


def test_encoder_frames_of_a_metre_forward_are_a_metre_of_odometry(stage):
    one = stage()
    host = one.host("mocdevice")
    controller = Controller(one)
    per_tick = [round(ticks) for ticks in ticks_for(Twist2D(0.01))]
    controller.turn(0, 0, 0)
    one.run(2.0, lambda: controller.turn(*per_tick))
    pose = device(host).pose()
    assert (pose.x_m, pose.y_m, pose.yaw_rad) == pytest.approx((1.0, 0.0, 0.0), abs=0.01)
    assert device(host).velocity().forward_m_s == pytest.approx(0.5, rel=0.01)
    assert counted(one, "believed", "rejected", "foreign") == [101, 0, 0]


def test_frames_that_arrive_in_a_burst_tell_of_no_greater_speed(stage):
    one = stage()
    host = one.host("mocdevice")
    controller = Controller(one)
    per_tick = [round(ticks) for ticks in ticks_for(Twist2D(0.01))]
    controller.turn(0, 0, 0)
    one.run(0.02)
    one.clock.advance_to(one.clock.now_ns() + 100_000_000)  # the computer was busy, or the bus
    told_m_s = []
    for _ in range(5):
        controller.turn(*per_tick)
        one.clock.advance_to(one.clock.now_ns() + 1_000_000)
        host.step()
        told_m_s.append(device(host).velocity().forward_m_s)
    assert told_m_s == pytest.approx([0.5] * 5, rel=0.01)


@pytest.mark.parametrize("step", [300, -300])
def test_counters_that_wrap_at_65536_drive_on(stage, step):
    one = stage()
    host = one.host("mocdevice")
    controller = Controller(one, (65400, 100, 65400))
    controller.turn(0, 0, 0)
    for _ in range(10):
        controller.turn(step, step, step)
    one.run(0.02)
    turned_rad = BASE.twist(*[10 * step * BASE.rad_per_tick] * 3).yaw_rad_s
    assert device(host).pose().yaw_rad == pytest.approx(turned_rad, abs=1e-9)
    assert abs(device(host).pose().x_m) < 1e-9


@pytest.mark.parametrize("byte", range(8))
def test_a_corrupt_encoder_frame_is_counted_and_not_believed(stage, byte):
    one = stage()
    host = one.host("mocdevice")
    controller = Controller(one)
    controller.turn(0, 0, 0)
    controller.counts = [500, 500, 500]
    frame = controller.frame()
    frame.data[byte] ^= 0x10
    controller.bus.send(frame)
    one.run(0.02)
    assert device(host).pose() == Pose2D(0.0, 0.0, 0.0)
    assert counted(one, "believed", "rejected", "foreign") == [1, 1, 0]


def test_a_frame_that_is_too_short_is_counted_and_not_believed(stage):
    one = stage()
    one.host("mocdevice")
    frame = Controller(one).frame()
    frame.data, frame.dlc = frame.data[:5], 5
    one.bus().send(frame)
    one.run(0.02)
    assert counted(one, "believed", "rejected", "foreign") == [0, 1, 0]


def test_the_next_good_frame_makes_up_for_a_corrupt_one(stage):
    one = stage()
    host = one.host("mocdevice")
    controller = Controller(one)
    controller.turn(0, 0, 0)
    controller.counts = [300, 300, 300]
    corrupt = controller.frame()
    corrupt.data[-1] ^= 0xFF
    controller.bus.send(corrupt)
    controller.turn(200, 200, 200)
    one.run(0.02)
    turned_rad = BASE.twist(*[500 * BASE.rad_per_tick] * 3).yaw_rad_s
    assert device(host).pose().yaw_rad == pytest.approx(turned_rad)


def test_a_commanded_velocity_is_on_the_bus_as_wheel_speeds(stage, frames):
    one = stage()
    host = one.host("mocdevice")
    bus = one.bus()
    twist = Twist2D(0.3, -0.1, 0.7)
    device(host).drive(twist)
    (command,) = frames(bus, "WheelCommand")
    speeds = [command[f"{wheel}_rad_s"] for wheel in WHEELS]
    assert speeds == pytest.approx(BASE.wheel_speeds_rad_s(twist), abs=1e-3)
    device(host).drive(twist)
    assert frames(bus, "WheelCommand")[0]["counter"] == command["counter"] + 1


def test_a_robot_that_is_shut_down_stops_its_wheels(stage, frames):
    one = stage()
    host = one.host("mocdevice")
    bus = one.bus()
    one.hosts.remove(host)
    host.close()
    assert len(frames(bus, "Stop")) == 1


def test_an_emergency_halt_stops_the_wheels_and_refuses_calls_until_resumed(stage, frames):
    one = stage()
    one.host("mocdevice")
    bus = one.bus()
    states = one.inbox(ROBOT_STATE)
    one.halt()
    one.run(0.2)
    assert len(frames(bus, "Stop")) == 1
    assert states.drain()[-1].message.halted
    with pytest.raises(CallError) as refused:
        one.call("mocdevice", "counters")
    assert refused.value.code is ErrorCode.HALTED
    one.halt(halted=False)
    one.run(0.2)
    assert one.call("mocdevice", "counters")["believed"] == 0
    assert not states.drain()[-1].message.halted


def test_the_pose_at_a_time_lies_between_the_encoder_frames_around_it(stage):
    one = stage()
    host = one.host("mocdevice")
    controller = Controller(one)
    assert device(host).odometry_until_ns() == 0
    controller.turn(0, 0, 0)
    poses = {}
    for _ in range(30):
        one.run(0.02, lambda: controller.turn(100, 100, 100))
        poses[one.clock.now_ns()] = device(host).pose()
        assert device(host).odometry_until_ns() == one.clock.now_ns()
    for stamp_ns, pose in poses.items():
        assert device(host).pose_at(stamp_ns) == pose
    for before_ns, after_ns in pairwise(poses):
        middle_rad = device(host).pose_at((before_ns + after_ns) // 2).yaw_rad
        assert middle_rad == pytest.approx((poses[before_ns].yaw_rad + poses[after_ns].yaw_rad) / 2)
    assert device(host).pose_at(one.clock.now_ns() + 10**9) == device(host).pose()
    assert math.isclose(device(host).pose_at(0).yaw_rad, 0.0)


@pytest.mark.parametrize(
    ("interface", "channel"),
    [
        ("socketcan", "nonexistent0"),
        ("no_such_interface", "can0"),
    ],
)
def test_a_robot_without_its_bus_goes_on_without_that_branch_and_says_why(stage, interface, channel):
    one = stage()
    states = one.inbox(ROBOT_STATE)
    one.host("explore", "teammates", mocdevice={"interface": interface, "channel": channel})
    one.run(1.0)
    infos = one.infos()
    active = {name for name, info in infos.items() if info.state == "active"}
    assert {"range_sensors", "scan", "teammates"} <= active
    for name in ("mocdevice", "driver", "localisation", "mapper", "explore"):
        assert infos[name].state == "faulted"
        assert f"no CAN bus at {interface}:{channel}" in infos[name].why
    assert infos["mocdevice"].why.startswith("hardware absent")
    assert infos["driver"].why.startswith("requires mocdevice, which is left out")
    assert len(states.drain()) >= 10
    assert one.call("teammates", "others") == []
