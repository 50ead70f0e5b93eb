"""What a task of the coordinator's own takes its robot, as it is told."""

import math

import msgspec
import pytest

from robrain.coordinator.planning.own_tasks import own_decision
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.task import Explore, Recharge
from robrain.protocol.wire.messages import RobotState
from tests.coordinator.planning.worlds import model

POLICY = PlanningPolicy(time_margin=2.0)
EXPLORE = Explore(id="e1", goal=Point2D(4.0, 6.0))
RECHARGE = Recharge(id="c1", place=Point2D(4.0, 6.0), until_soc=0.8)
STATE = RobotState(robot="r1", pose=Pose2D(1.0, 2.0, 0.0), energy=model(1e5))


def told(task, way_m, state=STATE):
    decision = own_decision(task, state, way_m, 7, POLICY)
    [bid] = decision.bids
    assert (decision.task, decision.plan, decision.robots, decision.start_in_s) == (task.id, 7, ("r1",), 0.0)
    assert (bid.robot, bid.chosen) == ("r1", True)
    return bid.energy_j, bid.time_s


def test_exploring_takes_the_way():
    """At 0.5 m/s; 8 W standing, 20 J a metre."""
    assert told(EXPLORE, 10.0) == (360.0, 40.0)
    assert told(EXPLORE, 10.0004) == (360.014, 40.002)  # to a millijoule and a millisecond


def test_charging_takes_the_way_and_docking():
    assert told(RECHARGE, 10.0) == (440.0, 60.0)


@pytest.mark.parametrize("way_m", [math.nan, math.inf])
def test_a_way_that_is_not_known_is_taken_for_half_as_long_again_as_the_straight_line(way_m):
    assert told(EXPLORE, way_m) == told(EXPLORE, 7.5)


def test_why_is_told():
    assert own_decision(EXPLORE, STATE, 1.0, 1, POLICY).why == "it has nothing else to do"
    assert own_decision(RECHARGE, STATE, 1.0, 1, POLICY).why == "it is to charge to 80%"


@pytest.mark.parametrize("missing", ["pose", "energy"])
def test_of_a_robot_that_does_not_tell_enough_of_itself_nothing_is_told(missing):
    assert own_decision(EXPLORE, None, 10.0, 1, POLICY) is None
    assert own_decision(EXPLORE, msgspec.structs.replace(STATE, **{missing: None}), 10.0, 1, POLICY) is None
