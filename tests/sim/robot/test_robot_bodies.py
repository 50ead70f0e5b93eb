"""Bodies of many robots in one space: each moves as it does alone, and as its wheels and power say."""

import math

import numpy as np
import pymunk
import pytest

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.sim.firmware.power_model import LOAD, PowerModel, add_motion
from robrain.sim.robot.robot_body import ACCELERATION_MAX_M_S2, CollisionCounter, RobotBodies, RobotBody
from robrain.sim.robot.wheels import Wheels, WheelSpec

TICK_S = 0.02
BASE = OmniBase()
SLIPPING = WheelSpec(
    radius_sigma=0.01,
    base_sigma=0.01,
    slip=0.02,
    slip_sigma_m_per_sqrt_m=0.01,
    lateral_slip=0.03,
    lateral_sigma_m_per_sqrt_m=0.005,
)
STARTS = (Pose2D(0.0, 0.0, 0.3), Pose2D(5.0, 0.0, -2.0), Pose2D(0.0, 5.0, 3.0))
TWISTS = (Twist2D(0.4, 0.1, 0.5), Twist2D(-0.3, 0.2, -1.0), Twist2D(0.0, 0.0, 2.0))


def wheels_of(seed, spec=SLIPPING):
    return Wheels.draw(BASE, spec, np.random.default_rng(seed))


def team(*starts, spec=SLIPPING, first_seed=1):
    space = pymunk.Space()
    bodies = [RobotBody(space, wheels_of(seed, spec), start, 0.2) for seed, start in enumerate(starts, first_seed)]
    return space, RobotBodies(space, bodies, TICK_S)


def run(space, bodies, ticks, twists):
    for row, twist in enumerate(twists):
        bodies.wanted_rad_s[row] = BASE.wheel_speeds_rad_s(twist)
    for _ in range(ticks):
        bodies.drive()
        space.step(TICK_S)
        bodies.roll()


def test_each_of_many_robots_moves_as_it_does_alone():
    space, together = team(*STARTS)
    run(space, together, 300, TWISTS)
    for row, (start, twist) in enumerate(zip(STARTS, TWISTS, strict=True)):
        space, alone = team(start, first_seed=row + 1)
        run(space, alone, 300, [twist])
        assert alone.state[0] == together.state[row]
        assert alone.turns_rad[0].tolist() == together.turns_rad[row].tolist()
        body = together.bodies[row]
        assert (body.x_m, body.y_m, body.yaw_rad, body.distance_m) == tuple(
            together.state[row][["x_m", "y_m", "yaw_rad", "distance_m"]].tolist()
        )


def test_a_robot_speeds_up_no_faster_than_its_wheels_hold():
    space, bodies = team(Pose2D(0.0, 0.0, 0.0), spec=WheelSpec())
    run(space, bodies, 1, [Twist2D(1.0, 0.0, 0.0)])
    assert bodies.bodies[0].forward_m == pytest.approx(ACCELERATION_MAX_M_S2 * TICK_S**2)
    run(space, bodies, 100, [Twist2D(1.0, 0.0, 0.0)])
    assert bodies.bodies[0].forward_m == pytest.approx(1.0 * TICK_S)


def test_a_robot_that_is_carried_off_stands_where_it_is_put_and_its_wheels_have_not_turned():
    space, bodies = team(Pose2D(0.0, 0.0, 0.0), spec=WheelSpec())
    run(space, bodies, 50, [Twist2D(0.5, 0.0, 0.0)])
    turns_rad, path_m = bodies.turns_rad.tolist(), bodies.bodies[0].distance_m
    bodies.bodies[0].carry_to(Pose2D(3.0, 2.0, 1.0))
    run(space, bodies, 1, [Twist2D(0.0, 0.0, 0.0)])
    assert bodies.bodies[0].pose == Pose2D(3.0, 2.0, 1.0)
    assert bodies.turns_rad.tolist() == turns_rad
    assert bodies.bodies[0].distance_m == path_m


def test_contacts_are_those_of_the_last_tick():
    space, bodies = team(Pose2D(0.0, 0.0, 0.0), Pose2D(0.5, 0.0, 0.0), spec=WheelSpec())
    counter = CollisionCounter(space, bodies, TICK_S)
    run(space, bodies, 40, [Twist2D(0.5, 0.0, 0.0), Twist2D(0.0, 0.0, 0.0)])
    assert counter.count == [1, 1]
    assert bodies.bodies[0].contacts_rad == pytest.approx([0.0], abs=0.01)
    assert np.abs(bodies.bodies[1].contacts_rad) == pytest.approx([math.pi], abs=0.01)
    run(space, bodies, 40, [Twist2D(-0.5, 0.0, 0.0), Twist2D(0.0, 0.0, 0.0)])
    assert [body.contacts_rad for body in bodies.bodies] == [[], []]


def test_the_energy_of_motion_is_that_of_rolling_turning_and_speeding_up_and_braking_gives_nothing_back():
    powers = [PowerModel(), PowerModel(payload_kg=2.0, speed2_w_per_m2_s2=3.0), PowerModel(drive_efficiency=0.3)]
    loads = np.array([power.row(4.0) for power in powers], LOAD)
    space, bodies = team(*STARTS)
    expected_j, speeds_m_s = np.zeros(3), np.zeros(3)
    for row, twist in enumerate(TWISTS):
        bodies.wanted_rad_s[row] = BASE.wheel_speeds_rad_s(twist)
    for tick in range(200):
        if tick == 120:
            bodies.wanted_rad_s[:] = 0.0
        bodies.drive()
        space.step(TICK_S)
        bodies.roll()
        add_motion(loads, bodies.state, TICK_S)
        for row, (power, body) in enumerate(zip(powers, bodies.bodies, strict=True)):
            speed_m_s = math.hypot(body.forward_m, body.left_m) / TICK_S
            expected_j[row] += TICK_S * power.motion_w(speed_m_s, body.turned_rad / TICK_S, 4.0)
            gained_j = 0.5 * (4.0 + power.payload_kg) * (speed_m_s**2 - speeds_m_s[row] ** 2)
            expected_j[row] += max(0.0, gained_j) / power.drive_efficiency
            speeds_m_s[row] = speed_m_s
    assert min(loads["motion_j"]) > 0.5
    assert loads["motion_j"].tolist() == pytest.approx(expected_j.tolist(), rel=1e-9)
