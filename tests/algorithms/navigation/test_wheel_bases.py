"""Bases described by their geometry: there and back, what they cannot do, and the limits of their commands."""

import math
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.navigation.wheel_bases import (
    WHEEL_ANGLES_RAD,
    Ackermann,
    Differential,
    Mecanum,
    Omni,
    OmniBase,
    WheelBase,
)
from robrain.protocol.model.checked import convert
from robrain.protocol.model.geometry import Twist2D

SIZES = st.floats(0.02, 0.5)
SPEEDS = st.floats(-3.0, 3.0)
SQUARE = (45.0, 135.0, 225.0, 315.0)
COMMON: dict[str, Any] = {"wheel_radius_m": SIZES, "encoder_ticks_per_turn": st.integers(10, 100_000)}
OMNIS = st.builds(Omni, wheel_distance_m=SIZES, wheel_angles_deg=st.just(SQUARE), **COMMON)
MECANUMS = st.builds(Mecanum, wheelbase_m=SIZES, track_m=SIZES, **COMMON)
DIFFERENTIALS = st.builds(Differential, track_m=SIZES, wheels_per_side=st.integers(1, 2), **COMMON)
CARS = st.builds(Ackermann, wheelbase_m=SIZES, track_m=SIZES, steering_max_rad=st.floats(0.2, 1.0), **COMMON)
PLAIN = {"wheel_radius_m": 0.1, "encoder_ticks_per_turn": 100}


@given(st.builds(OmniBase, wheel_radius_m=SIZES, wheel_distance_m=SIZES), st.builds(Twist2D, SPEEDS, SPEEDS, SPEEDS))
def test_each_wheel_rolls_with_the_floor_under_it(base: OmniBase, twist: Twist2D) -> None:
    for angle, speed in zip(WHEEL_ANGLES_RAD, base.wheel_speeds_rad_s(twist), strict=True):
        x, y = base.wheel_distance_m * math.cos(angle), base.wheel_distance_m * math.sin(angle)
        at_wheel_x, at_wheel_y = twist.forward_m_s - twist.yaw_rad_s * y, twist.left_m_s + twist.yaw_rad_s * x
        along_tangent = -math.sin(angle) * at_wheel_x + math.cos(angle) * at_wheel_y
        assert speed * base.wheel_radius_m == pytest.approx(along_tangent, abs=1e-9)


def as_tuple(twist: Twist2D) -> tuple[float, float, float]:
    return twist.forward_m_s, twist.left_m_s, twist.yaw_rad_s


@given(st.one_of(OMNIS, MECANUMS), SPEEDS, SPEEDS, SPEEDS)
def test_a_base_that_drives_sideways_gives_each_velocity_back(base: WheelBase, x: float, y: float, yaw: float) -> None:
    assert base.is_holonomic
    wheels = base.wheel_speeds_rad_s(Twist2D(x, y, yaw))
    assert len(wheels) == base.wheels == 4
    assert as_tuple(base.twist(*wheels)) == pytest.approx((x, y, yaw), abs=1e-9)


@given(st.one_of(DIFFERENTIALS, CARS), SPEEDS, SPEEDS, SPEEDS)
def test_one_that_does_not_leaves_the_sideways_part_out(base: WheelBase, x: float, y: float, yaw: float) -> None:
    assert not base.is_holonomic
    wheels = base.wheel_speeds_rad_s(Twist2D(x, y, yaw))
    assert len(wheels) == base.wheels
    assert as_tuple(base.twist(*wheels)) == pytest.approx((x, 0.0, yaw), abs=1e-9)


@given(SIZES, SIZES, SPEEDS, SPEEDS, SPEEDS)
def test_three_wheels_as_angles_are_the_robertinos(radius: float, reach: float, x: float, y: float, yaw: float) -> None:
    one = OmniBase(wheel_radius_m=radius, wheel_distance_m=reach, encoder_ticks_per_turn=100)
    angles = (60.0, 180.0, 300.0)
    other = Omni(wheel_radius_m=radius, wheel_distance_m=reach, wheel_angles_deg=angles, encoder_ticks_per_turn=100)
    twist = Twist2D(x, y, yaw)
    wheels = one.wheel_speeds_rad_s(twist)
    assert other.wheel_speeds_rad_s(twist) == pytest.approx(wheels)
    assert as_tuple(other.twist(*wheels)) == pytest.approx(as_tuple(one.twist(*wheels)), abs=1e-9)


def test_wheels_that_turn_alike_and_against_each_other_drive_as_everybody_expects() -> None:
    two = Differential(track_m=0.4, **PLAIN)
    assert as_tuple(two.twist(1.0, 1.0)) == pytest.approx((0.1, 0.0, 0.0))
    assert as_tuple(two.twist(-1.0, 1.0)) == pytest.approx((0.0, 0.0, 0.5))  # right wheel forward: to the left
    four = Mecanum(wheelbase_m=0.3, track_m=0.3, **PLAIN)
    assert as_tuple(four.twist(-1.0, 1.0, 1.0, -1.0)) == pytest.approx((0.0, 0.1, 0.0))  # to the left
    assert as_tuple(four.twist(-1.0, 1.0, -1.0, 1.0)) == pytest.approx((0.0, 0.0, 1 / 3))
    skid = Differential(track_m=0.4, wheels_per_side=2, **PLAIN)
    assert as_tuple(skid.twist(-1.0, -1.0, 1.0, 1.0)) == pytest.approx((0.0, 0.0, 0.5))


@given(st.one_of(OMNIS, MECANUMS, DIFFERENTIALS), SPEEDS, SPEEDS, SPEEDS, st.floats(0.5, 50.0))
def test_too_fast_a_wheel_slows_all_in_proportion(base: WheelBase, x: float, y: float, yaw: float, most: float) -> None:
    wanted, given_ = base.wheel_speeds_rad_s(Twist2D(x, y, yaw)), base.commands(Twist2D(x, y, yaw), most)
    assert max(map(abs, given_)) <= most * (1 + 1e-9)
    share = min(1.0, most / max(map(abs, wanted), default=1.0)) if any(wanted) else 1.0
    assert given_ == pytest.approx([share * speed for speed in wanted], abs=1e-9)


def test_a_car_is_told_a_speed_and_a_steering_angle() -> None:
    car = Ackermann(wheelbase_m=0.5, track_m=0.3, steering_max_rad=0.5, **PLAIN)
    assert car.commands(Twist2D(1.0, 0.0, 0.5), 100.0) == pytest.approx((10.0, math.atan(0.25)))
    assert car.commands(Twist2D(-1.0, 0.0, 0.5), 100.0) == pytest.approx((-10.0, -math.atan(0.25)))
    assert car.commands(Twist2D(0.1, 0.0, 3.0), 100.0) == pytest.approx((1.0, 0.5))
    assert car.commands(Twist2D(0.0, 0.0, 3.0), 100.0) == (0.0, 0.0)
    assert car.commands(Twist2D(9.0, 0.0, 0.0), 30.0) == (30.0, 0.0)
    assert car.turn_radius_min_m == pytest.approx(0.5 / math.tan(0.5))


@pytest.mark.parametrize(
    ("raw", "why"),
    [
        ({"type": "differential", **PLAIN, "track_m": 0.0}, "expected track_m > 0, got 0"),
        ({"type": "mecanum", **PLAIN, "track_m": 1.0, "wheelbase_m": -1.0}, "expected wheelbase_m > 0"),
        ({"type": "omni", **PLAIN, "wheel_distance_m": 1.0, "wheel_angles_deg": [0.0, 90.0]}, "length >= 3"),
        ({"type": "omni", **PLAIN, "wheel_distance_m": 1.0, "wheel_angles_deg": [0.0, 0.0, 0.0]}, "all directions"),
        ({"type": "tank", **PLAIN}, "Invalid value 'tank'"),
        ({**PLAIN, "track_m": 1.0}, "missing required field `type`"),
        ({"type": "differential", **PLAIN, "track": 1.0}, "unknown field `track`"),
    ],
)
def test_what_makes_no_base_is_refused_in_words(raw: dict[str, Any], why: str) -> None:
    with pytest.raises(msgspec.ValidationError, match=why):
        convert(raw, WheelBase)


@given(st.one_of(OMNIS, MECANUMS), SPEEDS, SPEEDS, SPEEDS)
def test_a_controller_does_what_the_commands_were_made_for(base: WheelBase, x: float, y: float, yaw: float) -> None:
    assert as_tuple(base.commanded(base.commands(Twist2D(x, y, yaw), 1e6))) == pytest.approx((x, y, yaw), abs=1e-9)


@given(CARS, st.floats(0.1, 3.0), st.sampled_from((1.0, -1.0)), st.floats(-1.0, 1.0))
def test_a_car_does_so_within_its_steering_and_turns_no_tighter(
    car: Ackermann, speed_m_s: float, way: float, share: float
) -> None:
    tightest_rad_s = speed_m_s / car.turn_radius_min_m
    for yaw_rad_s in (share * tightest_rad_s, 2.0 * math.copysign(tightest_rad_s, share)):
        done = car.commanded(car.commands(Twist2D(way * speed_m_s, 0.0, yaw_rad_s), 1e6))
        drivable_rad_s = max(-tightest_rad_s, min(tightest_rad_s, yaw_rad_s))
        assert as_tuple(done) == pytest.approx((way * speed_m_s, 0.0, drivable_rad_s), rel=1e-6, abs=1e-9)
