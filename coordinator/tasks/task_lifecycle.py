"""The lifecycle of tasks, from the book to the robots and back: each task ends, and none is done twice.

Offers do not wait for their answers, so a stopped robot or a broken link delays no other robot. In lockstep the answer
arrives at once. At most two offers and one withdrawal per robot are in flight within the time limit.

It processes the robots' reports and applies silence, restarts, deadlines and dependencies. It offers ready tasks to
idle robots, and withdraws tasks from robots that should not do them.
"""

import logging
from contextlib import AbstractContextManager
from operator import attrgetter
from typing import Any, NamedTuple

import msgspec

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.tasks.admission import dependency_refusal, reason_of
from robrain.coordinator.tasks.eligibility import Eligibility, TaskGate, TaskPauses
from robrain.coordinator.tasks.reconcile import reconcile, strays
from robrain.coordinator.tasks.task_book import NS_PER_MS, OUTBID_MAX, TaskBook
from robrain.coordinator.team.capabilities import Capabilities
from robrain.coordinator.team.roster import Robot, Roster
from robrain.coordinator.team.team_map import TeamMap
from robrain.protocol.answers.later import Later
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.messages.robots.robot_messages import BatteryState, TaskStatus
from robrain.protocol.messages.tasks.offer_messages import (
    ROBOT_OFFER,
    ROBOT_WITHDRAW,
    TaskAnswer,
    TaskOffer,
    TaskWithdrawal,
)
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.stock_kinds import RECHARGE
from robrain.protocol.model.tasks.task import LEASE_S, MEMBER_PREFIX, NEEDS_MAX, TaskState
from robrain.protocol.reasons import (
    DeadlinePassed,
    IsNext,
    LeaseRanOut,
    OfferRefusal,
    OutOfReach,
    PlainReason,
    Refused,
    RobotOut,
    Shut,
    TaskReason,
    plain,
)
from robrain.protocol.refusals import RefusalCode
from robrain.protocol.wire.endpoint import Endpoint

logger = logging.getLogger(__name__)

WITHDRAW_AGAIN_NS = to_ns(0.5)
COMPLAIN_AGAIN_NS = to_ns(10.0)
LOSSES_KEPT = 256
ASK_TIMEOUT_S = 0.5
"""Time limit for an answer, well below the lease; after that, only the robot's state counts."""


class Answered(NamedTuple):
    """A robot's answer to an offer."""

    record: TaskRecord
    """The record at the time of the offer."""
    after: str
    answer: TaskAnswer
    is_reached: bool = True
    """False if no queryable answered: a robot that reconnects may send states before it can be queried."""


class _PendingOffer(NamedTuple):
    record: TaskRecord
    after: str
    reply: Later[Any]


class _Withdrawn(NamedTuple):
    robot: str
    task: str
    reply: Later[Any]


class Offers:
    """Sends offers and withdrawals.

    Args:
        wire: the coordinator's Zenoh endpoint.

    """

    def __init__(self, wire: Endpoint) -> None:
        self._wire = wire
        self._asked: list[_PendingOffer] = []
        self._withdrawn: list[_Withdrawn] = []

    def offer(self, record: TaskRecord, after: str) -> None:
        """Offer a record's task to its robot, to begin now or after its running task `after`."""
        offer = TaskOffer(task=record.task, epoch=record.epoch, lease_s=LEASE_S, after=after)
        reply = self._wire.ask_later(ROBOT_OFFER, offer, robot=record.robot, timeout_s=ASK_TIMEOUT_S)
        self._asked.append(_PendingOffer(record, after, reply))

    def withdraw(self, robot: str, withdrawal: TaskWithdrawal) -> None:
        """Ask a robot to withdraw from a task. The robot's state reports the result."""
        reply = self._wire.ask_later(ROBOT_WITHDRAW, withdrawal, robot=robot, timeout_s=ASK_TIMEOUT_S)
        self._withdrawn.append(_Withdrawn(robot, withdrawal.id, reply))

    @property
    def is_waiting(self) -> bool:
        """Whether an answer is still to come or to be taken."""
        return bool(self._asked or self._withdrawn)

    def answered(self) -> list[Answered]:
        """Return the answers since the last call, in the order of the offers."""
        self._withdrawn = [one for one in self._withdrawn if not _is_over(one)]
        asked, self._asked = self._asked, []
        found = []
        for one in asked:
            try:
                answer = one.reply.poll()
                if answer is None:
                    self._asked.append(one)
                    continue
            except CallError as error:
                if error.code is ErrorCode.TIMEOUT:
                    continue  # it may have accepted: its next state or the lease decides
                answer = TaskAnswer(accepted=False, why=str(error))
            except NobodyThere as error:
                found.append(Answered(one.record, one.after, TaskAnswer(accepted=False, why=str(error)), False))
                continue
            found.append(Answered(one.record, one.after, answer))
        return found


def _is_over(one: _Withdrawn) -> bool:
    try:
        return one.reply.poll() is not None
    except (CallError, NobodyThere) as error:
        logger.debug("%s: task %s could not be withdrawn: %s", one.robot, one.task, error)
        return True


class TaskLifecycle:
    """Moves tasks through their states.

    Args:
        wire: the coordinator's Zenoh endpoint.
        book: of its tasks.
        roster: the robots of the team.
        capabilities: plugins and kinds of task of the robots.
        gate: the parts of the coordinator.
        team_map: with the zones that hold.

    """

    def __init__(
        self,
        wire: Endpoint,
        book: TaskBook,
        roster: Roster,
        capabilities: Capabilities,
        gate: TaskGate,
        team_map: TeamMap,
    ) -> None:
        self.wire, self.book, self.roster, self.capabilities = wire, book, roster, capabilities
        self.backoff = TaskPauses()
        self.eligibility = Eligibility(book, roster, capabilities, self.backoff, gate, team_map)
        self._offers = Offers(wire)
        self._ahead: dict[str, tuple[str, str]] = {}
        """For each robot, the running task after which it was last offered another, and that one."""
        self._since_ns = self._begun_ns = wire.clock.now_ns()
        self._refusals = wire.refusals
        self._guard = RecordGuard(wire.refusals, (JournalUnwritable,))
        self.gate, self.team_map = gate, team_map
        self._withdrawn_ns: dict[tuple[str, str, int], int] = {}
        self._written = _AsFarAsWritten()
        self._settled_version = -1
        self._unheard: dict[str, tuple[str, Point2D]] = {}
        """Robots whose task was given back because they were silent: the task, and their places."""
        self._losses: dict[str, dict[str, Point2D]] = {}
        """For each task, the robots that released it out of contact, and their last known places."""

    def restart_silence(self, now_ns: int) -> None:
        """The coordinator itself was paused: it waits for its robots' messages again."""
        self._since_ns = now_ns

    # -- receiving --------------------------------------------------------------------------------------------

    def receive(self, robot: str, status: TaskStatus, now_ns: int) -> TaskRecord | None:
        """Process a robot's report on its last task; returns the record before the change, None if nothing changed."""
        try:
            if status.carries:
                self._bind_carrier(robot, status.id)
            record = self.book.record_status(robot, status)
        except JournalUnwritable as error:
            self._written.report(error, now_ns)
            return None
        if record is not None and status.state is TaskState.FAILED:
            self.backoff.record(record.task.id, robot, plain("failed", f"failed: {cut(status.why)}"), now_ns)
        elif record is not None and status.state is TaskState.CANCELLED and (status.reason or self._was_held(record)):
            # It was refused when it was to begin, a door does not open, or the robot has to charge.
            self._avoid_refuser(status.id, robot, status.reason or PlainReason(cut(status.why)), now_ns)
        return record

    def _bind_carrier(self, robot: str, task_id: str) -> None:
        """Name the robot that has an item of a task on board in the task's needs."""
        record = self.book.find(task_id)
        if record is not None and record.robot == robot and not record.recalled and robot not in record.task.needs:
            task = msgspec.structs.replace(record.task, needs=(robot, *record.task.needs)[:NEEDS_MAX])
            self.book.update(task, plain("carries", f"{robot} has an item of it on board", robot=robot), recalls=False)

    def _was_held(self, record: TaskRecord) -> bool:
        if record.recalled:
            return False
        return record.state is TaskState.OFFERED and self._ahead.get(record.robot, ("", ""))[1] == record.task.id

    def process_answers(self, now_ns: int) -> bool:
        """Process the answers to offers; True if one was refused."""
        if not self._offers.is_waiting:
            return False
        refused = False

        def handle(answered: Answered) -> None:
            nonlocal refused
            with self.as_far_as_written(now_ns):
                refused |= self._handle_answer(answered, now_ns)

        self._guard.records(self._offers.answered(), handle, attrgetter("record.task.id"), "answer")
        return refused

    def _handle_answer(self, answered: Answered, now_ns: int) -> bool:
        offered, after, answer, is_reached = answered
        task_id, robot = offered.task.id, offered.robot
        record = self.book.find(task_id)
        if record is None or record.state is not TaskState.OFFERED or record.epoch != offered.epoch:
            return False  # the robot's state arrived first, or it was cancelled
        pauses = self.backoff.robots
        if answer.accepted:
            pauses.accepted(robot)
            if not after:  # a held task stays offered until the robot reports that it has begun it
                self._end_replaced(robot, task_id)
                self.book.move(task_id, TaskState.RUNNING)
            return False
        if not is_reached:
            unreachable = plain("unreachable", f"could not be asked: {cut(answer.why)}")
            pauses.unreached(robot, unreachable, now_ns)
            self.book.give_back(task_id, RobotOut(robot, unreachable))
            return True
        refusal = answer.reason or PlainReason(cut(answer.why))
        self.book.give_back(task_id, RobotOut(robot, Refused(refusal)))
        if isinstance(answer.epoch, int) and self._catch_up(robot, answer.epoch, now_ns):
            return True  # the epoch was refused, not the task
        pauses.answered(robot)
        if record.own:
            pauses.refused(robot, refusal, now_ns)
        if not after:  # tasks refused for the present are offered again when the robot is free
            self._avoid_refuser(task_id, robot, refusal, now_ns)
        if record.own:
            self.gate.task_refused(record, robot, refusal, now_ns)
        return True

    def _end_replaced(self, robot: str, task_id: str) -> None:
        """End the coordinator's own task that a robot was at when it accepted another in its place."""
        for record in self.book.bound_to(robot):
            if record.own and record.task.id != task_id:
                replaced = plain("replaced", f"its robot was sent on to {task_id} instead", by=task_id)
                self.book.move(record.task.id, TaskState.CANCELLED, replaced)

    def _catch_up(self, robot: str, epoch: int, now_ns: int) -> bool:
        """Handle a robot that has accepted an epoch greater than this coordinator's; True if it is now outbid.

        No coordinator starts with an epoch ahead of the clock: such an epoch is forged or comes from a wrong clock, and
        is outbid. Any other comes from a coordinator that started later, which this one must not work against.
        """
        ahead_ms = epoch - now_ns // NS_PER_MS
        outbids = 0 < ahead_ms <= OUTBID_MAX
        if outbids:
            self.book.outbid(epoch)
            text = f"it accepted epoch {epoch}, ahead of the clock, from another sender; greater ones are used now"
        elif ahead_ms > 0:
            text = f"it reports epoch {epoch}, which no robot accepts"
        else:
            text = f"it accepted epoch {epoch} from another coordinator; if there is none, restart this one"
        self._refusals.record(ROBOT_OFFER.name, robot, RefusalCode.OLD_EPOCH, text)
        return outbids

    def _avoid_refuser(self, task_id: str, robot: str, refusal: OfferRefusal, now_ns: int) -> None:
        self.backoff.record(task_id, robot, Refused(refusal), now_ns, self._chargeable(robot))
        record = self.book.find(task_id)
        if record is not None and not record.state.ended and (hopeless := self.eligibility.hopeless(record, now_ns)):
            self.book.move(task_id, TaskState.FAILED, hopeless)

    def _chargeable(self, robot: str) -> BatteryState | None:
        """The battery of a robot that can go to charge."""
        known = self.roster.robots.get(robot)
        if known is None or known.state is None or RECHARGE not in (self.capabilities.plugins.get(robot) or ()):
            return None
        return known.state.battery

    # -- deciding -------------------------------------------------------------------------------------------

    def settle(self, now_ns: int) -> bool:
        """Apply silence, restarts, the time and other tasks; True if a task or robot has become free."""
        freed = False
        version, self._settled_version = self._settled_version, self.book.version
        others_changed = version != self.book.version

        def settle(record: TaskRecord) -> None:
            nonlocal freed
            task_id = record.task.id
            if record.robot.startswith(MEMBER_PREFIX):
                return  # handled by `MoteMembers`
            if self.team_map.shut_zones and not record.recalled:
                reason = self.eligibility.unplannable(record)
                if isinstance(reason, Shut) and reason != record.reason:
                    record = self.book.update(record.task, reason, recalls=record.state is not TaskState.QUEUED)
            # By the clock of a coordinator before this one. A change of this step may be later than its `now_ns`.
            if record.changed_ns > max(now_ns, self.wire.clock.now_ns()):
                record = msgspec.structs.replace(record, changed_ns=self._begun_ns)
            if record.robot:
                robot = self.roster.robots.get(record.robot)
                is_unheard = robot is None or robot.state is None
                continues_for_s = self.roster.continues_for_s() if is_unheard else 0.0
                move = reconcile(record, robot, now_ns, self._since_ns, continues_for_s)
                if move is not None and move.state is TaskState.QUEUED:
                    out = self._record_loss(record, robot) if isinstance(move.reason, LeaseRanOut) else None
                    self.book.give_back(task_id, out or move.reason)
                    freed = True
                elif move is not None:
                    self.book.move(task_id, move.state, move.reason)
                elif not record.recalled and (barred := self.eligibility.barred(record.task, record.robot)) is not None:
                    self.book.update(record.task, RobotOut(record.robot, barred), recalls=True)
            elif end := self._end_reason_of(record, now_ns, others_changed=others_changed):
                self.book.move(task_id, *end)

        if self._unheard:
            self._pause_lost_robots(now_ns)
        with self.as_far_as_written(now_ns):
            self._guard.records(self.book.open, settle, attrgetter("task.id"), "task")
        return freed

    def _record_loss(self, record: TaskRecord, robot: Robot | None) -> RobotOut | None:
        """Remember that a robot is unheard with a task; why, if others released that task out of contact before."""
        if record.own or robot is None or robot.state is None or robot.state.pose is None:
            return None
        place = Point2D(robot.state.pose.x_m, robot.state.pose.y_m)
        self._unheard[robot.name] = (record.task.id, place)
        return RobotOut(robot.name, OutOfReach(place)) if record.task.id in self._losses else None

    def _pause_lost_robots(self, now_ns: int) -> None:
        """Pause a task for the robots that lost contact on the path to it, from the second time on.

        Once may be a disturbance. A robot that was restarted does not report the task that it had.
        """
        for name, (task_id, place) in list(self._unheard.items()):
            robot = self.roster.robots.get(name)
            if robot is None or not robot.is_up(now_ns) or robot.state is None:
                continue
            del self._unheard[name]
            status = robot.state.task
            if status is None or status.id != task_id or status.state is not TaskState.CANCELLED:
                continue
            losses = self._losses.setdefault(task_id, {})
            if losses:
                for other, at in (*losses.items(), (name, place)):
                    self.backoff.record(task_id, other, OutOfReach(at), now_ns)
            losses[name] = place
            if len(self._losses) > LOSSES_KEPT:
                del self._losses[next(iter(self._losses))]

    def _end_reason_of(
        self, record: TaskRecord, now_ns: int, *, others_changed: bool
    ) -> tuple[TaskState, TaskReason] | None:
        task = record.task
        if record.own:  # it is offered in the step that makes it, or never
            return TaskState.CANCELLED, record.reason or plain("not_offered", "it was offered to nobody")
        if task.deadline_ns is not None and now_ns > task.deadline_ns:
            return TaskState.FAILED, DeadlinePassed(reason_of(record))
        if not others_changed or not task.others:
            return None
        others = {name: found for name in task.others if (found := self.book.find(name)) is not None}
        ended = dependency_refusal(task, others)
        return None if ended is None else (TaskState.CANCELLED, ended)

    def publish_unfit(self, now_ns: int) -> list[TaskRecord]:
        """Publish for ready tasks that no robot of the team can do them; returns all ready tasks."""
        ready = [record for record in self.book.open if self.eligibility.wait_reason(record, now_ns) is None]
        with self.as_far_as_written(now_ns):
            for record in ready:
                reason = self.eligibility.nobody_can(record, now_ns)
                if reason is not None and reason != record.reason:  # published once, and at each change
                    self.book.move(record.task.id, TaskState.QUEUED, reason)
        return ready

    def may_be_next(self, robot: str, at: str) -> bool:
        """Whether a robot may be offered a next task after its running one: once for each."""
        return self._ahead.get(robot, ("", ""))[0] != at

    def offer(self, task_id: str, robot: str, now_ns: int, *, after: str = "") -> OfferRefusal | None:
        """Offer a queued task to a robot. If refused, it is queued again, or ends if it is the coordinator's own.

        Args:
            task_id: of the task.
            robot: name of the robot.
            now_ns: the time.
            after: the running task that the robot must end first; empty if there is none.

        Returns:
            Why it was refused, if that is known already; in live the answer comes later.

        Raises:
            JournalUnwritable: a step of it is not in the journal; the robot's later reports count.

        """
        record = self.book.offered(task_id, robot, IsNext(after) if after else None)
        if after:
            self._ahead[robot] = (after, task_id)
        self._offers.offer(record, after)
        refusal: OfferRefusal | None = None
        for answered in self._offers.answered():
            if self._handle_answer(answered, now_ns) and answered.record is record:
                refusal = answered.answer.reason or PlainReason(cut(answered.answer.why) or "it does not say why")
        return refusal

    def revoke(self, known: int, reason: TaskReason, now_ns: int) -> None:
        """Requeue the tasks whose assignment other robots may not have received; their robots are ordered to drop them.

        Args:
            known: number of the last change that they have received.
            reason: why they are taken back.
            now_ns: the time.

        """
        with self.as_far_as_written(now_ns):
            for record in [record for record in self.book.open if record.robot and not record.own]:
                offered = self.book.journal.when_offered(record.task.id, record.robot, record.epoch)
                if offered > known:
                    self.book.give_back(record.task.id, reason)

    def withdraw_strays(self, now_ns: int) -> None:
        """Withdraw tasks that robots do or hold and that the book has closed, recalled, or given to another robot."""
        for robot in self.roster.up(now_ns):
            if robot.state is None or (robot.state.task is None and robot.state.next_task is None):
                continue
            kept = [record for record in self.book.bound_to(robot.name) if not record.recalled]
            for status in strays(robot, kept, now_ns):
                withdrawal = (robot.name, status.id, status.epoch)
                if now_ns - self._withdrawn_ns.get(withdrawal, -WITHDRAW_AGAIN_NS) < WITHDRAW_AGAIN_NS:
                    continue
                self._withdrawn_ns = {
                    key: at for key, at in self._withdrawn_ns.items() if now_ns - at < WITHDRAW_AGAIN_NS
                }
                self._withdrawn_ns[withdrawal] = now_ns
                self._withdraw(robot.name, status)

    def _withdraw(self, robot: str, status: TaskStatus) -> None:
        record = self.book.find(status.id)
        if record is None:
            reason = "the coordinator knows nothing of it"
        elif record.state is TaskState.CANCELLED or record.recalled:
            reason = record.why
        else:
            reason = f"it was given to others: it is {record.state}{f' at {record.robot}' if record.robot else ''}"
        self._offers.withdraw(robot, TaskWithdrawal(id=status.id, epoch=status.epoch, why=reason))

    # -- the journal ----------------------------------------------------------------------------------------

    def as_far_as_written(self, now_ns: int) -> AbstractContextManager[None]:
        """Suppress journal errors: a change that cannot be written is not made, and is tried again later."""
        self._written.now_ns = now_ns
        return self._written


class _AsFarAsWritten(AbstractContextManager[None]):
    """Suppresses journal errors, and logs them now and then."""

    def __init__(self) -> None:
        self.now_ns = 0
        self._complained_ns: int | None = None

    def __exit__(self, kind: object, error: BaseException | None, _traceback: object) -> bool:
        if not isinstance(error, JournalUnwritable):
            return False
        self.report(error, self.now_ns)
        return True

    def report(self, error: JournalUnwritable, now_ns: int) -> None:
        """A change could not be written."""
        if self._complained_ns is None or now_ns - self._complained_ns > COMPLAIN_AGAIN_NS:
            self._complained_ns = now_ns
            logger.error("%s; no task changes until it can be", error)
