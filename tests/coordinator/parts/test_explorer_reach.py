"""How far an explorer's energy lasts, and what the coordinator makes of it."""

import math

import pytest

from robrain.algorithms.exploration.reach import PLENTY_M, STEP_M
from robrain.coordinator.parts.exploration import Exploration, reach_m
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.model.energy_model import Work, estimate
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.reasons import LacksRange
from tests.coordinator.planning.worlds import CAPACITY_J, Worker, model, run

POLICY = PlanningPolicy()
CHARGER = Point2D(3.5, 2.5)


def state(usable_j, *, dearer=1.0):
    battery = BatteryState(
        voltage_v=16.0, current_a=1.0, temperature_c=20.0, soc=usable_j / CAPACITY_J, remaining_j=usable_j
    )
    return RobotState(robot="r1", pose=Pose2D(0.0, 0.0, 0.0), battery=battery, energy=model(usable_j, dearer=dearer))


@pytest.mark.parametrize("usable_j", [12_000.0, 20_000.0, 40_000.0])
def test_reach_is_the_longest_path_that_leaves_the_reserve(usable_j):
    robot = state(usable_j)
    found_m, reserve_j = reach_m(robot, POLICY), POLICY.reserve_share * CAPACITY_J

    def bound_j(path_m):
        return estimate(robot.energy, Work(path_m=path_m)).high_j(POLICY.confidence)

    assert found_m > 0
    assert found_m % STEP_M == 0
    assert bound_j(found_m) <= usable_j - reserve_j < bound_j(found_m + STEP_M)


def test_robot_below_its_reserve_goes_nowhere():
    assert reach_m(state(0.9 * POLICY.reserve_share * CAPACITY_J), POLICY) == 0.0


def test_robot_with_plenty_of_energy_or_without_a_model_may_go_anywhere():
    assert reach_m(state(CAPACITY_J), POLICY) == math.inf
    assert estimate(model(CAPACITY_J), Work(path_m=PLENTY_M)).mean_j < CAPACITY_J
    assert reach_m(RobotState(robot="r1", pose=Pose2D(0.0, 0.0, 0.0)), POLICY) == math.inf


def test_robot_that_lacks_only_energy_charges_and_then_explores(team):
    """It has 45 % of its charge, enough for an idle robot, and a metre takes 400 times what it usually does."""
    robot = team.robot("r1", 6.0, 4.0)
    robot.plugins = ["explore", "visit", "recharge"]
    robot.chargers = [CHARGER]
    worker = Worker(robot, remaining_j=0.45 * CAPACITY_J, dearer=400.0)
    team.run(1.0)  # its chargers are asked for
    team.corridor()
    team.run(1.0)
    idle = team.coordinator.part(Exploration).explorer.idle["r1"]
    assert isinstance(idle, LacksRange)
    assert idle.frontiers == 2
    assert idle.reach_m == 4.0
    assert run(team, [worker], 60.0, until=lambda: len(robot.offers) > 1)
    assert [offer.task.kind for offer in robot.offers] == ["recharge", "explore"]
    assert worker.least_j > POLICY.reserve_share * CAPACITY_J
