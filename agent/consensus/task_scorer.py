"""What open tasks are worth to this robot, from its own energy model, its battery and the chargers it knows.

A robot keeps the energy for the way to a charger, which is no part of what a task costs: it charges when it must, not
after each allocation.

Ways are taken to be half as long again as a straight line; the behavior that is to do a task looks for the way itself,
and refuses what is out of reach or too expensive.
"""

import math
from collections.abc import Callable, Sequence

from robrain.protocol.model.consensus.route_scorer import Drive, RouteScorer, Stop
from robrain.protocol.model.energy.energy_model import EnergyModel, Work, estimate
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task

DETOUR = 1.5
"""How much longer than a straight line a way is taken to be (chosen, as in `plugins/behavior/budget.py`)."""
CONFIDENCE = 0.95
PRIZE_SHARE = 10.0
"""A task of priority 1 is worth so many times the longest way of the problem (chosen: every task is worth its way)."""

NOISE = 1.0
"""Width of the noise of scores in rounds of improvement: few rounds are to differ much (measured: 20 rounds of 5 robots
with 15 tasks then save 12 % of the way, and 5 % with 0.3)."""

WorkOf = Callable[[Task], Work]


def task_scorer(
    tasks: Sequence[Task], at: Point2D, ends: Sequence[Point2D], model: EnergyModel | None, now_ns: int, work_of: WorkOf
) -> RouteScorer:
    """Scores of tasks for a robot.

    Args:
        tasks: those that the robot is able to do.
        at: where it is.
        ends: chargers; without any, the place where it has to be in the end.
        model: what its work costs; None counts metres and takes its energy to be enough.
        now_ns: the time.
        work_of: what a task takes at its place.

    """
    places = [*(task.place for task in tasks), at, *ends]
    ways_m = [[DETOUR * math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) for b in places] for a in places]
    metre = Work(path_m=1.0)
    per_m_j = 1.0 if model is None else estimate(model, Work(path_m=100.0)).high_j(CONFIDENCE) / 100.0
    per_m_s = 1.0 if model is None else estimate(model, metre).duration_s
    worth_j = PRIZE_SHARE * per_m_j * (1.0 + max(max(row) for row in ways_m))
    stops = {}
    for index, task in enumerate(tasks):
        work = work_of(task)
        service = None if model is None else estimate(model, work)
        stops[task.id] = Stop(
            index,
            worth_j * task.priority + (0.0 if service is None else service.high_j(CONFIDENCE)),
            service_s=work.wait_s if service is None else service.duration_s,
            service_j=0.0 if service is None else service.high_j(CONFIDENCE),
            latest_s=math.inf if task.deadline_ns is None else (task.deadline_ns - now_ns) / 1e9,
        )
    drive = Drive(
        energy_j=[[way_m * per_m_j for way_m in row] for row in ways_m],
        time_s=[[way_m * per_m_s for way_m in row] for row in ways_m],
        start=len(tasks),
        ends=tuple(range(len(tasks) + 1, len(places))),
        usable_j=math.inf if model is None else model.usable_j,
        counts_end=False,
    )
    return RouteScorer(drive, stops, NOISE)
