"""The motor controller's device, frame by frame, on a fake bus."""

import math

import can
import pytest

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.plugins.device.mocdevice.frame_clock import StampedAt
from robrain.plugins.device.mocdevice.interface import BusFault, Counters, DriveCondition, MotorFault
from robrain.plugins.device.mocdevice.mocdevice import MocDevice
from robrain.plugins.device.mocdevice.wheel_device import Counting, WheelOdometry
from robrain.protocol.can.bus_state import BusState, error_frame
from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad
from tests.plugins.device.bare_device import BareDevice

WELL = {"rejected_frames": 1, "lost_commands": 2, "bus_state": 3, "transmit_errors": 4, "receive_errors": 5}
FAILED, RUNNING = 3, 0


@pytest.fixture
def device():
    """A device whose controller has not sent anything yet."""
    one = BareDevice(MocDevice)
    one.it.activate()
    return one


@pytest.fixture
def again():
    """The same after a restart: the controller has sent frames before."""
    one = BareDevice(MocDevice)
    one.board.T_odom_robot, one.board.wheel_ticks = Pose2D(1.0, 2.0, 0.5), (10, 20, 30)
    one.it.activate()
    return one


def encoders(one, counter=1, ticks=(0, 0, 0)):
    return one.hear("WheelEncoders", counter, **{f"wheel_{n + 1}_ticks": tick for n, tick in enumerate(ticks)})


def status(one, state, counter=1):
    return one.hear("MotorStatus", counter, state=state, **WELL)


# -- commands ---------------------------------------------------------------------------------------------------


def test_commands_and_stops_count_up_together_and_wrap_at_a_byte(device):
    device.it.drive(Twist2D(0.1))
    device.it.stop()
    device.it.drive(Twist2D(0.1))
    assert [(name, signals["counter"]) for name, signals in device.sent()] == [
        ("WheelCommand", 1),
        ("Stop", 2),
        ("WheelCommand", 3),
    ]
    for _ in range(255):
        device.it.stop()
    assert [signals["counter"] for _, signals in device.sent()][-4:] == [255, 0, 1, 2]


def test_command_at_the_wheels_limit_is_sent_as_it_is_and_one_beyond_keeps_its_direction(device):
    base = OmniBase()
    limit = base.twist(32.0, -16.0, 8.0)
    for share in (0.5, 1.0, 3.0):
        device.it.drive(Twist2D(*(share * each for each in (limit.forward_m_s, limit.left_m_s, limit.yaw_rad_s))))
    sent = [[signals[f"wheel_{n}_rad_s"] for n in (1, 2, 3)] for _, signals in device.sent()]
    assert sent == [
        pytest.approx([16.0, -8.0, 4.0], abs=2e-3),
        pytest.approx([32.0, -16.0, 8.0], abs=2e-3),
        pytest.approx([32.0, -16.0, 8.0], abs=2e-3),
    ]


@pytest.mark.parametrize(
    "twist", [Twist2D(math.nan), Twist2D(0.0, math.inf), Twist2D(0.0, 0.0, -math.inf), Twist2D(1e300)]
)
def test_velocity_that_is_no_number_is_refused_and_nothing_is_sent(device, twist):
    with pytest.raises(ValueError, match="expected a finite velocity"):
        device.it.drive(twist)
    assert device.sent() == []


def test_deactivated_device_stops_the_wheels_leaves_the_bus_and_says_nothing_more(device):
    device.it.deactivate()
    assert [name for name, _ in device.sent()] == ["Stop"]
    assert not device.bus.is_open
    device.it.stop()
    device.it.drive(Twist2D(0.1))
    device.it.deactivate()
    device.step()
    assert device.sent() == []


def test_halt_stops_the_wheels(device):
    device.it.emergency_halt()
    assert [name for name, _ in device.sent()] == ["Stop"]


# -- a bus that takes no frames ---------------------------------------------------------------------------------


@pytest.mark.parametrize("error", [can.CanOperationError("no buffer"), OSError("gone")])
def test_caller_is_not_to_blame_for_a_bus_that_takes_no_frames_and_the_devices_own_step_tells(device, error):
    conditions = device.told(device.it.condition)
    device.bus.fails = error
    device.it.drive(Twist2D(0.1))
    device.it.stop()
    device.bus.fails = None
    with pytest.raises(BusFault, match="the CAN bus takes no frames: "):
        device.step()
    assert [(one.ok, one.why.startswith("the CAN bus takes no frames")) for one in conditions] == [(False, True)]


@pytest.mark.parametrize("error", [can.CanOperationError("broken"), OSError("gone")])
def test_bus_that_cannot_be_read_is_a_fault_and_told(device, error):
    conditions = device.told(device.it.condition)
    device.bus.fails = error
    with pytest.raises(BusFault, match="the CAN bus cannot be read: "):
        device.step()
    assert [one.ok for one in conditions] == [False]


# -- silence ----------------------------------------------------------------------------------------------------


def test_controller_that_has_never_spoken_may_take_its_time_and_is_named_once_after_ten_seconds(device, caplog):
    device.step(9.9)
    assert not caplog.messages
    device.step(0.2)
    device.step(60.0)
    assert not device.it.is_fresh()
    (said,) = caplog.messages
    assert "no encoder frame yet: the CAN bus zenoh:can0 is cut" in said


def test_controller_that_falls_silent_is_fresh_for_just_so_long_and_then_a_fault(device):
    encoders(device)
    device.step()
    device.step(0.2)
    device.step(0.2)
    assert device.it.is_fresh()
    assert device.it.pose_if_fresh()[1] is True
    device.wait(1e-9)
    assert not device.it.is_fresh()
    assert device.it.pose_if_fresh()[1] is False
    with pytest.raises(BusFault, match=r"no encoder frame for 0\.40 s: the CAN bus zenoh:can0 is cut"):
        device.step()


def test_controller_that_does_not_speak_after_a_restart_is_a_fault_after_the_same_time(again):
    again.step(0.2)
    again.step(0.2)
    with pytest.raises(BusFault, match="no encoder frame"):
        again.step(0.001)


def test_process_that_stood_still_takes_its_pause_for_no_silence_but_is_not_fresh(device):
    encoders(device)
    device.step()
    device.step(30.0)
    assert not device.it.is_fresh()
    encoders(device, 2)
    device.step(0.01)
    assert device.it.is_fresh()
    for _ in range(2):
        device.step(30.0)
    with pytest.raises(BusFault, match="no encoder frame"):
        device.step(30.0)


def test_after_a_restart_nothing_is_driven_before_the_controller_speaks_but_a_stop_is_sent(again):
    conditions = again.told(again.it.condition)
    again.it.drive(Twist2D(0.1))
    again.it.stop()
    assert [name for name, _ in again.sent()] == ["Stop"]
    encoders(again)
    again.step()
    again.it.drive(Twist2D(0.1))
    assert [name for name, _ in again.sent()] == ["WheelCommand"]
    encoders(again, 2)
    again.step()
    assert conditions == [DriveCondition(True, "the motor controller speaks again")]


# -- frames -----------------------------------------------------------------------------------------------------


def test_frames_are_counted_by_what_they_are(device):
    encoders(device, 1)
    encoders(device, 4)
    encoders(device, 5, (30_000, 0, 0))  # no wheel can have turned so far
    corrupt = encoders(device, 6)
    corrupt.data[-1] ^= 1
    corrupt = status(device, RUNNING)
    corrupt.data[-1] ^= 1
    device.hear("BatteryStatus", 1, voltage_v=15.0, current_a=1.0, temperature_c=20.0)
    for changes in ({"is_extended_id": True}, {"is_remote_frame": True}):
        frame = encoders(device, 7)
        device.bus.arrived[-1] = can.Message(
            arbitration_id=frame.arbitration_id,
            data=None if "is_remote_frame" in changes else frame.data,
            **{"is_extended_id": False} | changes,
        )
    device.bus.arrived.append(can.Message(arbitration_id=0x7FF, is_extended_id=False))
    device.bus.arrived.append(error_frame(BusState.PASSIVE))
    device.step()
    assert device.it.counters() == Counters(believed=2, rejected=3, foreign=3, lost=2, errors=1)


def test_commands_that_another_gives_are_foreign_and_echoes_of_the_own_are_not(device):
    device.it.drive(Twist2D(0.1))
    device.it.stop()
    device.bus.arrived.extend(device.bus.sent)
    device.hear("WheelCommand", 200, wheel_1_rad_s=1.0, wheel_2_rad_s=1.0, wheel_3_rad_s=1.0)
    device.hear("Stop", 200, latched=1)
    device.step()
    assert device.it.counters().foreign == 2


def test_bus_off_is_a_fault_and_error_passive_is_a_warning(device, caplog):
    device.bus.arrived.append(error_frame(BusState.PASSIVE))
    device.bus.arrived.append(error_frame(BusState.WARNING))
    device.step()
    assert [record.message for record in caplog.records] == [
        "r1: the CAN bus is error passive: does another node acknowledge frames?"
    ]
    device.bus.arrived.append(error_frame(BusState.OFF))
    with pytest.raises(BusFault, match="bus off"):
        device.step()
    assert device.it.counters().errors == 3


# -- the power stage --------------------------------------------------------------------------------------------


def test_power_stage_that_has_failed_is_a_fault_at_once(device):
    status(device, FAILED)
    with pytest.raises(MotorFault, match="power stage has failed"):
        device.step()


def test_after_a_restart_the_failure_is_acknowledged_once_and_held_against_it_if_it_stays(again):
    for late_s in (0.0, 0.1):
        encoders(again)
        status(again, FAILED)
        again.step(late_s)
    assert [(name, signals["latched"]) for name, signals in again.sent()] == [("Stop", 0)]
    status(again, FAILED)
    with pytest.raises(MotorFault):
        again.step(0.001)


def test_failure_that_is_cleared_by_the_acknowledgement_is_forgotten(again):
    status(again, FAILED)
    again.step()
    for _ in range(5):
        encoders(again)
        status(again, RUNNING)
        again.step(0.2)


# -- odometry ---------------------------------------------------------------------------------------------------


def test_odometry_goes_on_where_it_was_and_is_left_on_the_board(again):
    assert again.it.pose() == Pose2D(1.0, 2.0, 0.5)
    encoders(again, 1, (11, 21, 31))
    again.step()
    turned_rad = OmniBase().twist(*[OmniBase().rad_per_tick] * 3).yaw_rad_s
    assert again.it.pose().yaw_rad == pytest.approx(0.5 + turned_rad)
    assert (again.board.T_odom_robot, again.board.wheel_ticks) == (again.it.pose(), (11, 21, 31))
    assert again.it.radius_m() == 0.2


@pytest.mark.parametrize(("off_s", "is_taken"), [(-0.9, True), (0.9, True), (-1.1, False), (50.0, False)])
def test_stamp_of_a_frame_counts_unless_it_is_of_another_clock(device, off_s, is_taken):
    frame = encoders(device, 1)
    frame.timestamp += off_s
    device.step()
    now_ns = device.clock.now_ns()
    stamp_ns = now_ns + round(off_s * 1e9) if is_taken else now_ns
    assert device.it.odometry_until_ns() == pytest.approx(stamp_ns, abs=1000)


def test_the_newest_pose_is_that_of_the_newest_frame_also_if_it_is_early():
    device = BareDevice(MocDevice, stamped_at=StampedAt.ARRIVAL)
    device.it.activate()
    for counter in (1, 2):
        encoders(device, counter, [30 * counter] * 3)
        device.step(0.75 * PERIOD_S)
    assert device.it.pose_at(device.it.odometry_until_ns()) == device.it.pose() != START


BASE = OmniBase()
START = Pose2D(0.0, 0.0, 0.0)
PERIOD_S = 0.02
COUNTING = Counting(1 << 16, BASE.rad_per_tick)
MOST = 2.0 * 32.0 * PERIOD_S / BASE.rad_per_tick
"""Ticks per frame above which the counter must have jumped: twice the wheels' maximum."""


def fresh(ticks=(0, 0, 0)):
    return WheelOdometry(BASE, 32.0, START, ticks, counting=COUNTING, period_s=PERIOD_S)


def yaw_rad(ticks):
    return BASE.twist(*[ticks * BASE.rad_per_tick] * 3).yaw_rad_s


def test_first_counts_are_where_the_robot_stands_if_none_are_known():
    one = fresh(None)
    assert one.follow((500, 600, 700), 0, 0)
    assert (one.pose, one.velocity, one.ticks) == (START, Twist2D(), (500, 600, 700))
    assert one.follow((501, 601, 701), 1, 0)
    assert one.pose.yaw_rad == pytest.approx(yaw_rad(1))


@pytest.mark.parametrize("missing", [0, 1, 9])
def test_wheels_turn_no_farther_than_they_can_in_the_time_that_is_missing(missing):
    limit = math.floor((missing + 1) * MOST)
    for over in (0, 1):
        one = fresh()
        one.follow((0, 0, 0), 0, 0)
        assert one.follow((limit + over, limit + over, limit + over), 1, missing) == (over == 0)
        assert (one.pose != START) == (over == 0)


@pytest.mark.parametrize("wheel", [0, 1, 2])
def test_one_wheel_that_jumps_is_a_jump_and_the_next_counts_go_on_from_there(wheel):
    one = fresh()
    one.follow((0, 0, 0), 0, 0)
    jumped = [10, 10, 10]
    jumped[wheel] = 20_000
    assert not one.follow(tuple(jumped), 1, 0)
    assert (one.pose, one.velocity) == (START, Twist2D())
    assert one.follow(tuple(count + 5 for count in jumped), 2, 0)
    assert one.pose.yaw_rad == pytest.approx(yaw_rad(5))


def test_after_a_silence_all_motion_is_made_up_for_without_a_velocity():
    one = fresh()
    assert one.follow((10_000, 10_000, 10_000), 0, 0)
    assert one.pose.yaw_rad == pytest.approx(wrap_angle_rad(yaw_rad(10_000)))
    assert one.velocity == Twist2D()


@pytest.mark.parametrize(("before", "after", "turned"), [(65_530, 4, 10), (4, 65_530, -10)])
def test_counter_that_wraps_goes_the_short_way(before, after, turned):
    one = fresh((before,) * 3)
    one.follow((before,) * 3, 0, 0)
    one.follow((after,) * 3, 1, 0)
    assert one.pose.yaw_rad == pytest.approx(yaw_rad(turned))


def test_frames_that_claim_to_be_of_a_later_time_are_forgotten_when_the_clock_was_set_back():
    one = fresh()
    for number, stamp_ns in enumerate((1000, 2000, 3000, 1500)):
        one.follow((number,) * 3, stamp_ns, 0)
    assert one.until_ns == 1500
    assert one.pose_at(1250).yaw_rad == pytest.approx(yaw_rad(1.5))


def test_angle_beyond_the_wheels_turns_the_newest_pose_alone():
    one = fresh()
    one.follow((0, 0, 0), to_ns(1.0), 0)
    one.follow((100, 100, 100), to_ns(1.02), 0)
    before = one.pose
    assert one.turned_rad == pytest.approx(yaw_rad(100))
    one.turn(0.25, 3.0)
    assert one.pose.yaw_rad == pytest.approx(before.yaw_rad + 0.25)
    assert (one.pose.x_m, one.pose.y_m) == (before.x_m, before.y_m)
    assert one.velocity.yaw_rad_s == 3.0
    assert one.pose_at(to_ns(1.02)) == one.pose
    assert one.pose_at(to_ns(1.0)) == START
    one.turn(-0.25, None)
    assert one.velocity.yaw_rad_s == 3.0
    assert one.follow((100, 100, 100), to_ns(1.04), 0)
    assert one.turned_rad == 0.0


def test_a_controller_that_has_started_again_as_well_counts_from_0_and_moves_nothing():
    one = fresh((9000, 61536, 60536))  # 9000, -4000, -5000 of 65,536
    assert not one.follow((3, 0, 65_535), 0, 0)
    assert one.pose == START
    assert one.follow((4, 1, 0), 1, 0)
    assert one.pose.yaw_rad == pytest.approx(yaw_rad(1))
