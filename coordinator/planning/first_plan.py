"""A small plan from beginning to end, so that the first that counts does not wait for code to be loaded."""

import numpy as np

from robrain.coordinator.allocation.warm_up import warm_up
from robrain.coordinator.planning.floor import Floor
from robrain.coordinator.planning.plan_search import Drafting
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.snapshot import Member, Situation
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.mapping.occupancy_grid import FREE, GridGeometry
from robrain.protocol.model.tasks.stock_kinds import VISIT
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.messages.robot_messages import RobotState
from robrain.protocol.wire.messages.task_messages import TaskRecord

SIDE = 40
"""Cells of the floor."""


def rehearse() -> None:
    """Load and call whatever makes plans: the allocators' kernels, those of the floor's ways, and the search."""
    warm_up()
    places = [Point2D(1.0, 1.0), Point2D(3.0, 1.0), Point2D(1.0, 3.0)]
    here = Point2D(2.0, 2.0)
    situation = Situation(
        number=0,
        now_ns=0,
        cause="",
        records=tuple(
            TaskRecord(task=Task(id=f"t{k}", kind=VISIT, place=at), state=TaskState.QUEUED)
            for k, at in enumerate(places)
        ),
        ended=frozenset(),
        members={
            name: Member(RobotState(robot=name, pose=Pose2D(here.x_m, here.y_m, 0.0)), None, (), here)
            for name in ("r1", "r2")
        },
        pauses={},
        served_s={},
        floor=Floor(np.full((SIDE, SIDE), FREE), GridGeometry(0.1, 0.0, 0.0, SIDE, SIDE), 1),
        orders={},
        told={},
    )
    draft = Drafting().draft(situation, PlanningPolicy(iterations=1))
    for _ in draft.improve():
        if draft.thinking.rounds:
            break
    draft.planned()
