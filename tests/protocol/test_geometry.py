import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.model.geometry import Point2D, Pose2D, wrap_angle_rad

METRES = st.floats(-1e3, 1e3)
ANGLES = st.floats(-10.0, 10.0)
POSES = st.builds(Pose2D, METRES, METRES, ANGLES)


def assert_same_pose(one, other):
    assert (one.x_m, one.y_m) == pytest.approx((other.x_m, other.y_m), abs=1e-8)
    assert wrap_angle_rad(one.yaw_rad - other.yaw_rad) == pytest.approx(0.0, abs=1e-9)


@given(POSES)
def test_a_pose_and_its_inverse_make_the_identity(T_a_b):
    assert_same_pose(T_a_b.compose(T_a_b.inverse()), Pose2D(0.0, 0.0, 0.0))
    assert_same_pose(T_a_b.inverse().compose(T_a_b), Pose2D(0.0, 0.0, 0.0))


@given(POSES, POSES, POSES)
def test_composing_is_associative(T_a_b, T_b_c, T_c_d):
    assert_same_pose(T_a_b.compose(T_b_c).compose(T_c_d), T_a_b.compose(T_b_c.compose(T_c_d)))


@pytest.mark.parametrize(
    ("angle_rad", "wrapped_rad"),
    [
        (math.pi, math.pi),  # the closed end
        (-math.pi, math.pi),  # the open end is the closed one
        (math.nextafter(-math.pi, 0), math.nextafter(-math.pi, 0)),  # just inside
        (3 * math.pi, math.pi),  # once round
        (0.0, 0.0),  # nothing to do
    ],
)
def test_the_ends_of_the_range_are_where_they_are_said_to_be(angle_rad, wrapped_rad):
    assert wrap_angle_rad(angle_rad) == pytest.approx(wrapped_rad, abs=1e-12)


def test_points_are_apart_by_the_straight_line():
    assert Point2D(1.0, 4.0).distance_m(Point2D(5.0, 1.0)) == 5.0
