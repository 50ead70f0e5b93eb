"""The driver on a base that cannot drive sideways: it turns, drives along its own axis, and still arrives."""

import math

import pytest

from robrain.plugins.unit.driver.driver import STEERED_M
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.messages.robots.action_messages import Outcome
from robrain.protocol.model.geometry import Point2D, Twist2D
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
