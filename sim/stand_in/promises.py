"""What the coordinator has promised by acknowledging tasks and cancellations, and whether it was kept."""

from collections.abc import Mapping

from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.sim.stand_in.operator import PointOperator


class Promises:
    """The promises of one run.

    Args:
        asked: every task of the script.
        operator: who has asked.

    """

    def __init__(self, asked: Mapping[str, Task], operator: PointOperator) -> None:
        self._asked = asked
        self._operator = operator

    def breach_reason(self, task_id: str, record: TaskRecord | None) -> str:
        """Why the end of an acknowledged task is none that was asked for, in one sentence; empty if it is.

        Args:
            task_id: the task.
            record: as the coordinator has it at the end of the run.

        """
        operator = self._operator
        if record is None:
            return f"{task_id} was acknowledged, and the coordinator does not know it"
        if record.state is TaskState.DONE and task_id in operator.cancelled:
            return f"{task_id} is done, although its cancellation was acknowledged"
        if record.state is TaskState.CANCELLED and task_id not in operator.asked_to_cancel:
            if not any(self._may_fail(name) for name in self._asked[task_id].after):
                return f"{task_id} is cancelled, and nobody asked for that"
        elif record.state is TaskState.FAILED and not self._may_fail(task_id):
            return f"{task_id} has failed without need: {record.why}"
        return ""

    def _may_fail(self, task_id: str) -> bool:
        """Whether a task, or one that it waits for, may end otherwise than done."""
        task = self._asked[task_id]
        if task.deadline_ns is not None or task_id in self._operator.asked_to_cancel:
            return True
        return any(self._may_fail(name) for name in task.after)
