"""What a task of the coordinator's own is told to take: the way, and docking if it is to charge."""

import math

import pytest

from robrain.coordinator.planning.energy_budget import DETOUR, DOCK_S, own_decision
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task
from tests.coordinator.planning.worlds import J_PER_M, PACE_M_S, STANDING_W, model

POLICY = PlanningPolicy(time_margin=1.25)
STATE = RobotState(robot="r1", pose=Pose2D(1.0, 2.0, 0.5), energy=model(50_000.0))
EXPLORE = Task(id="explore-1", kind="explore", place=Point2D(4.0, 6.0))
RECHARGE = Task(id="recharge-1", kind="recharge", place=Point2D(4.0, 6.0), parameters={"until_soc": 0.95})


def takes(path_m: float, wait_s: float = 0.0) -> tuple[float, float]:
    """Joules and seconds of a way, and of standing at its end."""
    duration_s = path_m / PACE_M_S + wait_s
    return STANDING_W * duration_s + J_PER_M * path_m, 1.25 * duration_s


@pytest.mark.parametrize(
    ("task", "path_m", "expected"),
    [
        (EXPLORE, 8.0, takes(8.0)),
        (EXPLORE, 0.0, takes(0.0)),
        (EXPLORE, math.nan, takes(DETOUR * 5.0)),
        (EXPLORE, math.inf, takes(DETOUR * 5.0)),
        (RECHARGE, 8.0, takes(8.0, DOCK_S)),
        (RECHARGE, math.nan, takes(DETOUR * 5.0, DOCK_S)),
    ],
)
def test_a_task_takes_its_way_and_a_charge_also_the_docking(task, path_m, expected):
    decision = own_decision(task, STATE, path_m, 7, POLICY)
    assert decision is not None
    (bid,) = decision.bids
    assert (bid.energy_j, bid.arrives_in_s) == pytest.approx(expected)
    assert (bid.robot, bid.chosen) == ("r1", True)
    assert decision.why == ("it has nothing else to do" if task is EXPLORE else "it is to charge to 95%")
    assert (decision.task, decision.plan, decision.robots, decision.start_in_s) == (task.id, 7, ("r1",), 0.0)


@pytest.mark.parametrize(
    "state",
    [RobotState(robot="r1", pose=STATE.pose), RobotState(robot="r1", energy=STATE.energy)],
    ids=["no energy", "no pose"],
)
def test_nothing_is_said_of_a_robot_that_does_not_tell_where_it_is_and_what_it_takes(state):
    assert own_decision(EXPLORE, state, 8.0, 7, POLICY) is None
