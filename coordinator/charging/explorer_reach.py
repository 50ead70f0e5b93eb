"""How far a robot that explores may go: it must be able to get to a charger afterwards, with the reserve of plans."""

import math

from robrain.coordinator.planning.energy_budget import SOC_LEAST
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.model.energy.energy_model import Work, estimate
from robrain.protocol.wire.messages.robots.robot_messages import RobotState

PLENTY_M = 1000.0
"""A robot that can go this far can go anywhere (chosen: no floor of a team has two such paths)."""
STEP_M = 4.0
"""Reaches are rounded down to a multiple of this, so that a decision does not look new whenever a joule is spent."""


def reach_m(state: RobotState, policy: PlanningPolicy) -> float:
    """Length of path that a robot can surely drive and keep its reserve, metres.

    Args:
        state: of the robot.
        policy: its reserve and its confidence.

    Returns:
        A multiple of `STEP_M`; inf if that is `PLENTY_M` or more, or the robot publishes no battery or energy model.

    """
    model, battery = state.energy, state.battery
    if model is None or battery is None:
        return math.inf
    reserve_j = policy.reserve_share * battery.remaining_j / max(battery.soc, SOC_LEAST)
    surely_j = model.usable_j - reserve_j

    def is_within(steps: int) -> bool:
        return estimate(model, Work(path_m=STEP_M * steps)).high_j(policy.confidence) <= surely_j

    most = math.ceil(PLENTY_M / STEP_M)
    if is_within(most):
        return math.inf
    least = 0
    while most - least > 1:
        middle = (least + most) // 2
        least, most = (middle, most) if is_within(middle) else (least, middle)
    return STEP_M * least
