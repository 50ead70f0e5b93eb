"""Robots with other wheels than three omni ones: the same plugins, other frames on the bus."""

import math

import pytest

from robrain import Scenario
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.world.robot_specs import WHEELS, RobotSpec, RobotType

TWO = Scenario.builtin("arena_small").replace(robots=1, motes=0, roster=(RobotSpec(type=RobotType.TWO_WHEELS),))


@pytest.mark.slow
def test_odometry_of_two_wheels_is_exact_and_the_hull_never_slides_sideways() -> None:
    run = LockstepRun(TWO.replace(seed=3).world())
    (robot,), start, sideways_m = run.arena._robots, run.arena._robots[0].body.pose, 0.0
    for _ in range(500):
        run.tick()
        sideways_m += abs(robot.body.left_m)
    device = run.hosts[0].manager.get("mocdevice").plugin
    true, found = robot.body.pose, start.compose(device.pose())
    assert robot.body.distance_m > 3.0
    assert found.distance_m(true) < 0.01
    assert math.remainder(found.yaw_rad - true.yaw_rad, math.tau) == pytest.approx(0.0, abs=0.002)
    assert sideways_m < 0.01
    counters = device.counters()
    assert (counters.rejected, counters.foreign) == (0, 0)
    assert not device.is_holonomic()
    run.close()


@pytest.mark.slow
def test_odometry_by_lines_of_text_is_as_true_as_that_by_frames() -> None:
    run = LockstepRun(TWO.replace(seed=3, roster=(RobotSpec(type=RobotType.SERIAL),)).world())
    (robot,), start = run.arena._robots, run.arena._robots[0].body.pose
    for _ in range(500):
        run.tick()
    device = run.hosts[0].manager.get("mocdevice").plugin
    assert type(device).__name__ == "SerialBase"
    true, found = robot.body.pose, start.compose(device.pose())
    assert robot.body.distance_m > 3.0
    assert found.distance_m(true) < 0.05  # counts are asked for at 20 Hz
    assert math.remainder(found.yaw_rad - true.yaw_rad, math.tau) == pytest.approx(0.0, abs=0.05)
    assert device.counters().rejected == 0
    assert robot.controller.rejected_frames == 0
    run.close()


def test_a_serial_controller_of_other_than_two_wheels_is_refused() -> None:
    with pytest.raises(ValueError, match='controller: expected a chassis of type = "differential" for "lines"'):
        RobotSpec(type=RobotType.MECANUM, hardware={"controller": "lines"})


@pytest.mark.slow
@pytest.mark.parametrize("kind", [RobotType.FOUR_OMNI, RobotType.MECANUM])
def test_odometry_of_four_wheels_is_exact_and_the_hull_slides_sideways_too(kind: RobotType) -> None:
    run = LockstepRun(TWO.replace(seed=3, roster=(RobotSpec(type=kind),)).world())
    (robot,), start, sideways_m = run.arena._robots, run.arena._robots[0].body.pose, 0.0
    for _ in range(500):
        run.tick()
        sideways_m += abs(robot.body.left_m)
    device = run.hosts[0].manager.get("mocdevice").plugin
    true, found = robot.body.pose, start.compose(device.pose())
    assert found.distance_m(true) < 0.01
    assert math.remainder(found.yaw_rad - true.yaw_rad, math.tau) == pytest.approx(0.0, abs=0.002)
    assert sideways_m > 0.05
    counters = device.counters()
    assert (counters.rejected, counters.foreign, len(device.wheel_counts().counts)) == (0, 0, 4)
    assert device.is_holonomic()
    run.close()


@pytest.mark.slow
def test_odometry_of_a_car_is_exact_and_its_hull_never_slides_sideways() -> None:
    run = LockstepRun(TWO.replace(seed=3, roster=(RobotSpec(type=RobotType.CAR),)).world())
    (robot,), start = run.arena._robots, run.arena._robots[0].body.pose
    turned_rad = sideways_m = 0.0
    for _ in range(600):
        run.tick()
        sideways_m += abs(robot.body.left_m)
        turned_rad += abs(robot.body.turned_rad)
    device = run.hosts[0].manager.get("mocdevice").plugin
    true, found = robot.body.pose, start.compose(device.pose())
    assert found.distance_m(true) < 0.02
    assert math.remainder(found.yaw_rad - true.yaw_rad, math.tau) == pytest.approx(0.0, abs=0.005)
    assert sideways_m < 0.01
    assert 2.0 < turned_rad < robot.body.distance_m / device.turn_radius_min_m() + 0.2
    assert run.arena.collisions == 0
    run.close()


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
