"""The driver's commands: directions, speeds, ends of actions; on fake devices."""

import itertools
import math

import pytest

from robrain.plugins.unit.driver.driver import PERIOD_S
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.errors import CallError
from robrain.protocol.messages.robots.action_messages import Outcome
from robrain.protocol.model.geometry import Point2D, Pose2D
from tests.plugins.unit.bare_driver import BareDriver


@pytest.fixture
def robot():
    one = BareDriver()
    one.plugin.activate()
    return one


def run(robot, limit=600):
    """Step until the robot stands."""
    for _ in range(limit):
        if robot.plugin.motion() is Motion.STOPPED:
            return
        robot.step()
    raise AssertionError("it does not come to stand")


def ended(robot):
    (end,) = robot.ends
    return end.outcome, end.why


# -- where it goes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("yaw_rad", [0.0, math.pi / 2, -2.0])
@pytest.mark.parametrize("bearing_rad", [0.0, 1.0, -2.5])
def test_command_in_the_body_frame_goes_towards_the_point_in_odom(robot, yaw_rad, bearing_rad):
    robot.wheels.at = Pose2D(1.0, -1.0, yaw_rad)
    goal = Point2D(1.0 + 3.0 * math.cos(bearing_rad), -1.0 + 3.0 * math.sin(bearing_rad))
    robot.plugin.drive_path([goal])
    robot.step()
    twist = robot.wheels.twist
    # The body turns while the command holds: it is meant for the middle of the period.
    middle_rad = yaw_rad + 0.5 * PERIOD_S * twist.yaw_rad_s
    goes_rad = middle_rad + math.atan2(twist.left_m_s, twist.forward_m_s)
    assert math.remainder(goes_rad - bearing_rad, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert math.hypot(twist.forward_m_s, twist.left_m_s) == pytest.approx(4.0 * PERIOD_S**2)


@pytest.mark.parametrize(("distance_m", "yaw_rad"), [(1.0, 0.7), (-0.6, 0.7), (0.0, 0.0), (1.0, -2.5)])
def test_drive_ends_ahead_or_behind_without_having_turned(robot, distance_m, yaw_rad):
    robot.wheels.at = Pose2D(0.5, 0.25, yaw_rad)
    robot.plugin.drive(distance_m)
    run(robot)
    at = robot.wheels.at
    goal = Point2D(0.5 + distance_m * math.cos(yaw_rad), 0.25 + distance_m * math.sin(yaw_rad))
    assert at.distance_m(goal) < 0.01
    assert at.yaw_rad == pytest.approx(yaw_rad, abs=1e-9)
    assert ended(robot) == (Outcome.DONE, "")
    assert robot.ends[0].result == at
    assert robot.arrivals[0].x_m == pytest.approx(goal.x_m)


@pytest.mark.parametrize("angle_rad", [0.5, -0.5, 4.0, -7.0, 0.0])
def test_turn_ends_at_its_angle_and_in_its_direction(robot, angle_rad):
    robot.wheels.at = Pose2D(0.0, 0.0, 3.0)
    robot.plugin.turn(angle_rad)
    turned_rad = []
    robot.step(300, lambda: turned_rad.append(robot.wheels.twist.yaw_rad_s * PERIOD_S))
    assert sum(turned_rad) == pytest.approx(angle_rad, abs=0.008)
    assert all(each * math.copysign(1.0, angle_rad) > -1e-3 for each in turned_rad)
    assert robot.wheels.at.distance_m(Point2D(0.0, 0.0)) == 0.0
    assert ended(robot) == (Outcome.DONE, "")
    assert robot.arrivals == []


@pytest.mark.parametrize("angle_rad", [2.0, -2.0])
def test_turn_begins_and_ends_within_its_acceleration_and_jerk(robot, angle_rad):
    robot.plugin.turn(angle_rad)
    robot.step(60)
    rates = [0.0, *(said.yaw_rad_s for said in robot.commands() if said != "stop")]
    assert rates[1] == pytest.approx(math.copysign(20.0 * PERIOD_S**2, angle_rad))
    assert rates[2] == pytest.approx(3 * rates[1])
    steps = [abs(after - before) for before, after in itertools.pairwise(rates)]
    assert max(steps) == pytest.approx(3.0 * PERIOD_S)
    assert max(map(abs, rates)) == pytest.approx(1.5, abs=0.01)
    # It does not creep towards the end: from the full rate it stands within a second.
    assert sum(0.01 < abs(rate) < 1.4 for rate in rates) < 30


def test_go_to_arrives_and_looks_where_it_should(robot):
    robot.plugin.go_to(1.0, -0.5, 2.0 + math.tau)
    run(robot)
    assert robot.wheels.at.distance_m(Point2D(1.0, -0.5)) < 0.01
    assert robot.wheels.at.yaw_rad == pytest.approx(2.0, abs=0.008)
    assert ended(robot) == (Outcome.DONE, "")


@pytest.mark.parametrize(("asked_m_s", "limit_m_s"), [(0.2, 0.2), (5.0, 0.6), (math.inf, 0.6)])
def test_path_is_driven_no_faster_than_asked_and_no_faster_than_the_robot_may(robot, asked_m_s, limit_m_s):
    robot.plugin.follow([Point2D(9.0, 0.0)], asked_m_s)
    robot.step(40)
    assert robot.wheels.twist.forward_m_s == pytest.approx(limit_m_s)
    # The same while a hand holds the robot.
    robot.hand(0.1, 0.0, 0.0)
    robot.plugin.follow([Point2D(9.0, 0.0)], asked_m_s)
    robot.step(40)
    assert robot.wheels.twist.forward_m_s == pytest.approx(limit_m_s)


# -- actions ----------------------------------------------------------------------------------------------------


def test_turn_stops_what_was_driven_at_once_whoever_drove(robot):
    for start, steps in ((lambda: robot.plugin.drive(5.0), 10), (lambda: robot.hand(0.4, 0.0, 0.0), 1)):
        start()
        robot.step(steps)
        robot.commands()
        robot.plugin.turn(1.0)
        assert robot.commands() == ["stop"]
        robot.step(3)
        assert all(said.forward_m_s == 0.0 and said.yaw_rad_s > 0.0 for said in robot.commands())


@pytest.mark.parametrize("number", [math.nan, math.inf])
@pytest.mark.parametrize("function", ["drive", "turn", "drive_path", "go_to", "move"])
def test_invalid_number_to_drive_by_is_refused_and_changes_nothing(robot, function, number):
    action = robot.plugin.drive(5.0)
    plugin = robot.plugin
    asked = {
        "drive": [lambda: plugin.drive(number)],
        "turn": [lambda: plugin.turn(number)],
        "drive_path": [
            lambda: plugin.drive_path([Point2D(0.0, 0.0), Point2D(number, 0.0)]),
            lambda: plugin.drive_path([Point2D(0.0, number)]),
            lambda: plugin.drive_path([]),
        ],
        "go_to": [
            lambda: plugin.go_to(number, 0.0, 0.0),
            lambda: plugin.go_to(0.0, number, 0.0),
            lambda: plugin.go_to(0.0, 0.0, number),
        ],
        "move": [lambda: plugin.move(number, 0.0, 0.0, 1), lambda: plugin.move(0.0, 0.0, number, 1)],
    }[function]
    for ask in asked:
        with pytest.raises(CallError, match=r"expected (finite numbers|at least one point)"):
            ask()
    robot.step()
    assert robot.ends == []
    assert plugin.cancel(action) is True
