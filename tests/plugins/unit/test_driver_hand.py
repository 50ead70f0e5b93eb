"""Manual driving, command by command: what it takes over, what waits for it, what it leaves alone."""

import math

import pytest

from robrain.agent.action import Outcome
from robrain.plugins.unit.driver.by_hand import LONGEST_LEASE_S, ByHand
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.model.geometry import Point2D, Twist2D
from tests.plugins.unit.bare_driver import BareDriver

STILL = Twist2D()


@pytest.fixture
def robot():
    one = BareDriver()
    one.plugin.activate()
    return one


def under_way(robot, start, steps):
    """The robot after some steps, with its recorded commands cleared."""
    started = start(robot.plugin)
    robot.step(steps)
    robot.commands()
    return started


def wheels_stand(robot):
    """Whether only zero velocity is commanded from now on."""
    robot.commands()
    robot.step(10)
    return all(said in ("stop", STILL) for said in robot.commands())


def test_hand_that_does_not_ask_again_ends_with_its_lease_to_the_period(robot):
    robot.plugin.move(0.3, 0.0, 0.0, 0.6)
    assert robot.hurries == 1
    robot.step(9)
    assert robot.plugin.motion() is Motion.DRIVING
    robot.step(1)
    assert robot.commands()[-1] == "stop"
    assert robot.plugin.motion() is Motion.STANDING
    assert wheels_stand(robot)


@pytest.mark.parametrize("start", [lambda plugin: plugin.turn(6.0), lambda plugin: plugin.drive(9.0)])
def test_hand_that_takes_over_cancels_actions_drives_and_nothing_goes_on_after_it(robot, start):
    under_way(robot, start, 5)
    robot.plugin.move(0.0, 0.3, 0.0)  # half a second, if nothing is said
    assert robot.plugin.motion() is Motion.DRIVING
    robot.step(8)
    assert [(end.outcome, end.why) for end in robot.ends] == [(Outcome.CANCELLED, "the robot is driven by hand")]
    assert robot.wheels.twist.left_m_s > 0.1
    robot.step()
    assert robot.plugin.motion() is Motion.STANDING
    assert wheels_stand(robot)


def test_hand_that_wants_nothing_leaves_what_runs_alone(robot):
    action = under_way(robot, lambda plugin: plugin.drive(1.0), 5)
    for _ in range(3):
        robot.plugin.move(0.0, 0.0, 0.0)
        robot.step(2)
    assert "stop" not in robot.commands()
    robot.step(80)
    assert [(end.action, end.outcome) for end in robot.ends] == [(action, Outcome.DONE)]
    robot.plugin.turn(1.0)
    robot.plugin.move(0.0, 0.0, 0.0)
    robot.step(80)
    assert robot.wheels.at.yaw_rad == pytest.approx(1.0, abs=0.01)


def test_action_that_is_begun_while_a_hand_drives_waits_for_it_and_is_told_as_done(robot):
    robot.plugin.move(0.0, 0.3, 0.0, 0.3)
    action = robot.plugin.drive_path([Point2D(1.0, 0.0)])
    robot.step(5)
    assert robot.wheels.at.y_m > 0.0
    robot.step(120)
    assert [(end.action, end.outcome) for end in robot.ends] == [(action, Outcome.DONE)]
    assert robot.wheels.at.distance_m(Point2D(1.0, 0.0)) < 0.08


def test_hand_that_gives_the_robot_back_after_its_lease_has_ended_has_it_stand(robot):
    robot.plugin.move(0.3, 0.0, 0.0, 0.3)
    robot.step(4)
    robot.wait(1.0)
    robot.plugin.move(0.0, 0.0, 0.0)
    robot.step()
    assert robot.commands()[-1] == "stop"
    assert robot.plugin.motion() is Motion.STANDING


def test_path_that_waits_for_the_hand_is_driven_when_it_ends_and_one_that_was_taken_back_is_not(robot):
    robot.plugin.move(0.0, 0.3, 0.0, 0.3)
    robot.plugin.follow([Point2D(5.0, 0.0)])
    robot.step(20)
    assert robot.wheels.twist.forward_m_s > 0.3
    robot.plugin.move(0.0, 0.3, 0.0, 0.3)
    robot.plugin.follow([])
    robot.step(6)
    assert wheels_stand(robot)


@pytest.mark.parametrize(("wanted", "limit"), [((9.0, 0.0, 0.0), 0.6), ((0.0, -9.0, 0.0), 0.6), ((3.0, 4.0, 0.0), 0.6)])
def test_hand_goes_no_faster_than_the_robot_may(robot, wanted, limit):
    robot.plugin.move(*wanted, 2.0)
    robot.step(30)
    twist = robot.wheels.twist
    assert math.hypot(twist.forward_m_s, twist.left_m_s) == pytest.approx(limit)
    assert math.atan2(twist.left_m_s, twist.forward_m_s) == pytest.approx(math.atan2(wanted[1], wanted[0]))


@pytest.mark.parametrize("rate_rad_s", [9.0, -9.0, 0.7, -0.7])
def test_hand_turns_no_faster_than_the_robot_may(robot, rate_rad_s):
    robot.plugin.move(0.0, 0.0, rate_rad_s, 2.0)
    robot.step(20)
    assert robot.wheels.twist.yaw_rad_s == pytest.approx(max(-1.5, min(1.5, rate_rad_s)))


# -- the hand by itself -----------------------------------------------------------------------------------------


def test_hand_holds_for_just_its_lease_and_its_end_is_said_once():
    hand = ByHand()
    assert (hand.holds(0), hand.has_ended(0), hand.has_driven) == (False, False, False)
    hand.ask(Twist2D(0.1, 0.2, 0.3), 0.5, 1000)
    assert hand.wanted == Twist2D(0.1, 0.2, 0.3)
    for now_ns, holds in ((1000, True), (500_000_999, True), (500_001_000, False)):
        assert hand.holds(now_ns) is holds
    assert not hand.has_ended(500_000_999)
    assert hand.has_driven
    assert hand.has_ended(500_001_000)
    assert not hand.has_ended(500_001_000)
    assert (hand.has_driven, hand.wanted) == (False, Twist2D())


@pytest.mark.parametrize("lease_s", [0.0, -1.0, LONGEST_LEASE_S + 0.001, math.inf, math.nan])
def test_hand_is_held_for_some_time_and_not_for_long(lease_s):
    hand = ByHand()
    with pytest.raises(ValueError, match="expected"):
        hand.ask(Twist2D(0.1), lease_s, 0)
    assert not hand.has_driven
    hand.ask(Twist2D(0.1), LONGEST_LEASE_S, 0)
    assert hand.holds(1)


@pytest.mark.parametrize("wanted", [Twist2D(0.1), Twist2D(0.0, 0.1), Twist2D(0.0, 0.0, 0.1)])
def test_wish_to_stand_ends_the_lease_and_any_other_begins_one(wanted):
    hand = ByHand()
    hand.ask(wanted, 1.0, 0)
    assert hand.holds(1)
    hand.ask(Twist2D(), 1.0, 2)
    assert not hand.holds(2)
    assert hand.has_ended(2)
