"""Driving by hand: a robot goes for as long as somebody goes on asking, and no longer."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.plugins.unit.driver.by_hand import LONGEST_LEASE_S, ByHand
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError
from robrain.protocol.model.geometry import Pose2D, Twist2D

START = Pose2D(1.0, 2.0, 0.0)
RENEW_S = 0.02
STOP_S = 0.3
"""How long the wheels may turn after the holder's last command."""


@pytest.fixture
def robot(stage, room):
    one = stage(room(6.0, 4.0), r1=START)
    one.host("localisation")
    one.run(0.4)
    return one


def hold(robot, seconds, *velocity):
    """Hold a button for so long."""
    lease = robot.call("driver", "acquire_hand_lease", "ann")["lease"]
    for _ in range(round(seconds / RENEW_S)):
        robot.call("driver", "move", *velocity, lease)
        robot.run(RENEW_S)
    return lease


def test_robot_goes_while_it_is_asked_to_and_stands_when_nobody_asks_any_more(robot):
    hold(robot, 2.0, 0.25, 0.0, 0.0)
    pose = robot.truth().pose
    assert pose.x_m == pytest.approx(START.x_m + 0.25 * 2.0, abs=0.15)
    assert pose.y_m == pytest.approx(START.y_m, abs=0.03)
    assert robot.call("driver", "motion") == Motion.DRIVING
    robot.run(STOP_S)
    stood = robot.truth().pose
    robot.run(1.0)
    assert robot.truth().pose.x_m == pytest.approx(stood.x_m, abs=0.0005)
    assert robot.call("driver", "motion") == Motion.STOPPED


@pytest.mark.slow
def test_hand_does_not_drive_into_a_wall(robot):
    hold(robot, 22.0, 0.6, 0.0, 0.0)
    assert robot.truth().collisions == 0
    assert robot.truth().pose.x_m == pytest.approx(6.0 - 0.2 - 0.12, abs=0.12)


@given(
    st.lists(st.tuples(st.floats(0.0, 3.0), st.booleans(), st.sampled_from([0.0, 0.3])), max_size=20),
    st.floats(0.01, LONGEST_LEASE_S),
)
def test_nobody_holds_longer_than_the_last_lease(wishes, lease_s):
    hand, now_ns, until_ns, drove, lease = ByHand(lease_s), 0, None, False, 0
    for pause_s, takes, speed_m_s in wishes:
        now_ns += to_ns(pause_s)
        assert hand.holds(now_ns) == (until_ns is not None and now_ns < until_ns)
        assert hand.has_ended(now_ns) == (drove and not hand.holds(now_ns))
        drove = hand.holds(now_ns)
        if takes:
            lease = hand.lease("ann", now_ns).lease
        try:
            hand.ask(Twist2D(speed_m_s, 0.0, 0.0), lease, now_ns)
        except CallError:
            continue
        if speed_m_s:
            until_ns, drove = now_ns + to_ns(lease_s), True
        elif drove:
            until_ns = now_ns
