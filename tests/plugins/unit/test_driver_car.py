"""The driver on a base that cannot turn on the spot: it drives arcs to and fro, never tighter than it can steer."""

import math

import pytest

from robrain.plugins.device.scan.interface import LaserScan
from robrain.plugins.unit.driver.driver import NEEDS_SPEED, NO_ROOM, PARKED_M, PARKED_RAD
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.messages.robots.action_messages import Outcome
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from tests.plugins.unit.bare_driver import BareDriver

RADIUS_MIN_M = 0.3


@pytest.fixture
def robot() -> BareDriver:
    one = BareDriver()
    one.wheels.steers, one.wheels.radius_min_m = True, RADIUS_MIN_M
    one.plugin.activate()
    return one


def run(robot: BareDriver, limit: int = 1500) -> list[Twist2D]:
    """Step until the robot stands; all velocities on the way, each of which it can drive."""
    for _ in range(limit):
        if robot.plugin.motion() is Motion.STOPPED:
            said = [one for one in robot.wheels.said if isinstance(one, Twist2D)]
            assert all(one.left_m_s == 0.0 for one in said)
            assert all(abs(one.yaw_rad_s) * RADIUS_MIN_M <= abs(one.forward_m_s) + 1e-9 for one in said)
            return said
        robot.step()
    raise AssertionError("it does not come to stand")


@pytest.mark.parametrize("bearing_rad", [0.0, 0.5, 1.5, -1.5, 2.5, math.pi])
@pytest.mark.parametrize("distance_m", [0.3, 3.0])
def test_it_reaches_a_point_in_any_direction_and_does_not_circle_around_it(
    robot: BareDriver, bearing_rad: float, distance_m: float
) -> None:
    goal = Point2D(distance_m * math.cos(bearing_rad), distance_m * math.sin(bearing_rad))
    robot.plugin.drive_path([goal])
    run(robot)
    assert robot.ends[0].outcome is Outcome.DONE
    assert robot.wheels.at.distance_m(goal) < 0.1


@pytest.mark.parametrize("angle_rad", [0.4, -math.pi / 2, math.pi, 7.0])
def test_a_turn_is_driven_to_and_fro_and_ends_near_where_it_began(robot: BareDriver, angle_rad: float) -> None:
    robot.plugin.turn(angle_rad)
    said = run(robot)
    assert robot.ends[0].outcome is Outcome.DONE
    at = robot.wheels.at
    assert math.remainder(at.yaw_rad - angle_rad, math.tau) == pytest.approx(0.0, abs=0.02)
    assert math.hypot(at.x_m, at.y_m) < 0.3
    assert all(one.yaw_rad_s * angle_rad >= 0.0 for one in said)
    if abs(angle_rad) > 1.0:
        assert {math.copysign(1.0, one.forward_m_s) for one in said if one.forward_m_s} == {1.0, -1.0}


@pytest.mark.parametrize("goal", [(2.0, 1.0, -1.0), (-1.0, 0.2, 3.0), (0.5, 1.0, 0.0)])
def test_it_parks_at_a_pose(robot: BareDriver, goal: tuple[float, float, float]) -> None:
    robot.plugin.go_to(*goal)
    run(robot)
    assert robot.ends[0].outcome is Outcome.DONE
    at = robot.wheels.at
    assert at.distance_m(Point2D(goal[0], goal[1])) < PARKED_M + 0.02
    assert math.remainder(at.yaw_rad - goal[2], math.tau) == pytest.approx(0.0, abs=PARKED_RAD + 0.02)


@pytest.mark.parametrize("bend_rad", [0.0, 0.3, 0.6, 1.0, 1.5])
def test_it_brakes_as_hard_as_any_base_for_what_appears_ahead_while_it_steers(bend_rad: float) -> None:
    nearest = []
    for radius_min_m in (0.0, RADIUS_MIN_M):
        robot = BareDriver()
        robot.wheels.steers, robot.wheels.radius_min_m = True, radius_min_m
        robot.plugin.activate()
        robot.plugin.follow([Point2D(6.0, 0.0)])
        while robot.wheels.twist.forward_m_s < 0.55:
            robot.step()
        at = robot.wheels.at
        robot.plugin.follow([Point2D(at.x_m + 3.0 * math.cos(bend_rad), 3.0 * math.sin(bend_rad))])
        robot.lidar.wall_m = at.x_m + 0.2 + 0.2
        near_m = math.inf
        for _ in range(40):
            robot.step()
            near_m = min(near_m, robot.lidar.wall_m - robot.wheels.at.x_m - 0.2)
        nearest.append(near_m)
    assert nearest[1] > nearest[0] - 0.02


@pytest.mark.parametrize("fastest_m_s", [0.0, 0.05])
def test_arcs_keep_the_speed_that_a_path_is_given(robot: BareDriver, fastest_m_s: float) -> None:
    robot.plugin.follow([Point2D(-3.0, 0.0)], fastest_m_s)
    robot.step(60)
    said = [one for one in robot.commands() if isinstance(one, Twist2D)]
    assert max(abs(one.forward_m_s) for one in said) < 1.1 * fastest_m_s + 1e-9


def test_a_lidar_that_is_covered_is_no_open_floor(robot: BareDriver) -> None:
    robot.lidar.latest = lambda: LaserScan(robot.clock.now_ns(), (), (), 6.0)
    robot.plugin.drive_path([Point2D(3.0, 0.0)])
    robot.step(30)
    assert robot.wheels.at == Pose2D(0.0, 0.0, 0.0)
    assert robot.plugin.blocked_reason() == "the lidar is covered: its scan has no beam"


def test_a_wall_close_ahead_makes_it_back_away_and_it_never_comes_nearer(robot: BareDriver) -> None:
    robot.lidar.wall_m = 0.35  # the robot's edge is at 0.2, and stays 0.12 away
    robot.plugin.turn(math.pi / 2)
    nearest_m = math.inf
    for _ in range(1500):
        if robot.plugin.motion() is Motion.STOPPED:
            break
        robot.step()
        nearest_m = min(nearest_m, robot.lidar.wall_m - robot.wheels.at.x_m)
    assert robot.ends[0].outcome is Outcome.DONE
    assert nearest_m > 0.2 + 0.08


def test_without_room_ahead_and_behind_the_turn_fails_in_words(robot: BareDriver) -> None:
    robot.bump(0.0, math.pi)
    robot.ring.pressed = (0.0, math.pi)
    robot.plugin.turn(1.0)
    for _ in range(400):
        robot.step()
        if robot.ends:
            break
    assert robot.ends[0].outcome is Outcome.FAILED
    assert NO_ROOM in robot.ends[0].why
    assert robot.wheels.at == Pose2D(0.0, 0.0, 0.0)


def test_driven_by_hand_it_steers_no_further_than_it_can_and_does_not_move_by_itself(robot: BareDriver) -> None:
    lease = robot.plugin.acquire_hand_lease("ann").lease
    for _ in range(30):
        robot.plugin.move(0.0, 0.0, 1.0, lease)
        robot.step()
    assert robot.wheels.at == Pose2D(0.0, 0.0, 0.0)
    assert robot.plugin.blocked_reason() == NEEDS_SPEED
    for _ in range(30):
        robot.plugin.move(0.2, 0.0, 1.0, lease)
        robot.step()
    assert robot.plugin.blocked_reason() == ""
    assert robot.wheels.at.yaw_rad > 0.3
    said = [one for one in robot.wheels.said if isinstance(one, Twist2D)]
    assert all(abs(one.yaw_rad_s) * RADIUS_MIN_M <= abs(one.forward_m_s) + 1e-9 for one in said)


def test_a_bump_on_an_arc_stops_it_at_once(robot: BareDriver) -> None:
    robot.plugin.turn(math.pi)
    while robot.wheels.twist.forward_m_s < 0.1:
        robot.step()
    robot.bump(0.0)
    assert robot.wheels.said[-1] == "stop"
    robot.step()
    assert robot.wheels.twist.forward_m_s <= 0.0
