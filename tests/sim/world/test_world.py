import itertools
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from robrain.sim.firmware.disturbance import DelaySpec, DisturbanceSpec
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.maps.placement import Starts
from robrain.sim.robot.robot_hardware import RobotHardware
from robrain.sim.robot.wheels import WheelSpec
from robrain.sim.world.referee import team_geometry
from robrain.sim.world.robot_specs import ROBOT_SPACING_M
from robrain.sim.world.world import build_world

RESOLUTION_M = 0.05


def plan(width_m=6.0, height_m=4.0, *, origin=(-2.0, 3.0)):
    occupied = np.ones((round(height_m / RESOLUTION_M), round(width_m / RESOLUTION_M)), np.bool_)
    occupied[2:-2, 2:-2] = False
    occupied[30:50, 40:44] = True
    return FloorPlan(occupied, RESOLUTION_M, *origin, "hall")


def test_the_same_seed_builds_the_same_world_and_another_another():
    one, same, other = (build_world(plan(), 3, 5, None, seed) for seed in (7, 7, 8))
    assert (one.robots, one.motes) == (same.robots, same.motes)
    assert one.robots != other.robots
    assert one.arena_rng().random() == same.arena_rng().random() != other.arena_rng().random()


def test_robots_start_clear_of_walls_and_of_each_other():
    world = build_world(plan(), 5, 0, None, 1)
    assert [robot.name for robot in world.robots] == ["r1", "r2", "r3", "r4", "r5"]
    for robot in world.robots:
        cell = world.plan.geometry.cell_of(robot.start.x_m, robot.start.y_m)
        assert world.plan.clearance_m[cell] > RobotHardware().radius_m
    for one, other in itertools.combinations(world.robots, 2):
        assert one.start.distance_m(other.start) >= ROBOT_SPACING_M - 1e-6


def test_motes_lie_where_robots_come_by():
    world = build_world(plan(), 1, 12, None, 1)
    assert [(mote.name, mote.number) for mote in world.motes[:2]] == [("m1", 1), ("m2", 2)]
    assert len({(mote.place.x_m, mote.place.y_m) for mote in world.motes}) == 12
    assert all(world.plan.contains_free(mote.place.x_m, mote.place.y_m) for mote in world.motes)


def test_a_robots_file_says_where_it_starts_and_which_grid_the_team_maps_on():
    world = build_world(plan(), 2, 0, None, 1)
    for robot in world.robots:
        robot_file = world.robot_file(robot, team="red", connect=("tcp/127.0.0.1:7447",))
        assert (robot_file.robot.name, robot_file.robot.team) == (robot.name, "red")
        assert robot_file.zenoh.connect == ["tcp/127.0.0.1:7447"]
        start = robot_file.parameters["localisation"]
        assert (start["x_m"], start["y_m"], start["yaw_rad"]) == (
            robot.start.x_m,
            robot.start.y_m,
            robot.start.yaw_rad,
        )
        grid, expected = robot_file.parameters["mapper"], team_geometry(world.plan)
        assert (grid["origin_x_m"], grid["origin_y_m"]) == pytest.approx((-2.3, 2.7))
        assert round(grid["width_m"] / grid["resolution_m"]) == expected.width
        assert round(grid["height_m"] / grid["resolution_m"]) == expected.height
        assert robot_file.parameters["battery"]["capacity_wh"] == robot.battery.capacity_wh


@pytest.mark.parametrize(
    ("wheels", "disturbance", "slack_cells"),
    [
        (WheelSpec(), DisturbanceSpec(), 0.5),
        (WheelSpec(), DisturbanceSpec(scan=DelaySpec(late_s=(0.0, 0.1))), 0.0),
        (WheelSpec(slip=0.05), DisturbanceSpec(), 0.0),
    ],
)
def test_odometry_is_believed_more_than_the_map_only_where_it_is_exact(wheels, disturbance, slack_cells):
    """With late frames it is not: offsets up to half a cell, left alone, put a fifth of a depot's walls off."""
    world = build_world(plan(), 1, 0, None, 1)
    world = replace(world, disturbance=disturbance)
    robot = msgspec.structs.replace(world.robots[0], wheels=wheels)
    parameters = world.robot_file(robot).parameters
    assert parameters["localisation"]["wall_slack_cells"] == slack_cells
    assert parameters["mapper"]["closure_slack_m"] == pytest.approx(0.1 * slack_cells)


def test_of_a_team_that_is_not_told_its_starts_the_first_robot_is_and_the_others_begin_in_the_middle():
    world = replace(build_world(plan(), 3, 0, None, 1, starts=Starts.SCATTERED), starts_known=False)
    first, *others = (
        world.robot_file(robot, team="red", connect=()).parameters["localisation"] for robot in world.robots
    )
    assert (first["x_m"], first["y_m"]) == (world.robots[0].start.x_m, world.robots[0].start.y_m)
    assert "start_known" not in first
    width_m, height_m = world.plan.size_m
    for other in others:
        assert other["start_known"] is False
        middle = (world.plan.origin_x_m + width_m / 2, world.plan.origin_y_m + height_m / 2, 0.0)
        assert (other["x_m"], other["y_m"], other["yaw_rad"]) == pytest.approx(middle)
