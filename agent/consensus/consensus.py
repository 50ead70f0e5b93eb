"""Allocates open tasks among robots by consensus while they receive no coordinator.

A robot begins tasks that a coordinator had queued only under two conditions. It receives more than half of the team, as
the last coordinator listed it, and none of these robots receives a coordinator. Two such groups would share a robot, so
there is at most one. A live coordinator receives no robot of that group.
"""

import math
from collections.abc import Iterable, Set
from typing import NamedTuple

import msgspec

from robrain.agent.consensus.holders import GIVEN_UP_NS, GOES_ON_S, Holders
from robrain.agent.consensus.known_tasks import KnownTasks, TaskSync
from robrain.agent.consensus.task_intake import Known, TaskIntake
from robrain.agent.host.host_extension import ExtendedHost, HostExtension
from robrain.algorithms.consensus.negotiation import Negotiation
from robrain.algorithms.consensus.route_scorer import task_scorer
from robrain.protocol.clock import clock_difference_ns, to_ns, to_seconds
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import RobotState, TaskStatus
from robrain.protocol.messages.tasks.consensus_messages import (
    ABSENT_MAX,
    ENDED_REPORTED,
    ROBOT_BALLOT,
    ROBOT_CANCEL,
    ROBOT_SUBMIT,
    CancelAcceptance,
    TaskAcceptance,
    TaskDone,
    TaskHeld,
    TaskHeldBy,
    TeamBallot,
)
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.tasks.task_messages import TaskRequest, TaskSubmission
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, TeamState
from robrain.protocol.model.ballot import SeenBallot
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import RECHARGE
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import Occupied, OfferRefusal
from robrain.protocol.wire.endpoint import Request, Serve

NUMBERS_MAX = 64
"""Ballots with the claim whose echo counts, the last ones (chosen: 6 s and more)."""


class TaskClaim:
    """One task at a time.

    Args:
        robot: robot that claims.

    """

    def __init__(self, robot: str) -> None:
        self.task = ""
        """Id of the task; empty if the robot wants to begin none."""
        self._robot = robot
        self._numbers: list[int] = []
        """Numbers of this robot's ballots with the claim."""
        self._echoed_by: set[str] = set()

    def want(self, task: str) -> bool:
        """Claim the task that the robot wants to begin; empty for none. Returns whether the claim is new."""
        if task == self.task:
            return False
        self.task, self._numbers, self._echoed_by = task, [], set()
        return bool(task)

    def record_sent(self, number: int) -> None:
        """A ballot with the claim was sent."""
        if self.task:
            self._numbers = [*self._numbers[1 - NUMBERS_MAX :], number]

    def record_echo(self, teammate: str, echoes: Iterable[SeenBallot]) -> None:
        """A teammate reports whose ballots it has received last."""
        if any(one.robot == self._robot and one.number in self._numbers for one in echoes):
            self._echoed_by.add(teammate)

    def is_confirmed(self, teammates: Set[str], team: int) -> bool:
        """Whether, with the robot itself, more than half of the team has received the claim.

        Args:
            teammates: the robots that are reachable now.
            team: number of robots of the team.

        """
        return bool(self.task) and 2 * (1 + len(self._echoed_by & teammates)) > team


SILENT_NS = to_ns(1.5)
"""Silence after which the coordinator counts as gone (chosen: three summaries, as the lease)."""
TEAMMATE_SILENT_NS = to_ns(1.5)
"""Silence after which another robot takes no part any more."""
PERIOD_NS = to_ns(0.2)
"""How often a ballot is sent."""
ROUNDS_PERIOD_NS = to_ns(0.1)
"""How often while tasks are negotiated: rounds are to end before the tasks are begun."""
REPORT_NS = to_ns(1.0)
"""Once a coordinator is received again, the robot reports completed work for this long, and refuses offers."""
REPORT_DONE_NS, REPORT_DONE_PERIOD_NS = to_ns(60.0), to_ns(1.0)
"""For this long after that, it reports more rarely the changes that the coordinator has not recorded: the disk may be
full."""
ANSWER_NS = to_ns(2.0)
"""Robots that receive a coordinator report it for this long after the ballot of one that receives none."""
STALL_NS = to_ns(5.0)
"""A negotiation without a result for this long is started again."""
ROUNDS = 20
"""Rounds of improvement, while the robots work already (measured: `docs/explanation/no-centre.md`)."""
AGAIN_NS = to_ns(30.0)
"""A task that this robot could not do is bid for again after this long."""
CHARGED_SOC, CHARGE_BELOW_SOC = 0.95, 0.9
NS_PER_MS = 1_000_000
NAME = "consensus"
REPORTING = Occupied(NAME, "the robot reports to a coordinator what was done without it")
"""Why offers and withdrawals are refused for a moment."""


class _Opened(NamedTuple):
    """Basis of a negotiation."""

    at_ns: int
    """When, or when its last round ended."""
    round: int
    teammates: frozenset[str]
    tasks: frozenset[str]


class _Teammate(NamedTuple):
    received_ns: int
    report: TeamBallot


class Consensus(HostExtension):
    """A robot's part in allocation without a coordinator.

    Args:
        host: the robot's host.
        chargers: those that the robot knows, arena frame.

    """

    def __init__(self, host: ExtendedHost, chargers: list[Point2D]) -> None:
        wire, robot, desk, now_ns = host.wire, host.name, host.desk, host.clock.now_ns()
        self._wire = wire
        self.known = KnownTasks()
        self.is_leaderless = False
        """Whether this robot and more than half of the team allocate tasks by themselves."""
        self._robot, self._board, self._desk, self._chargers = robot, host.board, desk, chargers
        self._follows = host.follows
        self._intake = TaskIntake(robot, self.known, desk)
        self._sync = TaskSync(wire, self.known)
        self._inbox = Inbox(capacity=4096)
        for topic in (COORDINATOR_STATE, TASK_EVENT, ROBOT_BALLOT):
            wire.subscribe(self._inbox, topic)
        self._publisher = wire.publisher(ROBOT_BALLOT, robot=robot)
        self._received_ns = now_ns
        self._was_alone = False
        self._fenced_until_ns = self._publish_until_ns = self._due_ns = 0
        self._up_ns: dict[str, int] = {}
        """When each robot was last up, by the coordinators' reports."""
        self._team: frozenset[str] = frozenset()
        """The robots that were up lately when a coordinator was last received: also one that was just out of its
        reach."""
        self._is_new = True
        """Whether no coordinator has listed this robot as up since its start."""
        self._others: dict[str, _Teammate] = {}
        nothing = task_scorer((), Point2D(0.0, 0.0), [Point2D(0.0, 0.0)], None, 0, desk.work_of)
        self._negotiation = Negotiation(robot, nothing, rounds=ROUNDS, number=now_ns // NS_PER_MS, while_working=True)
        self._opened = _Opened(now_ns, 0, frozenset(), frozenset())
        self._term = 0
        """The greatest term received."""
        self._is_called = False
        """Whether a ballot calls for a new negotiation."""
        self._holders = Holders(robot)
        self._claim = TaskClaim(robot)
        self._not_mine: dict[str, int] = {}
        """Tasks that this robot could not do, and until when it does not bid for them."""
        self._charges = 0
        desk.goes_on_ns = to_ns(GOES_ON_S)

    def step(self, now_ns: int, *, may_begin: bool) -> None:
        """Receive, decide, act, report.

        Args:
            now_ns: the time.
            may_begin: whether the robot may begin tasks: it is not halted.

        """
        self._receive(now_ns)
        is_alone = now_ns - self._received_ns > SILENT_NS
        if self._was_alone and not is_alone:
            self._fenced_until_ns = now_ns + REPORT_NS
            self._publish_until_ns = now_ns + 2 * REPORT_NS
        self._was_alone = is_alone
        if not is_alone:
            self._sync.step(now_ns)
        has_coordinator_elsewhere = any(teammate.report.receives_coordinator for teammate in self._others.values())
        self.is_leaderless = is_alone and not has_coordinator_elsewhere and self._has_quorum()
        self._record_own_ends(now_ns)
        if is_alone:
            self._stop_dropped()
        wanted = ""
        if self.is_leaderless:
            self._desk.trusted_ns = now_ns
            wanted = self._allocate(now_ns, may_begin=may_begin)
        if self._claim.want(wanted):
            self._due_ns = now_ns
        must_report = is_alone or now_ns < self._publish_until_ns or bool(self.known.asked)
        is_rare = not must_report and bool(self.known.done) and now_ns < self._fenced_until_ns + REPORT_DONE_NS
        if (must_report or is_rare) and now_ns >= self._due_ns:
            is_busy = self.is_leaderless and bool(self._opened.tasks) and not self._negotiation.is_over
            period_ns = ROUNDS_PERIOD_NS if is_busy else PERIOD_NS
            self._due_ns = now_ns + (REPORT_DONE_PERIOD_NS if is_rare else period_ns)
            self._send(now_ns, is_alone=is_alone)

    def start(self) -> None:
        """Answer clients that find no coordinator."""
        wire, robot, now_ns = self._wire, self._robot, self._wire.clock.now_ns
        wire.answer(ROBOT_SUBMIT, lambda query: self.submit(query.asked, now_ns()), serve=Serve.IN_STEP, robot=robot)
        wire.answer(ROBOT_CANCEL, lambda query: self.cancel(query.asked, now_ns()), serve=Serve.IN_STEP, robot=robot)

    def submit(self, asked: TaskSubmission, now_ns: int) -> TaskAcceptance:
        """Accept a task without a coordinator (CallError if it is refused, in words)."""
        if not self.is_leaderless and asked.task.id not in self.known.asked:
            reason = self._query_refusal("submit")
            raise CallError(ErrorCode.REFUSED, f"task {asked.task.id} is refused: {reason}", reason)
        self._due_ns = now_ns  # the others must know at once
        return self._intake.accept(asked, now_ns, self._published_known(), len(self._everyone()))

    def cancel(self, asked: TaskRequest, now_ns: int) -> CancelAcceptance:
        """Accept the cancellation of a task without a coordinator (CallError if it is refused, in words)."""
        if not self.is_leaderless and asked.id not in self.known.dropped:
            reason = self._query_refusal("cancel")
            raise CallError(ErrorCode.REFUSED, f"task {asked.id} is not cancelled: {reason}", reason)
        self._due_ns = now_ns  # the others must know at once
        dropped = {name: {one.id for one in teammate.report.dropped} for name, teammate in self._others.items()}
        return self._intake.drop(asked, dropped, len(self._everyone()), self._holders.of(asked.id, now_ns))

    def _query_refusal(self, verb: str) -> str:
        if self._was_alone and not self._has_quorum():
            return f"it hears {1 + len(self._others)} of {len(self._everyone())} robots, which is not more than half"
        return f"a coordinator is heard: {verb} it there"

    def is_reporting(self, now_ns: int) -> bool:
        """Whether a coordinator has just returned, and may not know yet the work done without it."""
        return now_ns < self._fenced_until_ns

    def offer_refusal(self, task_id: str, now_ns: int) -> Occupied | None:
        """Why a coordinator's offer of a task is refused; None if it need not be."""
        if self.known.is_done(task_id):
            return Occupied(NAME, f"{self.known.done[task_id].robot} has done it")
        if task_id in self.known.dropped:
            return Occupied(NAME, "the task was cancelled while no coordinator was heard")
        holder = self._holders.of(task_id, now_ns)
        if holder:
            return Occupied(NAME, f"{holder} is at it")
        return REPORTING if self._was_alone or self.is_reporting(now_ns) else None

    def withdrawal_refusal(self, now_ns: int) -> OfferRefusal | None:
        """Refuse while the robot reports to a coordinator the work done without it."""
        return REPORTING if self.is_reporting(now_ns) else None

    def extend_state(self, state: RobotState) -> RobotState:
        """Report that the robot continues without a coordinator, and the changes of tasks that it has received."""
        return msgspec.structs.replace(state, continues_for_s=GOES_ON_S, changes_received=self._sync.last)

    # -- hearing --------------------------------------------------------------------------------------------

    def _receive(self, now_ns: int) -> None:
        for received in self._inbox.drain() if self._inbox.has_some else ():
            message = received.message
            match message:
                case TeamState() if self._follows(message):
                    self._received_ns = now_ns
                    self._record_team(message, now_ns)
                    self._sync.receive_summary(message.last_change, now_ns)
                case TaskEvent():
                    self.known.receive(message, now_ns)
                    self._sync.receive(message, now_ns)
                    if message.task.id in self.known.dropped:  # the coordinator does not know that yet
                        self._publish_until_ns = max(self._publish_until_ns, now_ns + REPORT_NS)
                case TeamBallot() if message.robot != self._robot:
                    self._receive_ballot(message, now_ns)
        self._others = {
            name: teammate
            for name, teammate in self._others.items()
            if now_ns - teammate.received_ns <= TEAMMATE_SILENT_NS
        }

    def _record_team(self, summary: TeamState, now_ns: int) -> None:
        for robot in summary.robots:
            if robot.up and robot.name == self._robot:
                self._is_new = False
            silent_ns = 0 if robot.up else to_ns(robot.age_s)
            self._up_ns[robot.name] = max(self._up_ns.get(robot.name, 0), now_ns - silent_ns)
        self._up_ns = {name: up_ns for name, up_ns in self._up_ns.items() if now_ns - up_ns <= GIVEN_UP_NS}
        self._team = frozenset(self._up_ns)

    def _receive_ballot(self, report: TeamBallot, now_ns: int) -> None:
        self._others[report.robot] = _Teammate(now_ns, report)
        self._claim.record_echo(report.robot, report.receives)
        if self._holders.receive(report, self._others, now_ns) and report.wants:
            self._due_ns = now_ns  # it waits for an echo
        if now_ns - self._received_ns > SILENT_NS:  # otherwise the coordinator decides about them
            ahead_ns = clock_difference_ns(report.stamp_ns, now_ns)
            for asked in report.asked:
                self.known.ask(asked, ahead_ns)
        self.known.record_ended(report.ended)
        self.known.record_done(report.done)
        if now_ns - self._received_ns > SILENT_NS:  # see above
            self.known.drop(report.dropped)
        if not report.receives_coordinator:
            self._publish_until_ns = max(self._publish_until_ns, now_ns + ANSWER_NS)
        if not self._negotiation.receive(report.ballot):
            self._term = max(self._term, report.ballot.term)
            self._is_called = True

    def _record_own_ends(self, now_ns: int) -> None:
        facts = self._desk.facts
        for status in (facts.before, facts.task):
            if status is None or not status.state.ended:
                continue
            if status.state is TaskState.DONE:
                self.known.record_done([TaskDone(id=status.id, robot=self._robot, epoch=status.epoch)])
            elif self.is_leaderless and status.id not in self._not_mine:
                self._not_mine[status.id] = now_ns + AGAIN_NS
                self._is_called |= status.id in self._negotiation.bidder.begun  # the others take it to be cared for

    def _stop_dropped(self) -> None:
        """End the running task, and forget the held one, if they were cancelled or have ended elsewhere."""
        for held in self._held():
            dropped = self.known.dropped.get(held.id)
            if self.known.has_ended(held.id):
                self._desk.cancel_for_team(held.id, "it ended while the robot was cut off")
            elif dropped is not None:
                self._desk.cancel_for_team(held.id, dropped.why or f"cancelled by {dropped.by or 'a client'}")

    def _has_quorum(self) -> bool:
        """Whether more than half of the team receive each other.

        A restarted robot does not count until a coordinator lists it as up, because that coordinator may be leading the
        others. It joins a majority of robots that do count. If no robot counts, there was no coordinator, and all do.
        """
        there = [teammate.report for teammate in self._others.values()]
        if self._is_new and not all(report.is_new for report in there):
            return any(report.allocates and not report.is_new for report in there)
        counted = 1 + sum(self._is_new or not report.is_new for report in there)
        return 2 * counted > len(self._everyone())

    def _everyone(self) -> frozenset[str]:
        return self._team | {self._robot, *self._others}

    def _published_known(self) -> Known:
        return {name: teammate.report.known for name, teammate in self._others.items()}

    # -- deciding -------------------------------------------------------------------------------------------

    def _allocate(self, now_ns: int, *, may_begin: bool) -> str:
        """Negotiate, and begin tasks that the others know; the id of the task that the robot wants to begin."""
        tasks = {task.id: task for task in self._free(now_ns)}
        teammates, negotiation = frozenset(self._others), self._negotiation
        if negotiation.round != self._opened.round:
            self._opened = self._opened._replace(at_ns=now_ns, round=negotiation.round)
        opened = self._opened
        is_idle = not self._desk.is_busy and self._desk.held is None
        mine = [name for name in negotiation.path if name in tasks]
        is_due = self._is_called or teammates != opened.teammates or not tasks.keys() <= opened.tasks
        if tasks and now_ns - opened.at_ns > STALL_NS:
            is_due |= not negotiation.is_over or (is_idle and not mine)
        if is_due:
            self._open(tasks, teammates, now_ns)
        elif is_idle and may_begin and negotiation.is_agreed and not self.known.is_full:
            able = (name for name in mine if name not in self._not_mine and negotiation.may_begin(name))
            wanted = next(able, "")
            if wanted and (
                wanted != self._claim.task or not self._claim.is_confirmed(teammates, len(self._everyone()))
            ):
                return wanted
            if wanted:
                self._begin(tasks[wanted], now_ns)
            elif tasks and not mine and negotiation.is_over:
                self._charge()
        return ""

    def _free(self, now_ns: int) -> list[Task]:
        """Open tasks without a robot.

        Tasks that may have ended unreported are included only once others would be given them.
        """
        held = {one.id for one in self._held()}
        there = {self._robot, *self._others}
        lost = now_ns - self._received_ns > GIVEN_UP_NS
        free = [
            task
            for task in self.known.ready(now_ns)
            if task.id not in held
            and not self._holders.of(task.id, now_ns)
            and (lost or not (robot := self.known.open[task.id].robot) or robot in there)
        ]
        if self._sync.behind_since_ns is None or lost:
            return free
        return [task for task in free if self.known.open[task.id].received_ns >= self._sync.behind_since_ns]

    def _open(self, tasks: dict[str, Task], teammates: frozenset[str], now_ns: int) -> None:
        """Bid again, in a teammate's negotiation or in a new one."""
        pose, negotiation = self._board.pose, self._negotiation
        self._not_mine = {name: until for name, until in self._not_mine.items() if until > now_ns}
        able: list[Task] = []
        if pose is not None and not self._board.lost:
            able = [task for name, task in tasks.items() if name not in self._not_mine and self._desk.can(task)]
        here = Point2D(0.0, 0.0) if pose is None else Point2D(pose.x_m, pose.y_m)
        for held in self._held():  # it continues from there
            here = self.known.open[held.id].task.place if held.id in self.known.open else here
        ends = self._chargers or [here]
        negotiation.bidder.scorer = task_scorer(able, here, ends, self._board.energy, now_ns, self._desk.work_of)
        negotiation.bidder.limit = math.ceil(len(tasks) / (1 + len(teammates)))
        self._term = max(self._term, negotiation.term + 1)
        self._opened = _Opened(now_ns, 0, teammates, frozenset(tasks))
        self._is_called = False
        negotiation.open(self._term, teammates, tasks, self._apart)

    def _apart(self, one: str, other: str) -> float:
        """Distance between two tasks, metres; 0 if either is not known any more."""
        first, second = self.known.open.get(one), self.known.open.get(other)
        return 0.0 if first is None or second is None else first.task.place.distance_m(second.task.place)

    def _begin(self, task: Task, now_ns: int) -> bool:
        if self._desk.begin_for_team(task).accepted:
            self._negotiation.begin(task.id)
            self._due_ns = now_ns  # the others must know at once
            return True
        self._not_mine[task.id] = now_ns + AGAIN_NS
        return False

    def _charge(self) -> None:
        """Charge if the energy left is for none of the tasks that there are."""
        battery, pose = self._board.battery, self._board.pose
        if battery is None or pose is None or not self._chargers or battery.soc > CHARGE_BELOW_SOC:
            return
        place = min(self._chargers, key=lambda one: (pose.distance_m(one), one.x_m, one.y_m))
        self._charges += 1
        wanted = {"until_soc": CHARGED_SOC}
        self._desk.begin_for_team(
            Task(id=f"recharge-{self._robot}-{self._charges}", kind=RECHARGE, place=place, parameters=wanted)
        )

    # -- reporting ------------------------------------------------------------------------------------------

    def _held(self) -> list[TaskHeld]:
        facts = self._desk.facts
        statuses: list[TaskStatus | None] = [facts.task, facts.next_task]
        return [
            TaskHeld(id=status.id, epoch=status.epoch)
            for status in statuses
            if status is not None and not status.state.ended
        ]

    def _ended_tasks_to_publish(self) -> list[str]:
        """Ended tasks that teammates bid for or do, because the end has not reached them."""
        reports = [teammate.report for teammate in self._others.values()]
        wanted = {bid.task for one in reports for bid in one.ballot.bids} | {
            held.id for one in reports for held in one.held
        }
        return sorted(task for task in wanted if self.known.has_ended(task))[:ENDED_REPORTED]

    def _absent_tasks_to_publish(self, now_ns: int) -> list[TaskHeldBy]:
        """Tasks of silent robots, by their last ballots and the coordinator's last offers."""
        there = {self._robot, *self._others}
        reported = self._holders.to_report(there, now_ns)
        remaining_s, names = to_seconds(self._received_ns + GIVEN_UP_NS - now_ns), {one.id for one in reported}
        if remaining_s <= 0.0 or now_ns - self._received_ns <= SILENT_NS:  # a coordinator knows its own assignments
            return reported
        reported += [
            TaskHeldBy(id=name, robot=one.robot, remaining_s=remaining_s)
            for name, one in sorted(self.known.open.items())
            if one.robot and one.robot not in there and name not in names and not self.known.is_done(name)
        ]
        return reported[:ABSENT_MAX]

    def _send(self, now_ns: int, *, is_alone: bool) -> None:
        teammates = sorted(self._others.items())
        report = TeamBallot(
            robot=self._robot,
            ballot=self._negotiation.ballot(),
            receives_coordinator=not is_alone,
            is_new=self._is_new,
            allocates=self.is_leaderless,
            held=self._held(),
            done=list(self.known.done.values()),
            known=self.known.known(),
            asked=self._intake.to_report(self._published_known(), everything=not is_alone),
            dropped=list(self.known.dropped.values()),
            ended=self._ended_tasks_to_publish(),
            wants=self._claim.task,
            receives=tuple(
                SeenBallot(robot=name, number=teammate.report.ballot.number) for name, teammate in teammates
            ),
            absent=self._absent_tasks_to_publish(now_ns),
        )
        self._claim.record_sent(report.ballot.number)
        self._publisher.put(report)


def consensus_extension(host: ExtendedHost) -> HostExtension:
    """Consensus for a robot whose file has `consensus = true`; for others an extension that refuses tasks."""
    if not host.robot_file.robot.consensus:
        return NoConsensus(host)
    chargers = host.robot_file.parameters.get("home", {}).get("chargers", ())
    return Consensus(host, [Point2D(one["x_m"], one["y_m"]) for one in chargers])


class NoConsensus(HostExtension):
    """Refuses tasks that clients without a coordinator submit."""

    def __init__(self, host: ExtendedHost) -> None:
        self._host = host
        self._reason = f"{host.name} has its tasks from a coordinator alone: its file has no `consensus = true`"

    def start(self) -> None:
        """Answer clients that find no coordinator."""
        wire, robot = self._host.wire, self._host.name
        wire.answer(ROBOT_SUBMIT, self._refuse_task, serve=Serve.IN_STEP, robot=robot)
        wire.answer(ROBOT_CANCEL, self._refuse_cancel, serve=Serve.IN_STEP, robot=robot)

    def _refuse_task(self, request: Request[TaskSubmission]) -> TaskAcceptance:
        task = request.asked.task.id
        raise CallError(ErrorCode.REFUSED, f"task {task} is refused: {self._reason}", self._reason)

    def _refuse_cancel(self, request: Request[TaskRequest]) -> CancelAcceptance:
        task = request.asked.id
        raise CallError(ErrorCode.REFUSED, f"task {task} is not cancelled: {self._reason}", self._reason)
