"""The driver's immediate reactions to danger, command by command, on fake devices."""

import math

import pytest

from robrain.plugins.unit.driver.driver import PERIOD_S
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.messages.robots.action_messages import Outcome
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from tests.plugins.unit.bare_driver import BareDriver
from tests.plugins.unit.bare_driver import by_hand as hand

STILL = Twist2D()
BRAKED_M_S = 1.2 * PERIOD_S
"""Speed reduction per period in hard braking."""
GENTLE_M_S = 4.0 * PERIOD_S**2
"""The first step of a smooth start."""


@pytest.fixture
def robot():
    one = BareDriver(hand_lease_s=2.0, hand_speed_m_s=0.6)
    one.plugin.activate()
    return one


def under_way(robot, start, steps=18):
    """The robot at full speed, with its recorded commands cleared."""
    started = start(robot.plugin)
    robot.step(steps)
    robot.commands()
    return started


def ahead(plugin):
    plugin.follow([Point2D(20.0, 0.0)])


def by_hand(plugin):
    hand(plugin, 0.5, 0.0, 0.0)


def wheels_stand(robot, steps=10):
    """Whether only zero velocity is commanded from now on."""
    robot.commands()
    robot.step(steps)
    return all(said in ("stop", STILL) for said in robot.commands())


# -- bumps ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("start", [ahead, by_hand], ids=["path", "hand"])
def test_bump_stops_the_wheels_at_once_whoever_drives(robot, start):
    under_way(robot, start)
    robot.bump(0.0)
    assert robot.commands() == ["stop"]
    robot.step(5)
    assert robot.commands() == [STILL] * 5
    assert robot.plugin.motion() is Motion.BLOCKED
    assert robot.plugin.blocked_reason() == "an obstacle has blocked the path"


@pytest.mark.parametrize("start", [ahead, by_hand], ids=["path", "hand"])
def test_robot_that_is_touched_from_behind_stands_first_and_then_starts_smoothly(robot, start):
    under_way(robot, start)
    robot.bump(math.pi)
    assert robot.commands() == ["stop"]
    robot.step()
    (said,) = robot.commands()
    assert 0.0 < said.forward_m_s <= GENTLE_M_S + 1e-9
    robot.step(12)
    assert robot.commands()[-1].forward_m_s > 0.3


@pytest.mark.parametrize(("start", "rate_rad_s"), [("go_to", 1.5), ("move", 1.0)])
def test_robot_that_is_touched_stops_turning_too(robot, start, rate_rad_s):
    if start == "go_to":
        under_way(robot, lambda plugin: plugin.go_to(4.0, 0.0, math.pi), 12)
    else:
        under_way(robot, lambda plugin: hand(plugin, 0.0, 0.0, rate_rad_s), 12)
    assert robot.wheels.twist.yaw_rad_s == pytest.approx(rate_rad_s, abs=0.5)
    robot.bump(math.pi - robot.wheels.at.yaw_rad)
    robot.step()
    assert robot.commands()[0] == "stop"
    assert 0.0 < robot.wheels.twist.yaw_rad_s <= 20.0 * PERIOD_S**2 + 1e-9


@pytest.mark.parametrize(("touched_deg", "may_go"), [(0.0, False), (79.0, False), (-79.0, False), (81.0, True)])
def test_robot_does_not_press_on_towards_what_it_touches(robot, touched_deg, may_go):
    robot.bump(math.radians(touched_deg))
    ahead(robot.plugin)
    robot.step(20)
    assert (robot.wheels.twist.forward_m_s > 0.1) == may_go


@pytest.mark.parametrize(
    ("yaw_rad", "touched_rad", "may_go"),
    [
        (2.0, -2.0, False),
        (-2.0, 2.0, False),
        (2.0, 2.0, True),
        (3.0, 0.0, True),
        (3.0, 3.0, False),
        (-3.0, -3.0, False),
    ],
)
def test_what_is_touched_counts_in_the_direction_in_which_it_lies(robot, yaw_rad, touched_rad, may_go):
    robot.wheels.at = Pose2D(0.0, 0.0, yaw_rad)
    robot.bump(touched_rad)
    robot.plugin.go_to(5.0, 0.0, yaw_rad)
    robot.step(20)
    assert (robot.wheels.at.x_m > 0.1) == may_go


def test_contact_that_is_pressed_when_the_driver_starts_is_known_from_the_start():
    one = BareDriver()
    one.ring.pressed = (0.0,)
    one.plugin.activate()
    ahead(one.plugin)
    assert wheels_stand(one)
    one.bump()
    one.step(10)
    assert one.wheels.twist.forward_m_s > 0.1


def test_bump_of_a_robot_that_stands_and_the_end_of_a_bump_command_nothing(robot):
    robot.bump(0.0)
    assert robot.commands() == []
    under_way(robot, ahead, 3)
    robot.bump()
    assert robot.commands() == []


# -- the end ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "start", [ahead, by_hand, lambda plugin: plugin.turn(6.0), lambda plugin: None], ids=["path", "hand", "turn", "-"]
)
def test_driver_that_is_deactivated_stops_the_wheels_and_commands_nothing_more(robot, start):
    under_way(robot, start, 10)
    robot.plugin.deactivate()
    assert robot.commands() == ["stop"]
    assert robot.plugin.motion() is Motion.STOPPED
    robot.step(10)
    assert robot.commands() == []


@pytest.mark.parametrize("start", [ahead, by_hand, lambda plugin: plugin.turn(6.0)], ids=["path", "hand", "turn"])
def test_halted_driver_has_forgotten_where_it_went(robot, start):
    under_way(robot, start, 10)
    robot.wheels.stop()  # devices are halted first
    robot.wheels.at = Pose2D(0.0, 0.0, 0.0)
    robot.plugin.emergency_halt()
    robot.end_actions("emergency halt")
    robot.commands()
    robot.step(10)
    assert robot.commands() == []
    assert robot.plugin.motion() is Motion.STOPPED
    # What comes next starts from rest.
    ahead(robot.plugin)
    robot.step()
    assert robot.wheels.twist.forward_m_s <= GENTLE_M_S + 1e-9
    assert robot.wheels.twist.yaw_rad_s == 0.0


def test_action_that_was_ended_from_elsewhere_stops_the_wheels_at_the_next_step(robot):
    under_way(robot, lambda plugin: plugin.drive(5.0))
    robot.end_actions("the plugin that asked for it has gone")
    robot.step()
    assert robot.commands() == ["stop"]
    assert wheels_stand(robot)
    assert [end.outcome for end in robot.ends] == [Outcome.CANCELLED]


@pytest.mark.parametrize("end", ["stop", "cancel", "follow"])
def test_robot_that_is_to_stand_stops_its_wheels_at_once(robot, end):
    action = under_way(robot, lambda plugin: plugin.drive(5.0))
    if end == "cancel":
        assert robot.plugin.cancel(action) is True
    elif end == "stop":
        robot.plugin.stop()
    else:
        robot.plugin.follow([])
    assert robot.commands() == ["stop"]
    assert wheels_stand(robot)
    assert robot.plugin.cancel(action) is False


# -- what turns up ----------------------------------------------------------------------------------------------


def test_wall_that_turns_up_too_near_is_braked_for_hard_and_at_once(robot):
    under_way(robot, ahead, 40)
    speed_m_s = robot.wheels.twist.forward_m_s
    assert speed_m_s == pytest.approx(0.6)
    robot.lidar.wall_m = robot.wheels.at.x_m + 0.6 * PERIOD_S + 0.2 + 0.12 + 0.2
    robot.step(4)
    said = [twist.forward_m_s for twist in robot.commands()]
    assert said == pytest.approx([speed_m_s - BRAKED_M_S * (number + 1) for number in range(4)])
    robot.step(40)
    assert robot.lidar.wall_m - robot.wheels.at.x_m > 0.2
    assert robot.plugin.motion() is Motion.BLOCKED


def test_hand_that_drives_at_a_wall_is_braked_hard_as_well(robot):
    under_way(robot, by_hand)
    robot.lidar.wall_m = robot.wheels.at.x_m + 0.5 * PERIOD_S + 0.2 + 0.12 + 0.05
    robot.step(3)
    said = [twist.forward_m_s for twist in robot.commands()]
    assert said == pytest.approx([0.5 - BRAKED_M_S * (number + 1) for number in range(3)])


def test_robot_that_drifts_towards_a_wall_brakes_although_its_path_now_leads_aside(robot):
    under_way(robot, ahead, 40)
    at = robot.wheels.at
    robot.lidar.wall_m = at.x_m + 0.6 * PERIOD_S + 0.2 + 0.12 + 0.1
    robot.plugin.follow([Point2D(at.x_m + 0.036, 5.0)])
    robot.step()
    twist = robot.wheels.twist
    assert math.hypot(twist.forward_m_s, twist.left_m_s) == pytest.approx(0.6 - BRAKED_M_S)
    robot.step(100)
    assert robot.lidar.wall_m - robot.wheels.at.x_m > 0.2
    assert robot.wheels.at.y_m > 1.0


def test_what_uses_up_a_little_of_the_stop_distance_is_stopped_at_smoothly(robot):
    under_way(robot, ahead, 40)
    # From 0.6 m/s it stands after 0.225 m, 0.06 m for the jerk and 0.048 m for the delay; 4 cm may be missing.
    robot.lidar.wall_m = robot.wheels.at.x_m + 0.6 * PERIOD_S + 0.2 + 0.12 + 0.333 - 0.035
    robot.step()
    assert robot.commands()[0].forward_m_s > 0.6 - 2.1 * GENTLE_M_S
    robot.lidar.wall_m = robot.wheels.at.x_m + robot.wheels.twist.forward_m_s * PERIOD_S + 0.2 + 0.12 + 0.2
    robot.step()
    assert robot.commands()[0].forward_m_s < 0.6 - BRAKED_M_S


def test_wall_ahead_is_stopped_at_in_its_distance(robot):
    robot.lidar.wall_m = 3.0
    ahead(robot.plugin)
    robot.step(300)
    # The disc that is looked for is wider by a quarter of the stop distance than the robot.
    assert 3.0 - robot.wheels.at.x_m - 0.2 == pytest.approx(0.12, abs=0.01)
    assert robot.plugin.motion() is Motion.BLOCKED


# -- when it cannot know ----------------------------------------------------------------------------------------


def test_robot_that_turns_stands_when_the_wheels_say_nothing_and_starts_again_from_rest(robot):
    action = under_way(robot, lambda plugin: plugin.turn(6.0), 15)
    assert robot.wheels.twist.yaw_rad_s == pytest.approx(1.5)
    robot.wheels.fresh = False
    robot.step(3)
    assert robot.commands() == [STILL] * 3
    assert robot.plugin.blocked_reason() == "no data from the wheel encoders"
    robot.wheels.fresh = True
    robot.step()
    assert 0.0 < robot.wheels.twist.yaw_rad_s <= 20.0 * PERIOD_S**2 + 1e-9
    assert (robot.plugin.motion(), robot.plugin.blocked_reason()) == (Motion.DRIVING, "")
    assert robot.plugin.cancel(action) is True


BLIND = {
    "encoders": ("no data from the wheel encoders", lambda robot: setattr(robot.wheels, "fresh", False)),
    "lidar": ("there has been no fresh scan", lambda robot: setattr(robot.lidar, "speaks", False)),
}


@pytest.mark.parametrize("blind", BLIND)
@pytest.mark.parametrize("start", [lambda plugin: plugin.go_to(9.0, 0.0, 3.0), by_hand], ids=["path", "hand"])
def test_robot_that_is_blind_stands_and_starts_again_from_rest(robot, start, blind):
    why, make_blind = BLIND[blind]
    if start is by_hand:
        robot.hand(0.5, 0.0, 1.0)
        robot.step(10)
    else:
        under_way(robot, start, 10)
    make_blind(robot)
    robot.step(12)  # a scan counts for 0.6 s
    robot.commands()
    robot.step(3)
    assert robot.commands() == [STILL] * 3
    assert (robot.plugin.motion(), robot.plugin.blocked_reason()) == (Motion.BLOCKED, why)
    robot.wheels.fresh = robot.lidar.speaks = True
    robot.step()
    twist = robot.wheels.twist
    assert 0.0 < math.hypot(twist.forward_m_s, twist.left_m_s) <= GENTLE_M_S + 1e-9
    assert 0.0 < twist.yaw_rad_s <= 20.0 * PERIOD_S**2 + 1e-9
    assert robot.plugin.motion() is Motion.DRIVING


def test_frozen_lidar_is_doubted_and_the_robot_stands(robot):
    robot.lidar.wall_m = 5.0
    under_way(robot, ahead, 15)
    assert robot.lidar.doubts == []
    frozen = robot.lidar.latest()
    robot.lidar.latest = lambda: type(frozen)(
        robot.clock.now_ns(), frozen.beam_angles_rad, frozen.beam_ranges_m, frozen.range_max_m
    )
    robot.step(10)
    assert robot.wheels.twist == STILL
    assert robot.plugin.blocked_reason() == "the lidar has been frozen"
    assert "the lidar is frozen" in robot.lidar.doubts[0]


# -- patience ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("start", [lambda plugin: plugin.drive(3.0), lambda plugin: plugin.turn(3.0)])
def test_action_fails_when_its_way_has_been_blocked_for_longer_than_the_patience(start):
    robot = BareDriver(patience_s=1.2)
    robot.plugin.activate()
    start(robot.plugin)
    robot.wheels.fresh = False
    robot.step(21)  # blocked since the first: 1.2 s
    assert robot.ends == []
    assert robot.plugin.blocked_s() == pytest.approx(1.2)
    robot.step()
    assert [(end.outcome, end.why) for end in robot.ends] == [
        (Outcome.FAILED, "no data from the wheel encoders for 1.2 s")
    ]
    assert (robot.plugin.motion(), robot.plugin.blocked_s()) == (Motion.STOPPED, 0.0)
    assert robot.commands()[-1] == "stop"
