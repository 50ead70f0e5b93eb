"""The robot's side of a task: offers, fencing epochs, leases.

One task at a time. An offer with an older epoch than the last one accepted is refused, so that a coordinator that
was replaced cannot steer the robot; a task whose coordinator is silent for longer than the lease is let go.
"""

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from robrain.protocol.model.task import Task, TaskState
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.messages import TaskAnswer, TaskOffer, TaskStatus, TaskWithdrawal

Accept = Callable[[Task], TaskAnswer]
LetGo = Callable[[str], None]


class _Executor(NamedTuple):
    accept: Accept
    let_go: LetGo


class TaskDesk:
    """Where offers arrive and the behavior that can do them is found."""

    def __init__(self) -> None:
        self._status: TaskStatus | None = None
        self._said: deque[tuple[str, TaskState, str]] = deque()
        self.coordinator_heard_ns: int | None = None
        self._epoch = 0
        self._lease_ns = 0
        self._executors: dict[type, _Executor] = {}
        self._current: _Executor | None = None

    @property
    def status(self) -> TaskStatus | None:
        """How the last task stands; for the host's own thread, like everything here but `end`."""
        while self._said:
            self._end(*self._said.popleft())
        return self._status

    def register(self, kind: type, accept: Accept, let_go: LetGo) -> None:
        """A behavior says that it can do tasks of a kind.

        Args:
            kind: a member of the Task union.
            accept: called with an offered task; starts it, or refuses with why.
            let_go: called with the reason when the task is taken away.

        """
        self._executors[kind] = _Executor(accept, let_go)

    def unregister(self, kind: type) -> None:
        """The behavior goes; a task that it was at has failed."""
        self._executors.pop(kind, None)
        self._end_if_abandoned()

    def offer(self, offer: TaskOffer, now_ns: int) -> TaskAnswer:
        """Answer the coordinator's offer; the same offer twice is accepted twice and started once."""
        if offer.epoch < self._epoch:
            return TaskAnswer(accepted=False, why=f"epoch {offer.epoch} is older than {self._epoch}")
        status = self.status
        if status is not None and status.id == offer.task.id and status.epoch == offer.epoch:
            return TaskAnswer(accepted=True)
        executor = self._executors.get(type(offer.task))
        if executor is None:
            return TaskAnswer(accepted=False, why=f"no behavior does {type(offer.task).__name__} tasks")
        before = (self.status, self._current)
        # Said before the behavior starts, for it may be done with the task before `accept` returns.
        self._status = TaskStatus(id=offer.task.id, epoch=offer.epoch, state=TaskState.RUNNING)
        self._current = executor
        try:
            answer = executor.accept(offer.task)
        except BaseException:
            self._go_back(*before)
            raise
        if answer.accepted:
            self._epoch = offer.epoch
            self._lease_ns = to_ns(offer.lease_s)
            self.coordinator_heard_ns = now_ns
        else:
            self._go_back(*before)
        return answer

    def withdraw(self, withdrawal: TaskWithdrawal) -> TaskAnswer:
        """Answer the coordinator's wish to have a task back."""
        if withdrawal.epoch < self._epoch:
            return TaskAnswer(accepted=False, why=f"epoch {withdrawal.epoch} is older than {self._epoch}")
        if self.status is None or self.status.id != withdrawal.id or self.status.state.ended:
            return TaskAnswer(accepted=True, why="not running here")
        self._let_go(TaskState.CANCELLED, withdrawal.why or "withdrawn")
        return TaskAnswer(accepted=True)

    def end(self, task_id: str, state: TaskState, why: str = "") -> None:
        """The behavior says, on whatever thread it runs, how its task ended."""
        self._said.append((task_id, state, why))

    def halted(self) -> None:
        """The robot is halted: what it was at is given back; the behavior has forgotten it in `emergency_halt`."""
        if self._current is not None and self.status is not None:
            self._end(self.status.id, TaskState.CANCELLED, "the robot is halted")

    def _end(self, task_id: str, state: TaskState, why: str) -> None:
        status = self._status
        if status is not None and status.id == task_id and not status.state.ended:
            self._status = TaskStatus(id=task_id, epoch=status.epoch, state=state, why=why)
            self._current = None

    def check_lease(self, now_ns: int) -> None:
        """Let go of a task whose coordinator has been silent for longer than the lease."""
        if self.status is None or self._current is None or self.coordinator_heard_ns is None:
            return
        if now_ns - self.coordinator_heard_ns > self._lease_ns:
            self._let_go(TaskState.CANCELLED, "the coordinator is silent, the lease ran out")

    def _go_back(self, status: TaskStatus | None, current: _Executor | None) -> None:
        self._status, self._current = status, current
        self._end_if_abandoned()

    def _end_if_abandoned(self) -> None:
        there = any(executor is self._current for executor in self._executors.values())
        if self._current is not None and self.status is not None and not there:
            self._end(self.status.id, TaskState.FAILED, "the behavior that did it has gone")

    def _let_go(self, state: TaskState, why: str) -> None:
        status, executor = self.status, self._current
        if status is not None:
            self._end(status.id, state, why)
        if executor is not None:
            executor.let_go(why)
