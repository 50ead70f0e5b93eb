"""Predicted cost of the coordinator's own tasks, to explore and to charge; published like the decisions of plans."""

import math

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.plan_messages import TaskDecision
from robrain.protocol.messages.tasks.task_messages import RobotVerdict
from robrain.protocol.model.energy_model import Work, estimate
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import RECHARGE, Recharge
from robrain.protocol.model.tasks.task import Task, parameters_of
from robrain.protocol.reasons import plain, told

DETOUR = 1.5
"""Assumed ratio of path length to straight line where the length is unknown (chosen; robots assume the same)."""
DOCK_S = 10.0
"""Approximate time to dock; robots assume the same. The charge itself is not included."""


def own_decision(
    task: Task, state: RobotState | None, way_m: float, plan: int, policy: PlanningPolicy
) -> TaskDecision | None:
    """Return the decision for a robot, with joules and seconds; None if its state has too little for that.

    Args:
        task: the task that it will be offered.
        state: of the robot.
        way_m: path length; nan if unknown.
        plan: number of the last plan.
        policy: path cost parameters.

    """
    if state is None or state.pose is None or state.energy is None:
        return None
    place = task.place
    if not math.isfinite(way_m):
        way_m = DETOUR * _away_m(Point2D(state.pose.x_m, state.pose.y_m), place)
    found = estimate(state.energy, Work(path_m=way_m, wait_s=DOCK_S if task.kind == RECHARGE else 0.0))
    time_s = policy.time_margin * found.duration_s
    verdict = RobotVerdict(robot=state.robot, chosen=True, energy_j=round(found.mean_j, 3), time_s=round(time_s, 3))
    if task.kind == RECHARGE:
        to_soc = parameters_of(task, Recharge).until_soc
        reason = plain("to_charge", f"it is to charge to {to_soc:.0%}", to_soc=to_soc)
    else:
        reason = plain("nothing_else", "it has nothing else to do")
    return TaskDecision(task=task.id, plan=plan, robots=(state.robot,), start_in_s=0.0, why=told(reason),
                        reason=reason, bids=(verdict,))  # fmt: skip


def _away_m(one: Point2D, other: Point2D) -> float:
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
