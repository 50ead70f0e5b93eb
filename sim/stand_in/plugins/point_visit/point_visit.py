"""Point visit: a stand-in robot goes to a place and stays there for the task's service time."""

from robrain.protocol.model.tasks.stock_kinds import VISIT, TaskParameters
from robrain.sim.stand_in.plugins.point_errand import PointErrand


class PointVisit(PointErrand):
    """Does visits."""

    kind = VISIT
    task_parameters = TaskParameters
