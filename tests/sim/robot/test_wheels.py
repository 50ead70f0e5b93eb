import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.model.geometry import Twist2D
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.robot.wheels import Wheels, WheelSpec
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.scenarios.scenario_file import parse_scenario

BASE = OmniBase()
SPEEDS = st.tuples(*[st.floats(-10, 10)] * 3)


def wheels(seed=1, **spec):
    return Wheels.draw(BASE, WheelSpec(**spec), np.random.default_rng(seed))


@given(SPEEDS)
def test_exact_wheels_are_those_of_the_base(speeds):
    exact = wheels()
    assert exact.twist(*speeds) == BASE.twist(*speeds)
    twist = BASE.twist(*speeds)
    assert exact.turns_rad(twist) == BASE.wheel_speeds_rad_s(twist)
    assert WheelSpec().is_exact


@given(SPEEDS, st.integers(0, 1000))
def test_wheels_that_are_off_still_turn_as_they_are_told_when_nothing_holds_the_body(speeds, seed):
    off = wheels(seed, radius_sigma=0.01, base_sigma=0.02, slip=0.03)
    assert off.turns_rad(off.twist(*speeds)) == pytest.approx(speeds, abs=1e-9)


def test_errors_are_drawn_for_each_robot_and_are_of_the_size_that_is_asked_for():
    drawn = [wheels(seed, radius_sigma=0.01, base_sigma=0.02) for seed in range(400)]
    radii = np.array([each.radius_share for each in drawn])
    assert radii.mean() == pytest.approx(1.0, abs=0.002)
    assert radii.std() == pytest.approx(0.01, rel=0.1)
    bases = np.array([each.true.wheel_distance_m for each in drawn]) / BASE.wheel_distance_m
    assert bases.std() == pytest.approx(0.02, rel=0.15)
    assert wheels(3, radius_sigma=0.01).radius_share == wheels(3, radius_sigma=0.01).radius_share


def test_a_base_that_is_too_wide_turns_less_than_the_robot_thinks():
    wide = Wheels(
        BASE,
        OmniBase(wheel_distance_m=1.01 * BASE.wheel_distance_m),
        (1.0, 1.0, 1.0),
        WheelSpec(),
        np.random.default_rng(),
    )
    told = BASE.wheel_speeds_rad_s(Twist2D(0.0, 0.0, 1.0))
    assert wide.twist(*told).yaw_rad_s == pytest.approx(1.0 / 1.01)


def test_slip_makes_wheels_turn_farther_than_the_way():
    slipping = wheels(slip=0.05)
    turns = slipping.turns_rad(Twist2D(1.0, 0.0, 0.0))
    assert BASE.twist(*turns).forward_m_s == pytest.approx(1.0 / 0.95)


def odometry_of(slipping, displacement, steps):
    turns = np.array([slipping.turns_rad(displacement) for _ in range(steps)]).sum(axis=0)
    return BASE.twist(*turns)


@pytest.mark.parametrize("step_m", [0.01, 0.002])
def test_random_slip_grows_with_the_root_of_the_way_whatever_the_step(step_m):
    errors = []
    for seed in range(200):
        slipping = wheels(seed, slip_sigma_m_per_sqrt_m=0.02)
        errors.append(
            odometry_of(slipping, Twist2D(0.0, 0.0, step_m / BASE.wheel_distance_m), round(0.5 / step_m)).yaw_rad_s
        )
    # Each wheel has come 0.5 m along its tread; the mean of three turns the body.
    assert np.std(errors) == pytest.approx(0.02 * math.sqrt(0.5) / math.sqrt(3) / BASE.wheel_distance_m, rel=0.15)


def test_lateral_slip_turns_a_wheel_that_moves_along_its_axle():
    # The second wheel stands at 180°: its axle is the robot's x axis.
    turns = wheels(lateral_slip=0.1).turns_rad(Twist2D(1.0, 0.0, 0.0))
    assert turns[1] == pytest.approx(-0.1 / BASE.wheel_radius_m)
    lateral = [
        wheels(seed, lateral_sigma_m_per_sqrt_m=0.05).turns_rad(Twist2D(1.0, 0.0, 0.0))[1] for seed in range(300)
    ]
    assert np.std(lateral) == pytest.approx(0.05 / BASE.wheel_radius_m, rel=0.15)


def test_a_robot_that_stands_does_not_slip():
    slipping = wheels(slip_sigma_m_per_sqrt_m=0.1, lateral_sigma_m_per_sqrt_m=0.1, slip=0.1, lateral_slip=0.1)
    assert slipping.turns_rad(Twist2D()) == (0.0, 0.0, 0.0)


SCENARIO = """
[scenario]
name = "slippery"
[floor]
size_m = [8.0, 6.0]
resolution_m = 0.05
[team]
robots = 2
[robot.wheels]
radius_sigma = 0.01
slip_sigma_m_per_sqrt_m = 0.01
[robot.base]
encoder_ticks_per_turn = 128
"""


def driven(seed):
    """Where two robots of a scenario take themselves to be after some seconds, and where they are."""
    tables = parse_scenario(SCENARIO, "slippery.toml")
    scenario = Scenario(name="slippery", floor=tables.floor, robots=2, hardware=tables.robot, seed=seed)
    run = LockstepRun(scenario.world())
    try:
        for _ in range(250):
            run.tick()
        wheels_drawn = [robot.body.wheels.radius_share for robot in run.arena._robots]
        base = run.hosts[0].manager.get("mocdevice").plugin.parameters.base
        return wheels_drawn, run.truth.robots[0].pose, base
    finally:
        run.close()


@pytest.mark.slow
def test_a_scenario_s_wheels_are_drawn_for_each_robot_from_its_seed():
    drawn, pose, base = driven(1)
    assert drawn[0] != drawn[1]
    assert (drawn, pose, base) == driven(1)
    assert driven(2)[0] != drawn
    assert base.encoder_ticks_per_turn == 128  # the plugin knows the encoders, and not what is wrong with the wheels
    assert base.wheel_radius_m == BASE.wheel_radius_m
