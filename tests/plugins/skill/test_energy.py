import msgspec
import pytest

from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.model.energy_model import EnergyModel, Work, estimate
from robrain.protocol.model.geometry import Pose2D


@pytest.fixture
def robot(stage, room):
    """A robot with a body in a room of 10 × 4 m, its energy skill loaded."""
    one = stage(room(10.0, 4.0), r1=Pose2D(1.0, 2.0, 0.0))
    one.host("energy")
    one.run(0.4)
    return one


def drive(one, distance_m):
    one.call("driver", "drive", distance_m)
    one.run(0.5)
    one.run_until(lambda: one.call("driver", "motion") != "driving", 60.0)


def shuttle(one, times):
    for _ in range(times):
        drive(one, 7.0)
        one.run(5.0)
        drive(one, -7.0)
        one.run(5.0)


def cost_j(one, doing):
    before_j = one.truth().energy_j
    doing()
    return one.truth().energy_j - before_j


@pytest.mark.slow
def test_what_a_way_costs_is_learned_over_the_bus_and_told_in_the_state(robot):
    states = robot.inbox(ROBOT_STATE)
    before = robot.call("energy", "estimate", {"path_m": 7.0})
    shuttle(robot, 4)
    after = robot.call("energy", "estimate", {"path_m": 7.0})
    assert after["sigma_j"] < before["sigma_j"]
    true_j = cost_j(robot, lambda: drive(robot, 7.0))
    assert after["mean_j"] == pytest.approx(true_j, rel=0.06)
    assert abs(after["mean_j"] - true_j) < 2.0 * after["sigma_j"] + 0.02 * true_j
    model = states.drain()[-1].message.energy
    assert model.coefficients[0] == pytest.approx(8.0, abs=0.5)
    assert model.usable_j > 0.5 * 20.0 * 3600.0
    # The coordinator computes the same from what the robot says.
    work = {"path_m": 3.0, "wait_s": 20.0}
    own = robot.call("energy", "estimate", work)
    said = robot.call("energy", "model")
    told = estimate(msgspec.convert(said, EnergyModel), Work(**work))
    assert (told.mean_j, told.sigma_j) == pytest.approx((own["mean_j"], own["sigma_j"]))


@pytest.mark.slow
def test_a_battery_that_lies_teaches_nothing_and_leaves_less_to_use(robot):
    shuttle(robot, 1)
    before = robot.call("energy", "model")
    robot.arena._robots[0].manager.lie = lambda reading: (reading[0], 12.0, reading[2])
    robot.run(30.0)
    after = robot.call("energy", "model")
    assert after["coefficients"] == pytest.approx(before["coefficients"], abs=0.3)
    assert after["usable_j"] < before["usable_j"] - 2000.0
