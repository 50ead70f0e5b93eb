"""Dead reckoning: encoder counts in, poses out."""

import math

import pytest

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.plugins.device.mocdevice.wheel_device import ENCODER_PERIOD_S, HISTORY_FRAMES, WheelOdometry
from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad

BASE = OmniBase()
START = Pose2D(0.0, 0.0, 0.0)
MOST = 2.0 * 32.0 * ENCODER_PERIOD_S / BASE.rad_per_tick
"""Ticks per frame above which the counter must have jumped: twice the wheels' maximum."""


def fresh(ticks=(0, 0, 0)):
    return WheelOdometry(BASE, 32.0, START, ticks)


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
        assert one.jumps == (over > 0)
        assert (one.pose != START) == (over == 0)


@pytest.mark.parametrize("wheel", [0, 1, 2])
def test_one_wheel_that_jumps_is_a_jump_and_the_next_counts_go_on_from_there(wheel):
    one = fresh()
    one.follow((0, 0, 0), 0, 0)
    jumped = [10, 10, 10]
    jumped[wheel] = 20_000
    assert not one.follow(tuple(jumped), 1, 0)
    assert (one.pose, one.velocity, one.jumps) == (START, Twist2D(), 1)
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


def test_robot_that_stands_has_no_velocity():
    one = fresh()
    one.follow((0, 0, 0), 0, 0)
    one.follow((5, 5, 5), 1, 0)
    assert one.velocity.yaw_rad_s == pytest.approx(yaw_rad(5) / ENCODER_PERIOD_S)
    one.follow((5, 5, 5), 2, 0)
    assert one.velocity == Twist2D()


def test_frames_that_claim_to_be_of_a_later_time_are_forgotten_when_the_clock_was_set_back():
    one = fresh()
    for number, stamp_ns in enumerate((1000, 2000, 3000, 1500)):
        one.follow((number,) * 3, stamp_ns, 0)
    assert one.until_ns == 1500
    assert one.pose_at(1250).yaw_rad == pytest.approx(yaw_rad(1.5))


def test_five_seconds_of_frames_are_kept_and_no_more():
    assert pytest.approx(5.0, abs=0.2) == HISTORY_FRAMES * ENCODER_PERIOD_S
    one = fresh()
    for number in range(HISTORY_FRAMES + 10):
        one.follow((number,) * 3, number, 0)
    assert one.pose_at(0).yaw_rad == pytest.approx(yaw_rad(10))


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
    assert (one.pose, one.jumps) == (START, 1)
    assert one.follow((4, 1, 0), 1, 0)
    assert one.pose.yaw_rad == pytest.approx(yaw_rad(1))


def test_counts_that_went_on_while_nobody_listened_are_motion_however_near_to_0():
    one = fresh((100, 100, 100))
    assert one.follow((160, 160, 160), 0, 0)
    assert one.pose.yaw_rad == pytest.approx(yaw_rad(60))
