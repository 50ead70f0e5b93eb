"""Dead reckoning: encoder counts in, poses out."""

import math

import pytest

from robrain.plugins.device.mocdevice.odometry import ENCODER_PERIOD_S, HISTORY_FRAMES, WheelOdometry
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad
from robrain.protocol.model.omni_drive import OmniBase
from robrain.protocol.wire.clock import to_ns

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
    assert one.take((500, 600, 700), 0, 0)
    assert (one.pose, one.velocity, one.ticks) == (START, Twist2D(), (500, 600, 700))
    assert one.take((501, 601, 701), 1, 0)
    assert one.pose.yaw_rad == pytest.approx(yaw_rad(1))


@pytest.mark.parametrize("missing", [0, 1, 9])
def test_wheels_turn_no_farther_than_they_can_in_the_time_that_is_missing(missing):
    limit = math.floor((missing + 1) * MOST)
    for over in (0, 1):
        one = fresh()
        one.take((0, 0, 0), 0, 0)
        assert one.take((limit + over, limit + over, limit + over), 1, missing) == (over == 0)
        assert one.jumps == (over > 0)
        assert (one.pose != START) == (over == 0)


@pytest.mark.parametrize("wheel", [0, 1, 2])
def test_one_wheel_that_jumps_is_a_jump_and_the_next_counts_go_on_from_there(wheel):
    one = fresh()
    one.take((0, 0, 0), 0, 0)
    jumped = [10, 10, 10]
    jumped[wheel] = 20_000
    assert not one.take(tuple(jumped), 1, 0)
    assert (one.pose, one.velocity, one.jumps) == (START, Twist2D(), 1)
    assert one.take(tuple(count + 5 for count in jumped), 2, 0)
    assert one.pose.yaw_rad == pytest.approx(yaw_rad(5))


def test_after_a_silence_all_motion_is_made_up_for_without_a_velocity():
    one = fresh()
    assert one.take((10_000, 10_000, 10_000), 0, 0)
    assert one.pose.yaw_rad == pytest.approx(wrap_angle_rad(yaw_rad(10_000)))
    assert one.velocity == Twist2D()


@pytest.mark.parametrize(("before", "after", "turned"), [(65_530, 4, 10), (4, 65_530, -10)])
def test_counter_that_wraps_goes_the_short_way(before, after, turned):
    one = fresh((before,) * 3)
    one.take((before,) * 3, 0, 0)
    one.take((after,) * 3, 1, 0)
    assert one.pose.yaw_rad == pytest.approx(yaw_rad(turned))


def test_robot_that_stands_has_no_velocity():
    one = fresh()
    one.take((0, 0, 0), 0, 0)
    one.take((5, 5, 5), 1, 0)
    assert one.velocity.yaw_rad_s == pytest.approx(yaw_rad(5) / ENCODER_PERIOD_S)
    one.take((5, 5, 5), 2, 0)
    assert one.velocity == Twist2D()


def test_pose_at_a_time_is_that_of_the_frame_nearest_to_it():
    one = fresh()
    poses = []
    for number in range(4):
        one.take((10 * number,) * 3, to_ns(0.1 * number), 0)
        poses.append(one.pose)
    asked = [(-1.0, 0), (0.0, 0), (0.04, 0), (0.05, 1), (0.06, 1), (0.1, 1), (0.149, 1), (0.151, 2), (0.29, 3)]
    assert [one.pose_at(to_ns(time_s)) for time_s, _ in asked] == [poses[index] for _, index in asked]
    assert one.pose_at(to_ns(0.3)) == one.pose_at(to_ns(9.0)) == poses[3]


def test_before_the_first_frame_the_pose_at_any_time_is_the_start():
    assert fresh().pose_at(5) == START


def test_a_second_of_frames_is_kept_and_no_more():
    one = fresh()
    for number in range(HISTORY_FRAMES + 10):
        one.take((number,) * 3, number, 0)
    assert one.pose_at(0).yaw_rad == pytest.approx(yaw_rad(10))
