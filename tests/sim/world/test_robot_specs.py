import pytest

from robrain import Scenario
from robrain.protocol.model.geometry import Pose2D
from robrain.sim.world.robot_specs import with_all

HALL = """
[scenario]
name = "mixed"
[floor]
size_m = [10.0, 6.0]
[robot]
radius_m = 0.2
[robot.lidar]
noise_m = 0.02
"""
TEAM = """
[[robots]]
type = "scout"
place_m = [1.0, 1.0]
yaw_rad = 1.5
[[robots]]
type = "carrier"
near_m = [8.0, 4.5]
[[robots]]
without = ["camera"]
hardware = { radius_m = 0.17, lidar = { rays = 120 } }
[robots.plugins.driver]
speed_m_s = 0.3
"""


def test_each_robot_has_its_type_place_hardware_and_parameters():
    world = Scenario.from_toml(HALL + TEAM).world()
    scout, carrier, own = world.robots
    assert scout.start == Pose2D(1.0, 1.0, 1.5)
    assert (scout.radius_m, scout.lidar.range_max_m, scout.lidar.noise_m) == (0.15, 4.0, 0.02)
    assert (carrier.radius_m, carrier.battery.capacity_wh) == (0.28, 90.0)
    assert abs(carrier.start.x_m - 8.0) < 0.5
    assert abs(carrier.start.y_m - 4.5) < 0.5
    assert (own.radius_m, own.lidar.rays, own.lidar.noise_m, own.lidar.range_max_m) == (0.17, 120, 0.02, 6.0)
    files = [world.robot_file(robot) for robot in world.robots]
    assert [file.parameters.get("driver", {}).get("speed_m_s") for file in files] == [None, 0.4, 0.3]
    assert [file.parameters["mocdevice"]["radius_m"] for file in files] == [0.15, 0.28, 0.17]
    assert [file.robot.load is None for file in files] == [True, True, False]


def test_without_leaves_out_all_that_require_it_at_whatever_distance():
    left = with_all(["mocdevice"])
    assert "mocdevice" not in left
    assert not {"driver", "planner", "explore", "visit"} & set(left)
    assert {"scan", "battery"} & set(left)


@pytest.mark.slow
def test_a_robot_without_a_lidar_sends_no_scans():
    scenario = Scenario.from_toml(HALL + '[[robots]]\nwithout = ["scan"]\n[[robots]]\n')
    run = scenario.open(scenario.world())
    try:
        seen = []
        for robot in run.arena._robots:
            robot.scan = lambda hulls, name=robot.name: seen.append(name)
        for _ in range(20):
            run.tick()
    finally:
        run.close()
    assert set(seen) == {"r2"}


def test_robots_beyond_the_listed_ones_are_as_the_team_and_fewer_take_the_first():
    scenario = Scenario.from_toml(HALL + TEAM)
    assert [robot.radius_m for robot in scenario.replace(robots=5).world().robots] == [0.15, 0.28, 0.17, 0.2, 0.2]
    assert [robot.radius_m for robot in scenario.replace(robots=1).world().robots] == [0.15]
    assert Scenario.from_toml(HALL).robots == 4
