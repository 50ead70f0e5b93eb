"""Manual driving, command by command: what it takes over, what waits for it, what it leaves alone."""

import math

import pytest

from robrain.plugins.unit.driver.by_hand import LONGEST_LEASE_S, ByHand
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.action_messages import Outcome
from robrain.protocol.model.geometry import Point2D, Twist2D
from tests.plugins.unit.bare_driver import BareDriver

STILL = Twist2D()


LEASE_S = 0.3
"""Five periods."""


@pytest.fixture
def robot():
    one = BareDriver(hand_lease_s=LEASE_S)
    one.plugin.activate()
    return one


def under_way(robot, start, steps):
    """The robot after some steps, with its recorded commands cleared."""
    started = start(robot.plugin)
    robot.step(steps)
    robot.commands()
    return started


def keep_asking(robot, steps, *wanted):
    """Drive by hand, renewing the lease with each step."""
    lease = robot.plugin.acquire_hand_lease("ann").lease
    for _ in range(steps):
        robot.plugin.move(*wanted, lease)
        robot.step()


def wheels_stand(robot):
    """Whether only zero velocity is commanded from now on."""
    robot.commands()
    robot.step(10)
    return all(said in ("stop", STILL) for said in robot.commands())


def test_hand_that_does_not_ask_again_ends_with_its_lease_to_the_period(robot):
    robot.hand(0.3, 0.0, 0.0)
    assert robot.hurries == 1
    robot.step(4)
    assert robot.plugin.motion() is Motion.DRIVING
    robot.step(1)
    assert robot.commands()[-1] == "stop"
    assert robot.plugin.motion() is Motion.STOPPED
    assert wheels_stand(robot)


@pytest.mark.parametrize("start", [lambda plugin: plugin.turn(6.0), lambda plugin: plugin.drive(9.0)])
def test_hand_that_takes_over_cancels_actions_drives_and_nothing_goes_on_after_it(robot, start):
    under_way(robot, start, 5)
    robot.hand(0.0, 0.3, 0.0)
    assert robot.plugin.motion() is Motion.DRIVING
    robot.step(4)
    assert [(end.outcome, end.why) for end in robot.ends] == [(Outcome.CANCELLED, "the robot is driven by hand")]
    assert robot.wheels.twist.left_m_s > 0.05
    robot.step()
    assert robot.plugin.motion() is Motion.STOPPED
    assert wheels_stand(robot)


def test_hand_that_wants_nothing_leaves_what_runs_alone(robot):
    action = under_way(robot, lambda plugin: plugin.drive(1.0), 5)
    for _ in range(3):
        robot.hand(0.0, 0.0, 0.0)
        robot.step(2)
    assert "stop" not in robot.commands()
    robot.step(80)
    assert [(end.action, end.outcome) for end in robot.ends] == [(action, Outcome.DONE)]
    robot.plugin.turn(1.0)
    robot.hand(0.0, 0.0, 0.0)
    robot.step(80)
    assert robot.wheels.at.yaw_rad == pytest.approx(1.0, abs=0.01)


def test_path_that_waits_for_the_hand_is_driven_when_it_ends_and_one_that_was_taken_back_is_not(robot):
    robot.hand(0.0, 0.3, 0.0)
    robot.plugin.follow([Point2D(5.0, 0.0)])
    robot.step(20)
    assert robot.wheels.twist.forward_m_s > 0.3
    robot.hand(0.0, 0.3, 0.0)
    robot.plugin.follow([])
    robot.step(6)
    assert wheels_stand(robot)


@pytest.mark.parametrize("limit", [0.25, 0.6])
@pytest.mark.parametrize("wanted", [(9.0, 0.0, 0.0), (0.0, -9.0, 0.0), (3.0, 4.0, 0.0)])
def test_hand_goes_no_faster_than_it_and_the_robot_may(wanted, limit):
    robot = BareDriver(hand_speed_m_s=0.9 if limit == 0.6 else limit)
    robot.plugin.activate()
    keep_asking(robot, 30, *wanted)
    twist = robot.wheels.twist
    assert math.hypot(twist.forward_m_s, twist.left_m_s) == pytest.approx(limit)
    assert math.atan2(twist.left_m_s, twist.forward_m_s) == pytest.approx(math.atan2(wanted[1], wanted[0]))


@pytest.mark.parametrize("rate_rad_s", [9.0, -9.0, 0.7, -0.7])
def test_hand_turns_no_faster_than_it_may(robot, rate_rad_s):
    keep_asking(robot, 20, 0.0, 0.0, rate_rad_s)
    assert robot.wheels.twist.yaw_rad_s == pytest.approx(max(-1.0, min(1.0, rate_rad_s)))


def test_wheels_are_stopped_before_the_lease_lapses_not_at_the_look_after():
    robot = BareDriver(hand_lease_s=0.25)
    robot.plugin.activate()
    robot.hand(0.2, 0.0, 0.0)
    robot.step(3)
    assert "stop" not in robot.commands()
    robot.step()  # 0.24 s
    assert robot.commands()[-1] == "stop"


def test_lease_that_was_not_taken_drives_nothing(robot):
    refused(robot, 0)
    refused(robot, 1)
    robot.step(2)
    assert robot.wheels.said == []
    assert robot.hurries == 0


def test_lease_that_has_lapsed_is_not_renewed_by_a_command_that_comes_late(robot):
    lease = robot.plugin.acquire_hand_lease("ann").lease
    robot.plugin.move(0.3, 0.0, 0.0, lease)
    robot.step(5)
    refused(robot, lease)
    assert wheels_stand(robot)
    robot.plugin.move(0.3, 0.0, 0.0, robot.plugin.acquire_hand_lease("ann").lease)
    robot.step(2)
    assert robot.wheels.twist.forward_m_s > 0.0


def test_only_one_drives_at_a_time_and_the_other_is_told_who(robot):
    lease = robot.plugin.acquire_hand_lease("ann").lease
    robot.plugin.move(0.3, 0.0, 0.0, lease)
    with pytest.raises(CallError, match="ann drives the robot by hand") as refusal:
        robot.plugin.acquire_hand_lease("bob")
    assert refusal.value.code is ErrorCode.BUSY
    robot.plugin.move(0.0, 0.0, 0.0, lease)
    other = robot.plugin.acquire_hand_lease("bob").lease
    refused(robot, lease)
    robot.plugin.move(0.3, 0.0, 0.0, other)
    robot.plugin.move(0.0, 0.0, 0.0, lease)  # ann's wish to stand does not end bob's drive
    robot.step(2)
    assert robot.wheels.twist.forward_m_s > 0.0


def test_holder_that_takes_the_lease_again_ends_its_earlier_one(robot):
    first = robot.plugin.acquire_hand_lease("ann").lease
    second = robot.plugin.acquire_hand_lease("ann").lease
    refused(robot, first)
    robot.plugin.move(0.3, 0.0, 0.0, second)
    robot.step()
    assert robot.plugin.motion() is Motion.DRIVING


@pytest.mark.parametrize("ends", ["emergency_halt", "deactivate"])
def test_lease_ends_with_a_halt_and_with_the_plugin(robot, ends):
    lease = robot.plugin.acquire_hand_lease("ann").lease
    robot.plugin.move(0.3, 0.0, 0.0, lease)
    robot.step(2)
    getattr(robot.plugin, ends)()
    refused(robot, lease)


def test_lease_that_lapses_leaves_what_the_robot_drives_by_itself_alone(robot):
    robot.plugin.acquire_hand_lease("ann")
    action = under_way(robot, lambda plugin: plugin.drive(1.0), 20)
    assert "stop" not in robot.commands()
    robot.step(80)
    assert [(end.action, end.outcome) for end in robot.ends] == [(action, Outcome.DONE)]


@pytest.mark.parametrize("by", ["", "*", "a/b", "x" * 64])
def test_holder_has_a_name_that_can_be_one(robot, by):
    with pytest.raises(CallError) as refusal:
        robot.plugin.acquire_hand_lease(by)
    assert refusal.value.code is ErrorCode.BAD_ARGUMENTS


def refused(robot, lease):
    with pytest.raises(CallError) as refusal:
        robot.plugin.move(0.3, 0.0, 0.0, lease)
    assert refusal.value.code is ErrorCode.REFUSED


# -- the hand by itself -----------------------------------------------------------------------------------------


def test_hand_holds_for_just_its_lease_and_its_end_is_said_once():
    hand = ByHand(0.5)
    assert (hand.holds(0), hand.has_ended(0)) == (False, False)
    taken = hand.lease("ann", 0)
    assert (taken.lease_s, taken.renew_s) == (0.5, 0.125)
    assert not hand.holds(1)
    hand.ask(Twist2D(0.1, 0.2, 0.3), taken.lease, 1000)
    assert hand.wanted == Twist2D(0.1, 0.2, 0.3)
    for now_ns, holds in ((1000, True), (500_000_999, True), (500_001_000, False)):
        assert hand.holds(now_ns) is holds
        assert hand.holder(now_ns) == ("ann" if holds else "")
    assert not hand.has_ended(500_000_999)
    assert hand.has_ended(500_001_000)
    assert not hand.has_ended(500_001_000)
    assert hand.wanted == Twist2D()


@pytest.mark.parametrize("lease_s", [0.0, -1.0, LONGEST_LEASE_S + 0.001, math.inf, math.nan])
def test_hand_is_held_for_some_time_and_not_for_long(lease_s):
    with pytest.raises(ValueError, match="expected"):
        ByHand(lease_s)
    assert ByHand(LONGEST_LEASE_S).lease("ann", 0).lease_s == LONGEST_LEASE_S


@pytest.mark.parametrize("wanted", [Twist2D(0.1), Twist2D(0.0, 0.1), Twist2D(0.0, 0.0, 0.1)])
def test_wish_to_stand_ends_the_lease_and_any_other_renews_it(wanted):
    hand = ByHand(1.0)
    lease = hand.lease("ann", 0).lease
    hand.ask(wanted, lease, 0)
    assert hand.holds(1)
    hand.ask(Twist2D(), lease, 2)
    assert not hand.holds(2)
    assert hand.holder(2) == ""
    assert hand.has_ended(2)
