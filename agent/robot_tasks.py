"""The robot's side of a task: offers, fencing epochs, leases.

One task at a time, and one more that is held: it is begun in the step in which the first has ended. An offer with an
older epoch than the last one accepted is refused, so that a coordinator that was replaced cannot steer the robot. A
task whose coordinator is silent for longer than the lease is released, and a held task is forgotten.

One behavior drives at a time. A task that is accepted while another runs replaces it. The old behavior is asked to
release its task, then the new one may begin (`may_begin`). A behavior reports its own activity (it wanders, it goes to
charge) by `occupy`. It yields as soon as `occupies` returns False: to any task, or, while it is firm, to none.
"""

from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import msgspec

from robrain.agent.errors import FOREIGN_ERRORS
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskCost, TaskOffer, TaskWithdrawal
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.energy_model import Work
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.stock_kinds import RECHARGE
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import (
    DoneJustNow,
    Interruption,
    NeedsEnergy,
    NoState,
    Occupied,
    OfferRefusal,
    OutOfService,
    PlainReason,
    plain,
    sentence_of,
)

FIRST_SUMMARIES = 2
"""Those of the first second of a coordinator."""

Accept = Callable[[Any], TaskAnswer]
"""Takes a task of the kind that it was registered for."""
LetGo = Callable[[str], None]
TaskWork = Callable[[Task], Work]
"""Work of a task at its place; the path to it is not counted."""

RESULT_BYTES_MAX, RESULT_FIELDS_MAX = 1024, 64
"""Results are part of every state message: publish pictures and lists on a separate key and put that key here."""

NS_PER_MS = 1_000_000
EPOCH_AHEAD_MAX = 24 * 3600 * 1000
"""Milliseconds. A coordinator starts its epochs at its clock's milliseconds and adds one per offer, so they stay behind
its clock. An epoch farther than this ahead of that clock is refused, because every later coordinator would seem out of
date (chosen)."""


DONE_REPORTED_S = 5.0
"""An offer of a task that the robot has done no longer ago was made before its report arrived (chosen)."""
DONE_KEPT = 8
"""Number of done tasks that are kept for it."""


class _Executor(NamedTuple):
    accept: Accept
    let_go: LetGo
    work: TaskWork


def work_at_place(task: Task) -> Work:
    """Standing at the place for the task's service time."""
    return Work(wait_s=task.service_s)


class _End(NamedTuple):
    task_id: str
    state: TaskState
    reason: str | Interruption
    result: dict[str, Any]


class TaskSituation(NamedTuple):
    """How the robot stands to its tasks."""

    task: TaskStatus | None
    """The last one that it began."""
    next_task: TaskStatus | None
    """The one that it holds."""
    before: TaskStatus | None
    """How the one before `task` ended."""


class _Held(NamedTuple):
    offer: TaskOffer
    status: TaskStatus
    since_ns: int


class _Own(NamedTuple):
    """An activity that a behavior began by itself."""

    name: str
    firm: str


class RobotTasks:
    """The tasks of one robot: answers offers, and finds the behavior that does them.

    Args:
        names: of the robot and its plugins, which tasks may need.

    """

    def __init__(self, names: Callable[[], Iterable[str]] = tuple) -> None:
        self._names = names
        self._status: TaskStatus | None = None
        self._before: TaskStatus | None = None
        self.held: _Held | None = None
        """The task that is begun after the running one."""
        self._foreseen: tuple[str, int] | None = None
        self._checked_ns: int | None = None
        self._done: deque[tuple[str, int]] = deque(maxlen=DONE_KEPT)
        """Tasks that were done, with the time."""
        self._ends: deque[_End] = deque()
        self.coordinator_seen_ns: int | None = None
        self.goes_on_ns = 0
        """A task continues without its coordinator for this long, if that is longer than the lease."""
        self.trusted_ns: int | None = None
        """Time when another participant last vouched for the robot's tasks, as a coordinator does by its messages."""
        self.coordinator_ahead_ns = 0
        """How far the coordinator's clock is ahead of the robot's; 0 unless they differ."""
        self.is_paused = False
        """Whether an operator has paused the robot: behaviors do not drive on."""
        self._epoch = 0
        self._lease_ns = 0
        self._executors: dict[str, _Executor] = {}
        self._current: _Executor | None = None
        self._begun = ""
        self._own: _Own | None = None
        self._recalled: NeedsEnergy | None = None
        self.on_line: Callable[[], None] | None = None
        """Called, on any thread, when a behavior has reported how its task ended: `status` is about to change."""

    @property
    def status(self) -> TaskStatus | None:
        """How the last task stands; for the host's own thread, like everything here but `end`."""
        while self._ends:
            self._end(*self._ends.popleft())
        return self._status

    @property
    def facts(self) -> TaskSituation:
        """How all tasks stand; for the host's own thread. A difference from the last is published at once."""
        return TaskSituation(self.status, self.held.status if self.held is not None else None, self._before)

    def differs_from(self, published: TaskSituation) -> bool:
        """Whether the state of any task differs from `published`, an earlier `facts`; as that, and faster."""
        if self._ends:
            return self.facts != published
        held = self.held.status if self.held is not None else None
        is_same = self._status is published.task and held is published.next_task and self._before is published.before
        return not is_same and self.facts != published

    def situation(self, now_ns: int) -> TaskSituation:
        """The same, with the expected end of the running task."""
        facts, foreseen = self.facts, self._foreseen
        status = facts.task
        if status is None or status.state.ended or foreseen is None or foreseen[0] != status.id:
            return facts
        remaining_s = round(max(0.0, to_seconds(foreseen[1] - now_ns)), 2)
        return facts._replace(task=msgspec.structs.replace(status, remaining_s=remaining_s))

    def renew_lease(self, summary: TeamState, robot: str, now_ns: int) -> None:
        """Renew the lease by the coordinator's summary: it counts from the state of this robot that arrived there last.

        A coordinator gives a silent robot's task to another, also when that robot receives it. One that has not
        received the robot yet counts from its own start, which its first summaries contain.
        """
        for mine in summary.robots:
            if mine.name == robot:
                self.is_paused = isinstance(mine.out, OutOfService) and mine.out.paused
                if not isinstance(mine.out, NoState):
                    self.coordinator_seen_ns = now_ns - to_ns(mine.age_s)
                elif summary.seq < FIRST_SUMMARIES:
                    self.coordinator_seen_ns = now_ns
                return
        self.coordinator_seen_ns = now_ns

    def foresee(self, task_id: str, end_ns: int | None) -> None:
        """A behavior reports when its task will end, by its estimate, if it has one; on any thread."""
        self._foreseen = None if end_ns is None else (task_id, end_ns)

    def carry(self, task_id: str) -> None:
        """A behavior reports that the robot has taken an item of its task on board."""
        if self._status is not None and self._status.id == task_id:
            self._status = msgspec.structs.replace(self._status, carries=True)

    @property
    def is_busy(self) -> bool:
        """Whether a task runs; may be read on any thread."""
        status = self._status
        return status is not None and not status.state.ended

    def may_begin(self, task_id: str) -> bool:
        """Whether the behavior of a task may move the robot: the one before has released it. On any thread."""
        return self._begun == task_id and self.is_busy

    def occupy(self, name: str, *, firm: str = "") -> bool:
        """A behavior wants to move the robot by itself; on any thread.

        Args:
            name: the plugin's name.
            firm: if not empty, the reason to refuse all offers meanwhile, except those to recharge.

        Returns:
            Whether it may: no task runs, and no other behavior is at something that is firm. An activity of another
            behavior that is not firm ends with this.

        """
        own = self._own
        if self.is_busy or (own is not None and own.name != name and own.firm):
            return False
        self._own = _Own(name, firm)
        return True

    def occupies(self, name: str) -> bool:
        """Whether a behavior's report by `occupy` still holds; on any thread."""
        own = self._own
        return own is not None and own.name == name and not self.is_busy

    def vacate(self, name: str) -> None:
        """The behavior has ended its own activity; on any thread."""
        if self._own is not None and self._own.name == name:
            self._own = None

    def recall(self, reason: NeedsEnergy) -> None:
        """Have the robot return its task: it has to charge. On any thread; done at the next step."""
        self._recalled = reason

    def register(self, kind: str, accept: Accept, let_go: LetGo, work: TaskWork = work_at_place) -> None:
        """A behavior registers a kind of tasks that it can do.

        Args:
            kind: as it stands in `Task.kind`.
            accept: called with an offered task; starts it, or refuses with why.
            let_go: called with the reason when the task is taken away.
            work: estimates the work of a task, also of tasks that the robot is never offered.

        """
        self._executors[kind] = _Executor(accept, let_go, work)

    def unregister(self, kind: str) -> None:
        """The behavior goes; a task that it was at has failed."""
        self._executors.pop(kind, None)
        self._end_if_abandoned()

    def cost(self, task: Task) -> TaskCost:
        """Work of a task at its place, by the behavior of its kind; `why` if that is unknown."""
        executor = self._executors.get(task.kind)
        if executor is None:
            return TaskCost(id=task.id, why=sentence_of(_no_behavior(task.kind)))
        try:
            work = executor.work(task)
            sent = (name for name in Work.__struct_fields__ if name in TaskCost.__struct_fields__)
            fields = {name: getattr(work, name) for name in sent}
            return msgspec.convert({"id": task.id, **fields}, TaskCost)
        except FOREIGN_ERRORS as error:  # foreign plugin code
            return TaskCost(id=task.id, why=cut(str(error)))

    def offer(self, offer: TaskOffer, now_ns: int) -> TaskAnswer:
        """Answer the coordinator's offer; the same offer twice is accepted twice and started once.

        One that is for after the running task is held; it replaces another that was held. Where that task has just
        ended by itself, it is begun.
        """
        if self.coordinator_ahead_ns:
            offer = msgspec.structs.replace(offer, task=offer.task.moved_in_time(-self.coordinator_ahead_ns))
        held, status = self.held, self.status
        newest = max(self._epoch, held.offer.epoch if held is not None else 0)
        if offer.epoch < newest:
            return _too_old(offer.epoch, newest)
        if offer.epoch > (now_ns + self.coordinator_ahead_ns) // NS_PER_MS + EPOCH_AHEAD_MAX:
            text = f"epoch {offer.epoch} is more than a day ahead of the robot's clock"
            return TaskAnswer.refused(plain("epoch_ahead", text, epoch=offer.epoch))
        for known in (status, held.status if held is not None else None):
            if known is not None and (known.id, known.epoch) == (offer.task.id, offer.epoch):
                return TaskAnswer(accepted=True)
        if any(done == offer.task.id and now_ns - done_ns <= to_ns(DONE_REPORTED_S) for done, done_ns in self._done):
            return TaskAnswer.refused(DoneJustNow())
        if not offer.after:
            return self._begin_as_asked(offer, now_ns)
        if status is None or status.id != offer.after or status.state is TaskState.CANCELLED:
            return TaskAnswer.refused(plain("not_at_task", f"is not at {offer.after}", task=offer.after))
        if status.state.ended:
            return self._begin_as_asked(offer, now_ns)
        reason = self._refusal(offer)
        if reason is not None:
            return TaskAnswer.refused(reason)
        waiting = TaskStatus(id=offer.task.id, epoch=offer.epoch, state=TaskState.OFFERED)
        self.held = _Held(offer, waiting, now_ns)
        self.coordinator_seen_ns = now_ns
        return TaskAnswer(accepted=True)

    def has_behavior(self, kind: str) -> bool:
        """Whether there is a behavior for a kind of task."""
        return kind in self._executors

    def can(self, task: Task) -> bool:
        """Whether the robot has the behavior and all plugins that a task needs, and is the robot that it names."""
        return self.has_behavior(task.kind) and set(task.needs) <= {*self._executors, *self._names()}

    def work_of(self, task: Task) -> Work:
        """Work of a task at its place, from its kind's behavior; if this fails, the work of a stay at the place."""
        try:
            return self._executors[task.kind].work(task)
        except FOREIGN_ERRORS:  # foreign plugin code
            return work_at_place(task)

    def begin_for_team(self, task: Task) -> TaskAnswer:
        """Begin a task that the robots gave each other, with the epoch of the last one accepted.

        So every offer or withdrawal of a coordinator that returns is newer.
        """
        return self._begin_or_refuse(TaskOffer(task=task, epoch=self._epoch, lease_s=0.0))

    def cancel_for_team(self, task_id: str, reason: str) -> None:
        """End the running task, or forget the held one, if it has this id: it was cancelled without a coordinator."""
        if self.held is not None and self.held.offer.task.id == task_id:
            self.held = None
        if self.is_busy and self.status is not None and self.status.id == task_id:
            self._let_go(TaskState.CANCELLED, reason)

    def go_on(self, now_ns: int) -> bool:
        """Begin the held task if the task before it has ended; whether it was begun."""
        held, ended = self.held, self.status
        if held is None or (ended is not None and not ended.state.ended):
            return False
        self.held = None
        answer = self._begin_or_refuse(held.offer)  # does not renew the lease: no message has arrived
        if not answer.accepted:
            self._before = ended
            self._status = msgspec.structs.replace(
                held.status, state=TaskState.CANCELLED, why=answer.why, reason=answer.reason
            )
        return answer.accepted

    def _refusal(self, offer: TaskOffer) -> OfferRefusal | None:
        own = self._own
        if own is not None and own.firm and offer.task.kind != RECHARGE:
            return Occupied(own.name, own.firm)
        return None if offer.task.kind in self._executors else _no_behavior(offer.task.kind)

    def _begin_as_asked(self, offer: TaskOffer, now_ns: int) -> TaskAnswer:
        answer = self._begin(offer)
        if answer.accepted:
            self.coordinator_seen_ns = now_ns
        return answer

    def _begin_or_refuse(self, offer: TaskOffer) -> TaskAnswer:
        try:
            return self._begin(offer)
        except FOREIGN_ERRORS as error:  # foreign plugin code
            return TaskAnswer.refused(PlainReason(cut(str(error))))

    def _begin(self, offer: TaskOffer) -> TaskAnswer:
        reason = self._refusal(offer)
        if reason is not None:
            return TaskAnswer.refused(reason)
        executor = self._executors[offer.task.kind]
        lease_ns = to_ns(offer.lease_s)  # before any change below, as it may raise
        before = (self.status, self._current)
        # Set before the behavior starts, which may finish the task before `accept` returns.
        self._status = TaskStatus(id=offer.task.id, epoch=offer.epoch, state=TaskState.RUNNING)
        self._current, self._begun, self._foreseen = executor, "", None
        try:
            answer = executor.accept(offer.task)
        except BaseException:
            self._go_back(*before)
            raise
        if not answer.accepted:
            self._go_back(*before)
            return msgspec.structs.replace(answer, why=cut(answer.why))
        self._before = before[0] if before[0] is not None and before[0].state.ended else None
        self.held = None
        self._epoch = offer.epoch
        self._lease_ns = lease_ns
        self._own = None
        self._recalled = None
        if before[1] is not None and before[1] is not executor:
            before[1].let_go(f"{offer.task.id} has taken its place")
        self._begun = offer.task.id
        return answer

    def withdraw(self, withdrawal: TaskWithdrawal) -> TaskAnswer:
        """Answer the coordinator's wish to have a task back. If the running task is withdrawn, the held one begins."""
        held = self.held
        is_held = held is not None and held.offer.task.id == withdrawal.id
        newest = held.offer.epoch if held is not None and is_held else self._epoch
        if withdrawal.epoch < newest:
            return _too_old(withdrawal.epoch, newest)
        if is_held:
            self.held = None
            return TaskAnswer(accepted=True)
        if self.status is None or self.status.id != withdrawal.id or self.status.state.ended:
            return TaskAnswer(accepted=True, why="not running here")
        self._let_go(TaskState.CANCELLED, withdrawal.why or "withdrawn")
        return TaskAnswer(accepted=True)

    def end(
        self, task_id: str, state: TaskState, reason: str | Interruption = "", result: dict[str, Any] | None = None
    ) -> None:
        """The behavior reports, on any thread, how its task ended and its result.

        Raises:
            ValueError: the result is no JSON, or more than 1024 bytes of it.

        """
        result = result or {}
        try:
            size = len(msgspec.json.encode(result))
        except (TypeError, msgspec.MsgspecError) as error:
            raise ValueError(f"result of {task_id}: expected JSON; {error}") from error
        if size > RESULT_BYTES_MAX:
            raise ValueError(f"result of {task_id}: expected at most {RESULT_BYTES_MAX} bytes, got {size}")
        if len(result) > RESULT_FIELDS_MAX:
            raise ValueError(f"result of {task_id}: expected at most {RESULT_FIELDS_MAX} fields, got {len(result)}")
        self._ends.append(_End(task_id, state, reason, result))
        if self.on_line is not None:
            self.on_line()

    def halted(self) -> None:
        """The robot is halted: return its task; the behavior has dropped it in `emergency_halt`."""
        self._own = self.held = None
        if self._current is not None and self.status is not None:
            self._end(self.status.id, TaskState.CANCELLED, "the robot is halted")

    def _end(
        self, task_id: str, state: TaskState, reason: str | Interruption, result: dict[str, Any] | None = None
    ) -> None:
        status = self._status
        if status is not None and status.id == task_id and not status.state.ended:
            if state is TaskState.DONE:
                self._done.append((task_id, self._checked_ns or 0))
            ended = msgspec.structs.replace(status, state=state, why=cut(str(reason)), result=result or {})
            self._status = msgspec.structs.replace(ended, reason=reason if isinstance(reason, Interruption) else None)
            self._current = None

    def check_lease(self, now_ns: int) -> None:
        """Release a task whose coordinator has been silent for longer than the lease, or that was recalled.

        The held task is forgotten then, and also after a pause of the robot's own process that exceeds the lease.
        Another robot may have received the task.
        """
        checked_ns, self._checked_ns = self._checked_ns, now_ns
        recalled, self._recalled = self._recalled, None
        held = self.held
        received_ns = self.coordinator_seen_ns if self.trusted_ns is None else self._vouched_ns
        if held is not None:
            since_ns = max(held.since_ns, now_ns if checked_ns is None else checked_ns)
            silent_ns = now_ns - (received_ns if received_ns is not None else held.since_ns)
            lease_ns = to_ns(held.offer.lease_s)
            if recalled or silent_ns > max(lease_ns, self.goes_on_ns) or now_ns - since_ns > lease_ns:
                self.held = None
        if recalled and self.is_busy:
            self._let_go(TaskState.CANCELLED, recalled)
        if self._current is None or received_ns is None or (self.status if self._ends else self._status) is None:
            return
        if now_ns - received_ns > max(self._lease_ns, self.goes_on_ns):
            self._let_go(TaskState.CANCELLED, "the coordinator is silent, the lease ran out")

    @property
    def _vouched_ns(self) -> int | None:
        """Time of the coordinator's last message, or when another vouched for the robot's tasks; None if never."""
        received_ns, trusted_ns = self.coordinator_seen_ns, self.trusted_ns
        return received_ns if trusted_ns is None else max(trusted_ns, received_ns or 0)

    def _go_back(self, status: TaskStatus | None, current: _Executor | None) -> None:
        self._status, self._current = status, current
        self._begun = status.id if status is not None else ""
        self._end_if_abandoned()

    def _end_if_abandoned(self) -> None:
        there = any(executor is self._current for executor in self._executors.values())
        if self._current is not None and self.status is not None and not there:
            self._end(self.status.id, TaskState.FAILED, "the behavior that did it has gone")

    def _let_go(self, state: TaskState, reason: str | Interruption) -> None:
        status, executor = self.status, self._current
        if status is not None:
            self._end(status.id, state, reason)
        if executor is not None:
            executor.let_go(str(reason))


def _too_old(epoch: int, newest: int) -> TaskAnswer:
    reason = plain("epoch_old", f"epoch {epoch} is older than {newest}", epoch=epoch, newest=newest)
    return TaskAnswer.refused(reason, newest)


def _no_behavior(kind: str) -> PlainReason:
    return plain("no_behavior", f"no behavior does {kind} tasks", kind=kind)
