"""Robots with other wheels than three omni ones: the same plugins, other frames on the bus."""

import math

import pytest

from robrain import Scenario
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.world.robot_specs import WHEELS, RobotSpec, RobotType

TWO = Scenario.builtin("arena_small").replace(robots=1, motes=0, roster=(RobotSpec(type=RobotType.TWO_WHEELS),))


@pytest.mark.slow
def test_odometry_is_as_exact_as_the_wheels_and_only_holonomic_hulls_slide_sideways() -> None:
    exact, by_lines, car = (0.01, 0.002), (0.05, 0.05), (0.02, 0.005)  # counts by lines are asked for at 20 Hz
    bases = {
        RobotType.TWO_WHEELS: exact,
        RobotType.SERIAL: by_lines,
        RobotType.FOUR_OMNI: exact,
        RobotType.MECANUM: exact,
        RobotType.CAR: car,
    }
    depot = Scenario.builtin("depot").replace(robots=len(bases), motes=0, seed=3)
    run = LockstepRun(depot.replace(roster=tuple(RobotSpec(type=kind) for kind in bases)).world())
    robots = run.arena._robots
    starts, sideways_m, turned_rad = [robot.body.pose for robot in robots], [0.0] * len(bases), [0.0] * len(bases)
    for _ in range(500):
        run.tick()
        for number, robot in enumerate(robots):
            sideways_m[number] += abs(robot.body.left_m)
            turned_rad[number] += abs(robot.body.turned_rad)
    for number, (kind, (off_m, off_rad)) in enumerate(bases.items()):
        device, body = run.hosts[number].manager.get("mocdevice").plugin, robots[number].body
        found = starts[number].compose(device.pose())
        assert body.distance_m > 1.0, kind
        assert found.distance_m(body.pose) < off_m, kind
        assert math.remainder(found.yaw_rad - body.pose.yaw_rad, math.tau) == pytest.approx(0.0, abs=off_rad), kind
        is_holonomic = kind in (RobotType.FOUR_OMNI, RobotType.MECANUM)
        assert (sideways_m[number] > 0.05) if is_holonomic else (sideways_m[number] < 0.01), kind
        assert (device.is_holonomic(), device.counters().rejected) == (is_holonomic, 0), kind
        if kind is RobotType.CAR:
            assert turned_rad[number] < body.distance_m / device.turn_radius_min_m() + 0.2
    assert run.arena.collisions == 0
    run.close()


def test_a_serial_controller_of_other_than_two_wheels_is_refused() -> None:
    with pytest.raises(ValueError, match='controller: expected a chassis of type = "differential" for "lines"'):
        RobotSpec(type=RobotType.MECANUM, hardware={"controller": "lines"})


def test_wheels_that_no_simulated_controller_turns_are_refused_with_their_key() -> None:
    wide = {"chassis": {"type": "differential", "wheels_per_side": 2, "track_m": 0.3, **WHEELS}}
    with pytest.raises(ValueError, match="chassis: expected wheels_per_side = 1 in the simulator, got 4 wheels"):
        RobotSpec(hardware=wide)


@pytest.mark.slow
def test_wheels_stop_when_commands_cease_and_a_failed_power_stage_is_told_and_acknowledged() -> None:
    run = LockstepRun(TWO.world())
    robot, plugin = run.arena._robots[0], run.hosts[0].manager.get("mocdevice")
    controller = robot.described
    assert controller is not None
    for _ in range(200):
        run.tick()
        if any(controller.wheel_speeds_rad_s):
            break
    assert any(controller.wheel_speeds_rad_s)
    controller.has_failed = True
    for _ in range(20):
        run.tick()
    assert controller.wheel_speeds_rad_s == (0.0, 0.0, 0.0)
    assert "its power stage has failed" in plugin.state_reason
    controller.has_failed = False
    for _ in range(400):
        run.tick()
        if any(controller.wheel_speeds_rad_s):
            break
    assert any(controller.wheel_speeds_rad_s)
    run.close()


@pytest.mark.slow
def test_a_mixed_team_explores_without_collisions() -> None:
    kinds = (RobotType.SERIAL, RobotType.CAR, RobotType.MECANUM)
    result = TWO.replace(robots=3, roster=tuple(RobotSpec(type=kind) for kind in kinds), seed=5).run()
    assert (result.ended, result.collisions) == ("explored", 0)
