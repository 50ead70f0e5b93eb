"""Poses between those that were measured."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.localization.odometry import PoseTrack
from robrain.protocol.model.geometry import Pose2D

ORIGIN = Pose2D(0.0, 0.0, 0.0)
TRACK = [(100, Pose2D(0.0, 0.0, 3.0)), (200, Pose2D(1.0, -2.0, -3.0)), (400, Pose2D(3.0, 0.0, -3.0))]


def test_between_two_entries_it_lies_between_them_the_short_way_round() -> None:
    found = PoseTrack(ORIGIN, 8, TRACK).pose_at(150)
    assert (found.x_m, found.y_m) == (0.5, -1.0)
    assert abs(found.yaw_rad) == pytest.approx(math.pi)


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


@given(st.integers(100, 400))
def test_each_entry_is_met_and_ways_are_straight(stamp_ns: int) -> None:
    found = PoseTrack(ORIGIN, 8, TRACK).pose_at(stamp_ns)
    expected = (stamp_ns - 100) / 100 if stamp_ns <= 200 else 1.0 + (stamp_ns - 200) / 100
    assert found.x_m == pytest.approx(expected)
