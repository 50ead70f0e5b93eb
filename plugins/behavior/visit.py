"""Visit: goes to a place and stays there for the task's service time."""

from robrain.plugins.behavior.errand import Errand, Script
from robrain.protocol.model.tasks.stock_kinds import VISIT, TaskParameters
from robrain.protocol.model.tasks.task import Task


class VisitBehavior(Errand[TaskParameters]):
    """Drives to a place and stays there."""

    kind = VISIT

    def do(self, task: Task, parameters: TaskParameters) -> Script:
        """Stay. Result: `off_m`, how far from the place the robot stood."""
        off_m = self.away_m(task.place)
        yield from self.wait(task.service_s)
        return {"off_m": round(off_m, 3)}
