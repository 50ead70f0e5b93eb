"""How far a robot that explores may go, by the reserve and the confidence of plans."""

from robrain.algorithms.exploration import reach
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.messages.robots.robot_messages import RobotState


def reach_m(state: RobotState, policy: PlanningPolicy) -> float:
    """Length of path that a robot can surely drive and keep its reserve, metres (`algorithms/exploration/reach.py`)."""
    reserve_share, confidence = policy.reserve_share, policy.confidence
    return reach.reach_m(state.energy, state.battery, reserve_share=reserve_share, confidence=confidence)
