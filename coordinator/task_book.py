"""The book of tasks: which there are, who does them, how they ended."""

from collections.abc import Callable

import msgspec

from robrain.protocol.model.task import Task, TaskState
from robrain.protocol.wire.clock import Clock
from robrain.protocol.wire.messages import TaskEvent, TaskStatus

KEPT_ENDED = 1000


class TaskRecord(msgspec.Struct, frozen=True, kw_only=True):
    """A task as it stands."""

    task: Task
    state: TaskState
    robot: str = ""
    epoch: int = 0
    why: str = ""
    changed_ns: int = 0
    """When it last changed, by the coordinator's clock."""


class TaskBook:
    """Keeps the records and tells every change.

    Args:
        clock: of the run.
        first_epoch: greater than any epoch of an earlier coordinator of the team.
        tell: called with each change.

    """

    def __init__(self, clock: Clock, first_epoch: int, tell: Callable[[TaskEvent], None]) -> None:
        self.done_count = 0
        self._clock = clock
        self._epoch = first_epoch
        self._tell = tell
        self._open: dict[str, TaskRecord] = {}
        self._ended: dict[str, TaskRecord] = {}

    @property
    def open(self) -> list[TaskRecord]:
        """Tasks that have not ended, in the order in which they were added."""
        return list(self._open.values())

    def of_robot(self, robot: str) -> TaskRecord | None:
        """The task that a robot is at."""
        return next((record for record in self._open.values() if record.robot == robot), None)

    def add(self, task: Task) -> None:
        """A new task, queued."""
        self._change(TaskRecord(task=task, state=TaskState.QUEUED))

    def offered(self, task_id: str, robot: str) -> TaskRecord:
        """A task is about to be offered; the record has a new epoch."""
        self._epoch += 1
        record = self._open[task_id]
        return self._change(
            msgspec.structs.replace(record, state=TaskState.OFFERED, robot=robot, epoch=self._epoch, why="")
        )

    def move(self, task_id: str, state: TaskState, why: str = "") -> None:
        """A task goes on to another state."""
        self._change(msgspec.structs.replace(self._open[task_id], state=state, why=why))

    def note_status(self, robot: str, status: TaskStatus) -> TaskRecord | None:
        """What a robot says of a task; its word counts only for how the task ended.

        Returns:
            The record, if the robot's word has ended the task; stale epochs and other robots' tasks are ignored.

        """
        record = self._open.get(status.id)
        if record is None or record.robot != robot or record.epoch != status.epoch or not status.state.ended:
            return None
        self.move(status.id, status.state, status.why)
        return record

    def _change(self, record: TaskRecord) -> TaskRecord:
        record = msgspec.structs.replace(record, changed_ns=self._clock.now_ns())
        task_id = record.task.id
        if record.state.ended:
            self._open.pop(task_id, None)
            self._ended[task_id] = record
            self.done_count += record.state is TaskState.DONE
            while len(self._ended) > KEPT_ENDED:
                del self._ended[next(iter(self._ended))]
        else:
            self._open[task_id] = record
        self._tell(
            TaskEvent(task=record.task, state=record.state, robot=record.robot, epoch=record.epoch, why=record.why)
        )
        return record
