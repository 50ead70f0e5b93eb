import math

import numpy as np
import pymunk
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.sim.robot.robot_body import MOTION, STATE, WHEELS, RobotBodies, RobotBody, roll
from robrain.sim.robot.wheels import Wheels, WheelSpec

BASE = OmniBase()
SPEEDS = st.tuples(*[st.floats(-10, 10)] * 3)


def wheels(seed=1, **spec):
    return Wheels.draw(BASE, WheelSpec(**spec), np.random.default_rng(seed))


def turns_rad(drawn: Wheels, displacement: Twist2D, steps: int = 1) -> np.ndarray:
    """Turns of the wheels while a body moves by this (m, m, rad) in each of some steps."""
    state, wheels = np.zeros(1, STATE), np.zeros(1, WHEELS)
    wheels[0] = drawn.row
    turns, normals = np.zeros((1, 3)), np.array([[each for _ in range(4) for each in drawn.draw_normals()]])
    used, motion = np.zeros(1, np.int64), np.zeros((1, MOTION))
    for _ in range(steps):
        half_rad = state[0]["yaw_rad"] + displacement.yaw_rad_s / 2
        cos, sin = math.cos(half_rad), math.sin(half_rad)
        motion[0, 0] += cos * displacement.forward_m_s - sin * displacement.left_m_s
        motion[0, 1] += sin * displacement.forward_m_s + cos * displacement.left_m_s
        motion[0, 2] += displacement.yaw_rad_s
        roll(state, motion, wheels, turns, normals, used, 10_000)
    return turns[0]


def driven_m(drawn: Wheels, *speeds_rad_s: float) -> Twist2D:
    """Displacement of a free body, in a second at these speeds of its wheels."""
    space = pymunk.Space()
    bodies = RobotBodies(space, [RobotBody(space, drawn, Pose2D(0.0, 0.0, 0.0), 0.2)], 1.0)
    bodies.wanted_rad_s[0] = speeds_rad_s
    for _ in range(20):
        bodies.drive()
        space.step(1.0)
        bodies.roll()
    return Twist2D(*bodies.state[0][["forward_m", "left_m", "turned_rad"]].tolist())


@given(SPEEDS)
def test_exact_wheels_are_those_of_the_base(speeds):
    twist = BASE.twist(*speeds)
    assert turns_rad(wheels(), twist) == pytest.approx(BASE.wheel_speeds_rad_s(twist), abs=1e-9)
    moved = driven_m(wheels(), *speeds)
    assert (moved.forward_m_s, moved.left_m_s, moved.yaw_rad_s) == pytest.approx(
        (twist.forward_m_s, twist.left_m_s, twist.yaw_rad_s), abs=1e-6
    )
    assert WheelSpec().is_exact


def test_errors_are_drawn_for_each_robot_and_are_of_the_size_that_is_asked_for():
    drawn = [wheels(seed, radius_sigma=0.01, base_sigma=0.02) for seed in range(400)]
    radii = np.array([each.radius_share for each in drawn])
    assert radii.mean() == pytest.approx(1.0, abs=0.002)
    assert radii.std() == pytest.approx(0.01, rel=0.1)
    bases = np.array([each.true.wheel_distance_m for each in drawn]) / BASE.wheel_distance_m
    assert bases.std() == pytest.approx(0.02, rel=0.15)
    assert wheels(3, radius_sigma=0.01).radius_share == wheels(3, radius_sigma=0.01).radius_share


def test_slip_makes_wheels_turn_farther_than_the_way():
    turns = turns_rad(wheels(slip=0.05), Twist2D(1.0, 0.0, 0.0))
    assert BASE.twist(*turns).forward_m_s == pytest.approx(1.0 / 0.95)


@pytest.mark.parametrize("step_m", [0.01, 0.002])
def test_random_slip_grows_with_the_root_of_the_way_whatever_the_step(step_m):
    turn = Twist2D(0.0, 0.0, step_m / BASE.wheel_distance_m)
    errors = [
        BASE.twist(*turns_rad(wheels(seed, slip_sigma_m_per_sqrt_m=0.02), turn, round(0.5 / step_m))).yaw_rad_s
        for seed in range(200)
    ]
    # Each wheel has come 0.5 m along its tread; the mean of three turns the body.
    assert np.std(errors) == pytest.approx(0.02 * math.sqrt(0.5) / math.sqrt(3) / BASE.wheel_distance_m, rel=0.15)


def test_lateral_slip_turns_a_wheel_that_moves_along_its_axle():
    # The second wheel stands at 180°: its axle is the robot's x axis.
    turns = turns_rad(wheels(lateral_slip=0.1), Twist2D(1.0, 0.0, 0.0))
    assert turns[1] == pytest.approx(-0.1 / BASE.wheel_radius_m)
    lateral = [
        turns_rad(wheels(seed, lateral_sigma_m_per_sqrt_m=0.05), Twist2D(1.0, 0.0, 0.0))[1] for seed in range(300)
    ]
    assert np.std(lateral) == pytest.approx(0.05 / BASE.wheel_radius_m, rel=0.15)


def test_a_robot_that_stands_does_not_slip():
    slipping = wheels(slip_sigma_m_per_sqrt_m=0.1, lateral_sigma_m_per_sqrt_m=0.1, slip=0.1, lateral_slip=0.1)
    assert turns_rad(slipping, Twist2D()).tolist() == [0.0, 0.0, 0.0]
