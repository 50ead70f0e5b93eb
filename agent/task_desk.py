"""The robot's side of a task: offers, fencing epochs, leases.

One task at a time. An offer with an older epoch than the last one accepted is refused, so that a coordinator that
was replaced cannot steer the robot; a task whose coordinator is silent for longer than the lease is let go.

One behavior drives at a time. A task that is accepted while another runs takes its place: the behavior of the old one
is told to let go, then the new one may begin (`may_begin`). What a behavior does of its own accord (it wanders, it goes
to charge) it says by `occupy`, and gives way as soon as `occupies` says no: to any task, or, while it is firm, to none.
"""

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec

from robrain.protocol.model.task import Recharge, TaskState
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.messages import TaskAnswer, TaskOffer, TaskStatus, TaskWithdrawal

Accept = Callable[[Any], TaskAnswer]
"""Takes a task of the kind that it was registered for."""
LetGo = Callable[[str], None]

RESULT_BYTES_MAX = 1024
"""A result travels with every state of the robot: pictures and lists go elsewhere, and their key comes here."""


class _Executor(NamedTuple):
    accept: Accept
    let_go: LetGo


class _Said(NamedTuple):
    task_id: str
    state: TaskState
    why: str
    result: dict[str, Any]


class _Own(NamedTuple):
    """What a behavior does of its own accord."""

    name: str
    firm: str


class TaskDesk:
    """Where offers arrive and the behavior that can do them is found."""

    def __init__(self) -> None:
        self._status: TaskStatus | None = None
        self._said: deque[_Said] = deque()
        self.coordinator_heard_ns: int | None = None
        self._epoch = 0
        self._lease_ns = 0
        self._executors: dict[type, _Executor] = {}
        self._current: _Executor | None = None
        self._begun = ""
        self._own: _Own | None = None
        self._recalled = ""
        self.on_said: Callable[[], None] | None = None
        """Called, on any thread, when a behavior has said how its task ended: `status` is about to change."""

    @property
    def status(self) -> TaskStatus | None:
        """How the last task stands; for the host's own thread, like everything here but `end`."""
        while self._said:
            self._end(*self._said.popleft())
        return self._status

    @property
    def is_busy(self) -> bool:
        """Whether a task runs; may be read on any thread."""
        status = self._status
        return status is not None and not status.state.ended

    def may_begin(self, task_id: str) -> bool:
        """Whether the behavior that accepted a task may move the robot: the one before has let go. On any thread."""
        return self._begun == task_id and self.is_busy

    def occupy(self, name: str, *, firm: str = "") -> bool:
        """A behavior wants to move the robot of its own accord; on any thread.

        Args:
            name: the plugin's.
            firm: if not empty, why offers are to be refused meanwhile, all but those to recharge.

        Returns:
            Whether it may: no task runs, and no other behavior is at something that is firm. What another does that
            is not firm ends with this.

        """
        own = self._own
        if self.is_busy or (own is not None and own.name != name and own.firm):
            return False
        self._own = _Own(name, firm)
        return True

    def occupies(self, name: str) -> bool:
        """Whether what a behavior said by `occupy` still holds; on any thread."""
        own = self._own
        return own is not None and own.name == name and not self.is_busy

    def vacate(self, name: str) -> None:
        """The behavior is done with what it did of its own accord; on any thread."""
        if self._own is not None and self._own.name == name:
            self._own = None

    def recall(self, why: str) -> None:
        """Have the running task end as failed: the robot cannot go on with it. On any thread; done at the next step."""
        self._recalled = why

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
        own = self._own
        if own is not None and own.firm and not isinstance(offer.task, Recharge):
            return TaskAnswer(accepted=False, why=own.firm)
        executor = self._executors.get(type(offer.task))
        if executor is None:
            return TaskAnswer(accepted=False, why=f"no behavior does {type(offer.task).__name__} tasks")
        before = (self.status, self._current)
        # Said before the behavior starts, for it may be done with the task before `accept` returns.
        self._status = TaskStatus(id=offer.task.id, epoch=offer.epoch, state=TaskState.RUNNING)
        self._current, self._begun = executor, ""
        try:
            answer = executor.accept(offer.task)
        except BaseException:
            self._go_back(*before)
            raise
        if answer.accepted:
            self._epoch = offer.epoch
            self._lease_ns = to_ns(offer.lease_s)
            self.coordinator_heard_ns = now_ns
            self._own = None
            self._recalled = ""
            if before[1] is not None and before[1] is not executor:
                before[1].let_go(f"{offer.task.id} has taken its place")
            self._begun = offer.task.id
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

    def end(self, task_id: str, state: TaskState, why: str = "", result: dict[str, Any] | None = None) -> None:
        """The behavior says, on whatever thread it runs, how its task ended and what came of it.

        Raises:
            ValueError: the result is no JSON, or more than 1024 bytes of it.

        """
        result = result or {}
        try:
            size = len(msgspec.json.encode(result))
        except (TypeError, msgspec.MsgspecError) as error:
            raise ValueError(f"expected a result of {task_id} that is JSON: {error}") from error
        if size > RESULT_BYTES_MAX:
            raise ValueError(f"expected a result of {task_id} of at most {RESULT_BYTES_MAX} bytes, got {size}")
        self._said.append(_Said(task_id, state, why, result))
        if self.on_said is not None:
            self.on_said()

    def halted(self) -> None:
        """The robot is halted: what it was at is given back; the behavior has forgotten it in `emergency_halt`."""
        self._own = None
        if self._current is not None and self.status is not None:
            self._end(self.status.id, TaskState.CANCELLED, "the robot is halted")

    def _end(self, task_id: str, state: TaskState, why: str, result: dict[str, Any] | None = None) -> None:
        status = self._status
        if status is not None and status.id == task_id and not status.state.ended:
            self._status = TaskStatus(id=task_id, epoch=status.epoch, state=state, why=why, result=result or {})
            self._current = None

    def check_lease(self, now_ns: int) -> None:
        """Let go of a task whose coordinator has been silent for longer than the lease, or that was recalled."""
        recalled, self._recalled = self._recalled, ""
        if recalled and self.is_busy:
            self._let_go(TaskState.FAILED, recalled)
        if self.status is None or self._current is None or self.coordinator_heard_ns is None:
            return
        if now_ns - self.coordinator_heard_ns > self._lease_ns:
            self._let_go(TaskState.CANCELLED, "the coordinator is silent, the lease ran out")

    def _go_back(self, status: TaskStatus | None, current: _Executor | None) -> None:
        self._status, self._current = status, current
        self._begun = status.id if status is not None else ""
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
