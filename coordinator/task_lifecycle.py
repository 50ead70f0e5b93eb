"""The life of tasks: from the book to the robots and back, so that each comes to an end and none is done twice.

Hear what the robots say of their tasks; find what silence, restarts, deadlines and dependencies make of them; offer
what is ready to whoever is idle; have withdrawn what is done by a robot that should not.
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import msgspec

from robrain.coordinator.admission import why_dependency_ended
from robrain.coordinator.capabilities import Capabilities
from robrain.coordinator.dispatch import dispatch, verdicts
from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.motes import MEMBER_PREFIX
from robrain.coordinator.reconcile import LEASE_S, reconcile, stray
from robrain.coordinator.roster import Robot, Roster
from robrain.coordinator.shunning import Shunning
from robrain.coordinator.task_book import TaskBook
from robrain.coordinator.task_reasons import TaskReasons
from robrain.protocol.model.task import TaskState
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.wire.messages import TaskAnswer, TaskOffer, TaskStatus, TaskWithdrawal
from robrain.protocol.wire.task_messages import TaskRecord
from robrain.protocol.wire.topics import ROBOT_OFFER, ROBOT_WITHDRAW

logger = logging.getLogger(__name__)

ASK_TIMEOUT_S = 0.5
"""A robot that does not answer holds the coordinator up for so long, once: it must be well below the lease."""
WITHDRAW_AGAIN_NS = to_ns(0.5)
COMPLAIN_AGAIN_NS = to_ns(10.0)


class TaskLifecycle:
    """Moves tasks through their states.

    Args:
        wire: the coordinator's place on the wire.
        book: of its tasks.
        roster: the robots that there are.
        capabilities: what they can do.

    """

    def __init__(self, wire: Endpoint, book: TaskBook, roster: Roster, capabilities: Capabilities) -> None:
        self._wire = wire
        self._book = book
        self._roster = roster
        self._since_ns = wire.clock.now_ns()
        self.shunning = self._shunning = Shunning()
        self.reasons = TaskReasons(book, roster, capabilities, self._shunning)
        self._withdrawn_ns: dict[tuple[str, str, int], int] = {}
        self._complained_ns: int | None = None
        self._settled_version = -1

    # -- hearing --------------------------------------------------------------------------------------------

    def hear(self, robot: str, status: TaskStatus, now_ns: int) -> TaskRecord | None:
        """A robot says how its last task stands; the record as it was, if the robot's word has changed it."""
        record = None
        with self.as_far_as_written(now_ns):
            record = self._book.note_status(robot, status)
        if record is not None and status.state is TaskState.FAILED:
            self._shunning.note(record.task.id, robot, f"failed: {status.why}", now_ns)
        return record

    # -- deciding -------------------------------------------------------------------------------------------

    def settle(self, now_ns: int) -> bool:
        """Whatever follows from silence, restarts, the time and other tasks; True if a task or robot has come free."""
        freed = False
        version, self._settled_version = self._settled_version, self._book.version
        others_changed = version != self._book.version
        with self.as_far_as_written(now_ns):
            for record in self._book.open:
                task_id = record.task.id
                if record.robot.startswith(MEMBER_PREFIX):
                    continue  # the desk of the motes follows it
                if record.robot:
                    move = reconcile(record, self._roster.robots.get(record.robot), now_ns, self._since_ns)
                    if move is not None and move.state is TaskState.QUEUED:
                        self._book.give_back(task_id, move.why)
                        freed = True
                    elif move is not None:
                        self._book.move(task_id, move.state, move.why)
                elif end := self._why_over(record, now_ns, others_changed=others_changed):
                    self._book.move(task_id, *end)
        return freed

    def _why_over(self, record: TaskRecord, now_ns: int, *, others_changed: bool) -> tuple[TaskState, str] | None:
        task = record.task
        if record.own:  # it is offered in the step that makes it, or never
            return TaskState.CANCELLED, record.why or "it was offered to nobody"
        if task.deadline_ns is not None and now_ns > task.deadline_ns:
            why = f"its deadline has passed{f'; {record.why}' if record.why else ''}"
            return TaskState.FAILED, why
        if not others_changed or not task.after:
            return None
        others = {name: found for name in task.after if (found := self._book.find(name)) is not None}
        why = why_dependency_ended(task, others)
        return (TaskState.CANCELLED, why) if why else None

    def dispatch(self, idle: list[Robot], now_ns: int) -> None:
        """Offer ready tasks to robots.

        Args:
            idle: those that can be counted on and have no task.
            now_ns: the time.

        """
        reasons = self.reasons
        ready = [record for record in self._book.open if not reasons.waits(record, now_ns)]
        if not ready:
            return
        robots = [self._roster.robots[name] for name in sorted(self._roster.robots)]

        def why_not(record: TaskRecord, robot: Robot) -> str:
            return reasons.not_for(record, robot, now_ns)

        with self.as_far_as_written(now_ns):
            self._tell_nobody_can(ready)
            by_id = {record.task.id: record for record in ready}
            for task_id, robot in dispatch(ready, idle, why_not):
                reasons.note(task_id, verdicts(by_id[task_id], robots, why_not, robot), now_ns)
                self.offer(task_id, robot, now_ns)
                offered = self._book.find(task_id)
                if offered is not None and offered.state is TaskState.OFFERED:
                    break  # no answer in time: the others are not kept waiting for more of that

    def tell_nobody_can(self, now_ns: int) -> None:
        """Tell of ready tasks that no robot of the team has what they take."""
        with self.as_far_as_written(now_ns):
            self._tell_nobody_can([record for record in self._book.open if not self.reasons.waits(record, now_ns)])

    def _tell_nobody_can(self, ready: list[TaskRecord]) -> None:
        for record in ready:
            why = self.reasons.nobody_can(record)
            if why and why != record.why:  # told once, and as often as it changes
                self._book.move(record.task.id, TaskState.QUEUED, why)

    def note_decision(self, task_id: str, robots: Sequence[str], now_ns: int) -> None:
        """A task is about to be offered to robots: how each robot stands to it is kept for those who ask."""
        record = self._book.find(task_id)
        if record is not None:
            self.reasons.note(task_id, self.reasons.judge(record, now_ns, robots), now_ns)

    def offer(self, task_id: str, robot: str, now_ns: int) -> TaskAnswer:
        """Offer a queued task to a robot. Refused, it is queued again, or ends if it is the coordinator's own.

        Raises:
            JournalUnwritable: a step of it is not in the journal; what the robot says later counts.

        """
        record = self._book.offered(task_id, robot)
        offer = TaskOffer(task=record.task, epoch=record.epoch, lease_s=LEASE_S)
        try:
            reply = self._wire.ask(ROBOT_OFFER, offer, robot=robot, timeout_s=ASK_TIMEOUT_S)
            answer = msgspec.json.decode(reply, type=TaskAnswer)
        except CallError as error:
            if error.code is ErrorCode.TIMEOUT:
                # It may have taken it all the same: its next state will tell, or the lease runs out.
                return TaskAnswer(accepted=True, why="no answer in time")
            answer = TaskAnswer(accepted=False, why=str(error))
        except (NobodyThere, msgspec.DecodeError) as error:
            answer = TaskAnswer(accepted=False, why=str(error))
        if answer.accepted:
            self._book.move(task_id, TaskState.RUNNING)
        else:
            self._shunning.note(task_id, robot, f"refused: {answer.why}", now_ns)
            record = self._book.give_back(task_id, f"{robot} refused: {answer.why}")
            if not record.state.ended and (words := self.reasons.hopeless(record, now_ns)):
                self._book.move(task_id, TaskState.FAILED, f"nobody does it: {words}")
        return answer

    def withdraw_strays(self, now_ns: int) -> None:
        """Tell robots that are at a task which the book has closed, or given to another, to stop."""
        bound = {record.robot: record for record in self._book.open if record.robot}
        for robot in self._roster.up(now_ns):
            status = stray(robot, bound.get(robot.name))
            if status is None:
                continue
            told = (robot.name, status.id, status.epoch)
            if now_ns - self._withdrawn_ns.get(told, -WITHDRAW_AGAIN_NS) < WITHDRAW_AGAIN_NS:
                continue
            self._withdrawn_ns = {key: at for key, at in self._withdrawn_ns.items() if now_ns - at < WITHDRAW_AGAIN_NS}
            self._withdrawn_ns[told] = now_ns
            self._withdraw(robot.name, status)

    def _withdraw(self, robot: str, status: TaskStatus) -> None:
        record = self._book.find(status.id)
        if record is None:
            why = "the coordinator knows nothing of it"
        elif record.state is TaskState.CANCELLED:
            why = record.why
        else:
            why = f"it was given to others: it is {record.state}{f' at {record.robot}' if record.robot else ''}"
        try:
            withdrawal = TaskWithdrawal(id=status.id, epoch=status.epoch, why=why)
            self._wire.ask(ROBOT_WITHDRAW, withdrawal, robot=robot, timeout_s=ASK_TIMEOUT_S)
        except (CallError, NobodyThere) as error:
            logger.debug("%s: task %s could not be withdrawn: %s", robot, status.id, error)

    # -- the journal ----------------------------------------------------------------------------------------

    @contextmanager
    def as_far_as_written(self, now_ns: int) -> Iterator[None]:
        """What the journal does not take is not done; the team keeps running, and it is tried again."""
        try:
            yield
        except JournalUnwritable as error:
            if self._complained_ns is None or now_ns - self._complained_ns > COMPLAIN_AGAIN_NS:
                self._complained_ns = now_ns
                logger.error("%s; no task changes until it can be", error)  # noqa: TRY400 - the words say it all
