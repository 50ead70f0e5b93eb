import pytest

from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.model.geometry import Point2D, Pose2D


def driver(host):
    return host.manager.get("driver").plugin


def drive(host, *places):
    """Send a robot along these places, arena frame."""
    localisation = host.manager.get("localisation").plugin
    driver(host).follow(localisation.to_odom([Point2D(*place) for place in places]))


def begun(stage, world, pose):
    """A robot that knows where it is, and its host."""
    one = stage(world, r1=pose)
    host = one.host("localisation")
    one.run(0.4)
    return one, host


def stands(one):
    return one.call("driver", "motion") == Motion.STOPPED


@pytest.mark.parametrize("yaw_rad", [0.0, 2.0, -3.0])
def test_a_robot_arrives_at_the_end_of_its_path_within_a_tenth_of_a_metre(stage, room, yaw_rad):
    one, host = begun(stage, room(6.0, 4.0), Pose2D(1.0, 1.0, yaw_rad))
    drive(host, (4.5, 1.0), (4.5, 3.0))
    one.run_until(lambda: stands(one), 30.0)
    one.run(0.5)
    assert one.truth().pose.distance_m(Point2D(4.5, 3.0)) < 0.1
    assert one.truth().collisions == 0


def test_a_wall_across_the_path_is_stopped_at_and_not_touched(stage, room):
    one, host = begun(stage, room(6.0, 4.0, (3.0, 0.0, 3.2, 4.0)), Pose2D(1.0, 2.0, 0.0))
    drive(host, (5.0, 2.0))
    one.run(10.0)
    gap_m = 3.0 - one.truth().pose.x_m - 0.2
    assert one.truth().collisions == 0
    assert 0.02 < gap_m < 0.3
    assert one.call("driver", "motion") == Motion.BLOCKED
    assert driver(host).blocked_s() > 3.0


def test_a_halted_robot_stands_and_does_not_drive_on_when_it_is_resumed(stage, room):
    one, host = begun(stage, room(), Pose2D(1.0, 2.0, 0.0))
    drive(host, (3.0, 2.0))
    one.run(1.0)
    one.halt()
    one.run(1.0)
    before = one.truth().pose
    one.halt(halted=False)
    one.run(2.0)
    assert one.truth().pose == before


@pytest.fixture
def robot(stage, room):
    """A robot that looks along a room of 6 × 4 m."""
    one = stage(room(6.0, 4.0), r1=Pose2D(1.0, 2.0, 0.0))
    one.told = one.inbox(ROBOT_EVENT, robot="r1", plugin="scan")
    one.host("mapper", mapper={"origin_x_m": 0.0, "origin_y_m": 0.0, "width_m": 6.0, "height_m": 4.0})
    one.run(0.4)
    return one


# -- a lidar that lies ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", [("drive", 4.0), ("go_to", 1.0, 1.0, 2.0)])
def test_a_frozen_lidar_is_named_and_told_and_the_robot_stands(robot, motion):
    robot.call("driver", *motion)
    robot.run(0.8)
    robot.arena.robot("r1").lidar.is_frozen = True
    took_s = robot.run_until(lambda: robot.infos()["scan"].state == "faulted", 1.0)
    assert took_s < 0.8
    (told,) = robot.told.drain()
    assert "the lidar is frozen: its ranges stay equal" in told.message.value
    robot.run(0.5)
    place = robot.truth().pose
    robot.run(5.0)
    assert robot.truth().pose == place
    assert robot.truth().collisions == 0


def test_of_the_turn_in_which_the_lidar_froze_no_map_is_made_and_when_it_speaks_again_all_goes_on(robot):
    robot.call("driver", "drive", 4.0)
    robot.run(0.8)
    robot.arena.robot("r1").lidar.is_frozen = True
    robot.run(2.0)
    assert robot.infos()["scan"].state == "active"  # it was restarted, and hands nothing on
    assert robot.call("scan", "nearest_m") is None
    known_m2 = robot.call("mapper", "known_area_m2")
    robot.call("driver", "drive", 1.0)
    robot.run(1.0)
    assert robot.call("driver", "blocked_reason") == "there has been no fresh scan"
    assert robot.call("mapper", "known_area_m2") == known_m2
    robot.run(4.0)
    assert "nothing but the turn that it froze in" in robot.told.drain()[-1].message.value
    robot.arena.robot("r1").lidar.is_frozen = False
    robot.run(3.0)
    x_m = robot.truth().pose.x_m
    robot.call("driver", "drive", 0.5)
    robot.run(3.0)
    assert robot.truth().pose.x_m == pytest.approx(x_m + 0.5, abs=0.05)


# -- what the lidar does not see --------------------------------------------------------------------------------


def test_what_nothing_sees_is_bumped_into_once_and_not_pressed_against(stage, room):
    one = stage(room(6.0, 4.0, (3.0, 0.0, 3.1, 4.0)), r1=Pose2D(1.0, 2.0, 0.0))
    one.told = one.inbox(ROBOT_EVENT, robot="r1", plugin="range_sensors")
    one.host("driver", range_sensors={"range_max_m": 0.01})
    see_through(one, 3.0)
    one.run(0.4)
    one.call("driver", "drive", 4.0)
    one.run(6.0)
    assert one.truth().collisions == 1
    assert one.call("driver", "motion") == Motion.BLOCKED
    (told,) = one.told.drain()
    assert told.message.value["directions_rad"] == [0.0]
    # It goes away from what it has touched.
    one.call("driver", "drive", -0.5)
    one.run(3.0)
    assert one.truth().pose.x_m == pytest.approx(2.3, abs=0.03)
    assert one.truth().collisions == 1


def see_through(one, from_x_m):
    """Have the lidar not see the wall that begins there."""
    robot = one.arena._robots[0]
    walls = robot.lidar._walls.copy()
    column = round(from_x_m / 0.05)
    walls[2:-2, column : column + 2] = False
    robot.lidar._walls = walls
