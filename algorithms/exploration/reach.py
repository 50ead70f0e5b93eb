"""How far a robot that explores may go: it must be able to get to a charger afterwards, with a reserve."""

import math
from bisect import bisect_left

from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.model.energy_model import EnergyModel, Work, estimate

PLENTY_M = 1000.0
"""A robot that can go this far can go anywhere (chosen: no floor of a team has two such paths)."""
STEP_M = 4.0
"""Reaches are rounded down to a multiple of this, so that a decision does not change whenever a joule is spent."""
SOC_LEAST = 0.01
"""The capacity follows from a state of charge of at least this."""


def reach_m(
    model: EnergyModel | None, battery: BatteryState | None, *, reserve_share: float, confidence: float
) -> float:
    """Length of path that a robot can surely drive and keep its reserve, metres.

    Args:
        model: the robot's learned consumption.
        battery: its estimate.
        reserve_share: share of the capacity that stays in the battery.
        confidence: one-sided confidence of the energy that the path takes.

    Returns:
        A multiple of `STEP_M`; inf if that is `PLENTY_M` or more, or model or battery are unknown.

    """
    if model is None or battery is None:
        return math.inf
    surely_j = model.usable_j - reserve_share * battery.remaining_j / max(battery.soc, SOC_LEAST)

    def is_too_far(steps: int) -> bool:
        return not estimate(model, Work(path_m=STEP_M * steps)).high_j(confidence) <= surely_j

    most = math.ceil(PLENTY_M / STEP_M)
    return STEP_M * bisect_left(range(1, most), True, key=is_too_far) if is_too_far(most) else math.inf
