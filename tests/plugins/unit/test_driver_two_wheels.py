"""The driver on a base that cannot drive sideways: it turns, drives along its own axis, and still arrives."""

import math

import pytest

from robrain.plugins.unit.driver.driver import PERIOD_S, STEERED_M
from robrain.plugins.unit.driver.interface import Motion
from robrain.plugins.unit.driver.path import Ramp, RampLimits
from robrain.plugins.unit.driver.steering import Steering
from robrain.plugins.unit.obstacle_distance import Lookout
from robrain.protocol.messages.robots.action_messages import Outcome
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from tests.plugins.unit.bare_driver import BareDriver


@pytest.fixture
def robot() -> BareDriver:
    one = BareDriver()
    one.wheels.steers = True
    one.plugin.activate()
    return one


def run(robot: BareDriver, limit: int = 1500) -> list[Twist2D]:
    """Step until the robot stands; all velocities on the way."""
    for _ in range(limit):
        if robot.plugin.motion() is Motion.STOPPED:
            return [said for said in robot.wheels.said if isinstance(said, Twist2D)]
        robot.step()
    raise AssertionError("it does not come to stand")


@pytest.mark.parametrize("bearing_rad", [0.0, 0.5, 1.5, -1.5, 2.5, math.pi])
def test_it_reaches_a_point_in_any_direction_without_a_sideways_or_backward_command(
    robot: BareDriver, bearing_rad: float
) -> None:
    goal = Point2D(3.0 * math.cos(bearing_rad), 3.0 * math.sin(bearing_rad))
    robot.plugin.drive_path([goal])
    said = run(robot)
    assert robot.ends[0].outcome is Outcome.DONE
    assert robot.wheels.at.distance_m(goal) < 0.1
    assert all(twist.left_m_s == 0.0 for twist in said)
    assert all(twist.forward_m_s >= 0.0 for twist in said)


def test_it_turns_nearly_on_the_spot_before_it_drives_away_from_where_it_looks(robot: BareDriver) -> None:
    robot.plugin.drive_path([Point2D(-3.0, 0.0)])
    for _ in range(200):
        robot.step()
        if abs(math.remainder(robot.wheels.at.yaw_rad - math.pi, math.tau)) < math.pi / 4:
            break
    assert math.hypot(robot.wheels.at.x_m, robot.wheels.at.y_m) < 0.1


def test_it_follows_the_corners_of_a_path_and_stays_near_it(robot: BareDriver) -> None:
    corners = [Point2D(2.0, 0.0), Point2D(2.0, 2.0), Point2D(0.0, 2.0)]
    robot.plugin.drive_path(corners)
    off_m = 0.0
    for _ in range(1500):
        if robot.plugin.motion() is Motion.STOPPED:
            break
        robot.step()
        at = robot.wheels.at
        legs = [abs(at.y_m), abs(at.x_m - 2.0), abs(at.y_m - 2.0)]
        off_m = max(off_m, min(legs))
    assert robot.ends[0].outcome is Outcome.DONE
    assert off_m < 0.25  # the radius within which a corner counts as passed


@pytest.mark.parametrize("distance_m", [1.0, -1.0])
def test_drive_goes_straight_ahead_or_back_without_turning(robot: BareDriver, distance_m: float) -> None:
    robot.wheels.at = Pose2D(1.0, 1.0, 0.7)
    robot.plugin.drive(distance_m)
    said = run(robot)
    assert robot.ends[0].outcome is Outcome.DONE
    at = robot.wheels.at
    assert at.yaw_rad == pytest.approx(0.7, abs=0.01)
    assert math.hypot(at.x_m - 1.0, at.y_m - 1.0) == pytest.approx(1.0, abs=0.02)
    assert all(twist.forward_m_s * distance_m >= 0.0 for twist in said)


@pytest.mark.parametrize("goal", [(2.0, 1.0, -1.0), (-1.0, 0.2, 3.0), (0.1, 0.3, 0.0)])
def test_go_to_ends_at_the_place_and_then_turns_to_the_heading(
    robot: BareDriver, goal: tuple[float, float, float]
) -> None:
    robot.plugin.go_to(*goal)
    run(robot)
    assert robot.ends[0].outcome is Outcome.DONE
    at = robot.wheels.at
    assert math.hypot(at.x_m - goal[0], at.y_m - goal[1]) < STEERED_M + 0.01
    assert math.remainder(at.yaw_rad - goal[2], math.tau) == pytest.approx(0.0, abs=0.02)


def test_by_hand_the_sideways_part_is_left_out_and_it_may_go_back(robot: BareDriver) -> None:
    for forward_m_s in (0.2, -0.2):
        robot.hand(forward_m_s, 0.2, 0.0)
        robot.step()
        twist = robot.wheels.twist
        assert twist.left_m_s == 0.0
        assert twist.forward_m_s * forward_m_s > 0.0
        robot.plugin.stop()


def test_it_stops_before_a_wall_that_it_looks_at_although_the_goal_is_beside_it(robot: BareDriver) -> None:
    robot.lidar.wall_m = 1.0
    robot.plugin.drive_path([Point2D(0.6, 3.0)])
    for _ in range(400):
        robot.step()
        assert robot.wheels.at.x_m < 1.0 - 0.2
    assert robot.ends[0].outcome is Outcome.DONE


@pytest.mark.parametrize("off_rad", [0.0, 0.5, 1.0, -1.0, 1.5, 2.5])
def test_it_slows_down_by_the_square_of_how_much_it_faces_the_way(robot: BareDriver, off_rad: float) -> None:
    at_once = Ramp(RampLimits(100.0, 10_000.0), PERIOD_S)
    steering = Steering(
        Lookout(robot.wheels, robot.lidar, robot.ring, 0.05),
        at_once,
        Ramp(RampLimits(1.0, 10.0), PERIOD_S),
        turn_rate_rad_s=1.0,
        braking_m_s2=1.0,
        period_s=PERIOD_S,
        delay_s=0.1,
        is_holonomic=False,
    )
    expected_m_s = 0.4 * math.cos(off_rad) ** 2
    steering.go_towards(Pose2D(0.0, 0.0, 0.7), 0.7 + off_rad, 0.4, 5.0, 0.0)
    assert at_once.speed == pytest.approx(expected_m_s)
    at_once.stop()
    heading_rad = steering.go(Pose2D(0.0, 0.0, 0.0), (0.4 * math.cos(off_rad), 0.4 * math.sin(off_rad)))
    assert (at_once.speed, heading_rad) == (pytest.approx(expected_m_s), pytest.approx(off_rad))


def test_it_stands_and_turns_while_it_touches_something_ahead_although_its_way_leads_past_it(robot: BareDriver) -> None:
    robot.ring.pressed = (-1.0,)
    robot.plugin.activate()
    robot.plugin.drive_path([Point2D(2.0, 2.0)])  # 102° from what it touches, which is 57° from its axis
    robot.step(8)
    assert [twist.forward_m_s for twist in robot.commands() if isinstance(twist, Twist2D)] == [0.0] * 8
    assert robot.wheels.at.yaw_rad > 0.05
    robot.bump()
    robot.step(8)
    assert robot.wheels.twist.forward_m_s > 0.1


def test_it_backs_away_from_a_wall_right_ahead(robot: BareDriver) -> None:
    robot.lidar.wall_m = 0.21
    robot.plugin.drive(-1.0)
    run(robot)
    assert robot.ends[0].outcome is Outcome.DONE
    assert robot.wheels.at.x_m == pytest.approx(-1.0, abs=0.02)
