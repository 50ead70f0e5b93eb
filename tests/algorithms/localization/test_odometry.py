"""Poses between those that were measured."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.localization.odometry import PoseTrack, moved
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad

START = Pose2D(1.0, -2.0, 0.7)
SPEEDS = st.floats(-1.0, 1.0)


def drive(pose, twist, *, duration_s, steps):
    dt = duration_s / steps
    for _ in range(steps):
        pose = moved(pose, Twist2D(twist.forward_m_s * dt, twist.left_m_s * dt, twist.yaw_rad_s * dt))
    return pose


def on_circle(pose, twist, duration_s):
    """Where constant velocity leads: a circle about the point that stands still in the body frame."""
    center_x, center_y = -twist.left_m_s / twist.yaw_rad_s, twist.forward_m_s / twist.yaw_rad_s
    turn = twist.yaw_rad_s * duration_s
    body = Pose2D(
        center_x - math.cos(turn) * center_x + math.sin(turn) * center_y,
        center_y - math.sin(turn) * center_x - math.cos(turn) * center_y,
        turn,
    )
    return pose.compose(body)


def assert_same_pose(one, other, tolerance):
    assert (one.x_m, one.y_m) == pytest.approx((other.x_m, other.y_m), abs=tolerance)
    assert wrap_angle_rad(one.yaw_rad - other.yaw_rad) == pytest.approx(0.0, abs=tolerance)


@pytest.mark.slow
@given(SPEEDS, SPEEDS, st.floats(0.05, 2.0), st.sampled_from([-1, 1]), st.integers(1, 60))
def test_small_steps_add_up_to_the_circle(forward, left, turn_rate, side, steps):
    twist = Twist2D(forward, left, side * turn_rate)
    assert_same_pose(drive(START, twist, duration_s=3.0, steps=steps), on_circle(START, twist, 3.0), 1e-9)


@given(SPEEDS, SPEEDS)
def test_without_turning_the_way_is_straight(forward, left):
    end = moved(START, Twist2D(forward, left, 0.0))
    assert_same_pose(end, START.compose(Pose2D(forward, left, 0.0)), 1e-12)


ORIGIN = Pose2D(0.0, 0.0, 0.0)
TRACK = [(100, Pose2D(0.0, 0.0, 3.0)), (200, Pose2D(1.0, -2.0, -3.0)), (400, Pose2D(3.0, 0.0, -3.0))]


def test_outside_it_is_the_nearest_entry_and_without_any_the_first_pose() -> None:
    track = PoseTrack(ORIGIN, 8, TRACK)
    assert (track.pose_at(0), track.pose_at(400), track.pose_at(999)) == (TRACK[0][1], TRACK[2][1], TRACK[2][1])
    assert (track.pose, track.until_ns) == (TRACK[2][1], 400)
    empty = PoseTrack(ORIGIN, 8)
    assert (empty.pose_at(5), empty.until_ns) == (ORIGIN, None)


def test_only_the_last_entries_are_kept() -> None:
    track = PoseTrack(ORIGIN, 2)
    for stamp_ns, pose in TRACK:
        track.add(stamp_ns, pose)
    assert track.pose_at(150) == TRACK[1][1]


def test_between_two_entries_it_lies_between_them_the_short_way_round() -> None:
    found = PoseTrack(ORIGIN, 8, TRACK).pose_at(150)
    assert (found.x_m, found.y_m) == (0.5, -1.0)
    assert abs(found.yaw_rad) == pytest.approx(math.pi)
