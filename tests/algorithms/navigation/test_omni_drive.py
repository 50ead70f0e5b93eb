import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.navigation.wheel_bases import WHEEL_ANGLES_RAD, OmniBase
from robrain.protocol.model.geometry import Twist2D

BASES = st.builds(OmniBase, wheel_radius_m=st.floats(0.01, 0.5), wheel_distance_m=st.floats(0.05, 2.0))
SPEEDS = st.floats(-5.0, 5.0)
TWISTS = st.builds(Twist2D, SPEEDS, SPEEDS, SPEEDS)


def as_tuple(twist):
    return twist.forward_m_s, twist.left_m_s, twist.yaw_rad_s


@given(BASES, TWISTS)
def test_the_wheels_of_a_velocity_give_that_velocity_back(base, twist):
    assert as_tuple(base.twist(*base.wheel_speeds_rad_s(twist))) == pytest.approx(as_tuple(twist), abs=1e-9)


@given(BASES, st.tuples(SPEEDS, SPEEDS, SPEEDS))
def test_the_velocity_of_wheel_speeds_needs_those_wheel_speeds(base, wheels):
    assert base.wheel_speeds_rad_s(base.twist(*wheels)) == pytest.approx(wheels, abs=1e-9)


@given(BASES, TWISTS)
def test_each_wheel_rolls_with_the_floor_under_it(base, twist):
    for angle, speed in zip(WHEEL_ANGLES_RAD, base.wheel_speeds_rad_s(twist), strict=True):
        x, y = base.wheel_distance_m * math.cos(angle), base.wheel_distance_m * math.sin(angle)
        at_wheel_x, at_wheel_y = twist.forward_m_s - twist.yaw_rad_s * y, twist.left_m_s + twist.yaw_rad_s * x
        along_tangent = -math.sin(angle) * at_wheel_x + math.cos(angle) * at_wheel_y
        assert speed * base.wheel_radius_m == pytest.approx(along_tangent, abs=1e-9)


def test_turning_on_the_spot_turns_all_wheels_alike():
    base = OmniBase()
    expected = base.wheel_distance_m / base.wheel_radius_m
    assert base.wheel_speeds_rad_s(Twist2D(yaw_rad_s=1.0)) == pytest.approx((expected,) * 3)


def test_straight_ahead_leaves_the_rear_wheel_unturned():
    first, rear, third = OmniBase().wheel_speeds_rad_s(Twist2D(forward_m_s=1.0))
    assert rear == pytest.approx(0.0, abs=1e-12)
    assert first == pytest.approx(-third)
    assert first < 0 < third  # wheel 1 stands front left: its tangent points backwards


def test_a_turn_of_the_wheel_has_as_many_ticks_as_it_is_said():
    assert OmniBase(encoder_ticks_per_turn=100).rad_per_tick * 100 == pytest.approx(2 * math.pi)


@pytest.mark.parametrize("name", ["wheel_radius_m", "wheel_distance_m", "encoder_ticks_per_turn"])
@pytest.mark.parametrize("size", [0, -1])
def test_a_base_has_sizes_above_zero(name, size):
    with pytest.raises(ValueError, match=f"expected {name} >=? [01], got {size}"):
        OmniBase(**{name: size})
