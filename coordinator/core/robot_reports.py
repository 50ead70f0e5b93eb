"""Reads the messages of robots: presence, states, maps, and their actions without a coordinator."""

from collections.abc import Callable

import msgspec

from robrain.coordinator.core.core import Core
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.protocol.border.border import Received
from robrain.protocol.clock import clock_difference_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import FLOOR, ROBOT_MAP, ROBOT_MAP_WHOLE, MapPatch
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, RobotState, TaskStatus
from robrain.protocol.messages.tasks.consensus_messages import ROBOT_BALLOT, TaskAsked, TeamBallot
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import PlainReason, cancelled
from robrain.protocol.refusals import RefusalCode


class RobotReports:
    """Brings the team, its map and its tasks up to date with the messages of robots.

    Args:
        core: the team.

    """

    def __init__(self, core: Core) -> None:
        self._core, self._wire, self._refusals = core, core.wire, core.wire.refusals
        self._inbox = Inbox(capacity=16384)
        self._presence = core.wire.watch(ROBOT_ALIVE)
        self._now_ns = core.wire.clock.now_ns()
        for topic in (ROBOT_STATE, ROBOT_MAP, ROBOT_BALLOT):
            core.wire.subscribe(self._inbox, topic)

    @property
    def received(self) -> int:
        """Number of messages up to now."""
        return self._inbox.received

    def receive(self, now_ns: int) -> bool:
        """Handle new messages; returns whether there were any."""
        self._now_ns = now_ns
        if self._presence.arrived:
            self._follow_presence(now_ns)
        if not self._inbox.has_some:
            return False
        self._core.guard.messages(self._inbox.drain(), self._handle)
        return True

    def merge_held_patches(self) -> None:
        """Merge the patches held back while the map's kernels were loading; hold none from now on."""
        for robot, rejection in self._core.team_map.release():
            key = ROBOT_MAP.key(self._wire.team, robot=robot)
            self._refusals.record(ROBOT_MAP.name, key, RefusalCode.NOT_PLAUSIBLE, rejection)

    def _follow_presence(self, now_ns: int) -> None:
        gone = []
        for change in self._presence.changes():
            robot = self._core.roster.record_presence(change)
            if not change.present:
                gone.append(robot)
                continue
            # It may have mapped before this coordinator came.
            self._wire.ask_into(self._inbox, ROBOT_MAP_WHOLE, ROBOT_MAP, robot=robot.name)
            self._core.capabilities.came(robot.name)
            self._core.planning.chargers.came(robot.name)
        for part in self._core.parts.overriding["robots_gone"] if gone else ():
            part.robots_gone(gone, now_ns)

    def _handle(self, received: Received) -> None:
        if received.topic is ROBOT_MAP:
            self._handle_patch(received.message, received.key)
            return
        sender: str = received.message.robot
        if rejection := self._core.roster.rejection(sender, self._now_ns):
            self._refusals.record(received.topic.name, received.key, RefusalCode.UNKNOWN_SENDER, rejection)
        elif received.topic is ROBOT_BALLOT:
            self._handle_ballot(received.message, received.key)
        else:
            self._handle_state(received.message)

    def _handle_patch(self, patch: MapPatch, key: str) -> None:
        known = self._core.roster.robots.get(patch.robot)
        was_there = patch.robot == FLOOR or (known is not None and known.was_there)
        if not was_there:  # once its token appears, its whole map is queried
            self._refusals.record(ROBOT_MAP.name, key, RefusalCode.UNKNOWN_SENDER, f"{patch.robot} is not there")
        elif rejection := self._core.team_map.merge(patch, self._now_ns):
            self._refusals.record(ROBOT_MAP.name, key, RefusalCode.NOT_PLAUSIBLE, rejection)

    def _handle_ballot(self, ballot: TeamBallot, key: str) -> None:
        core, now_ns = self._core, self._now_ns
        core.roster.record_contact(ballot.robot, now_ns, receives_coordinator=ballot.receives_coordinator)
        epochs = [one.epoch for one in ballot.held] + [one.epoch for one in ballot.done]
        if not all(map(core.tasks.is_possible, epochs)):
            text = "it reports an epoch that no coordinator gives out"
            self._refusals.record(ROBOT_BALLOT.name, key, RefusalCode.NOT_PLAUSIBLE, text)
        core.lifecycle.eligibility.held_elsewhere.receive(ballot, now_ns)
        is_secured, impossibility = self._wire.member is not None, core.requests.impossibility
        ahead_ns = clock_difference_ns(ballot.stamp_ns, now_ns)
        with core.lifecycle.as_far_as_written(now_ns):
            if record_ballot(core.tasks, ballot, impossibility, is_secured=is_secured, ahead_ns=ahead_ns):
                core.assign_soon()

    def _handle_state(self, state: RobotState) -> None:
        core = self._core
        known = core.roster.robots.get(state.robot)
        before = known.state if known is not None else None
        core.planning.receive(before, state)
        core.roster.record_state(state, self._now_ns)
        core.halts.record_state(state)
        for status in (state.task_before, state.task):  # oldest first
            if status is not None:
                self._handle_status(state.robot, status)
        core.planning.ends_soon(before, state, self._now_ns)

    def _handle_status(self, robot: str, status: TaskStatus) -> None:
        core = self._core
        ended = core.lifecycle.receive(robot, status, self._now_ns)
        if ended is None:
            return
        core.assign_soon()  # the next goal is there before the wheels stop
        for part in core.parts.overriding["task_ended"]:
            part.task_ended(ended, robot, status, self._now_ns)
        if status.state is TaskState.FAILED:
            core.planning.blocked()


def record_ballot(
    book: TaskBook,
    ballot: TeamBallot,
    impossibility: Callable[[Task], str],
    *,
    is_secured: bool = False,
    ahead_ns: int = 0,
) -> bool:
    """Record a robot's tasks and reported ends that no coordinator decided on; return whether any is new.

    A report with an epoch that no coordinator issues is skipped.

    Args:
        book: of the coordinator's tasks.
        ballot: of a robot.
        impossibility: why a task can never be done; empty if it may be possible.
        is_secured: whether the robot's name is vouched for: its reports on others are then recorded as its own claim.
        ahead_ns: how far the robot's clock is ahead.

    Raises:
        JournalUnwritable: changes that could not be written arrive again with the next ballot.

    """
    version = book.version
    accepted = (_accept(book, ballot.robot, asked, ahead_ns, is_secured=is_secured) for asked in ballot.asked)
    new = [task for task in accepted if task is not None]
    for done in ballot.done:
        record = book.find(done.id)
        if record is not None and record.state.ended:
            book.republish_change(record)  # robots have not received that, and forget it then
            continue
        if record is None or not book.is_possible(done.epoch):
            continue
        book.exceed(done.epoch)
        book.record_done_by_team(
            done.id, done.robot, done.epoch, PlainReason(f"{done.robot} did it while it heard no coordinator")
        )
    for held in ballot.held:
        record = book.find(held.id)
        if record is not None and record.state is TaskState.QUEUED and book.is_possible(held.epoch):
            book.exceed(held.epoch)
            book.adopt(
                held.id, ballot.robot, held.epoch, PlainReason(f"{ballot.robot} began it while it heard no coordinator")
            )
    for dropped in ballot.dropped:
        record = book.find(dropped.id)
        if record is None:
            continue  # sent again with the task, if robots have accepted it
        if record.state.ended:
            book.republish_change(record)  # robots forget the cancellation then
        else:
            book.move(
                dropped.id,
                TaskState.CANCELLED,
                cancelled(_by(ballot.robot, dropped.by, is_secured=is_secured), dropped.why),
            )
    for task in new:
        record = book.find(task.id)
        if record is not None and record.state is TaskState.QUEUED and (refusal := impossibility(task)):
            book.move(task.id, TaskState.FAILED, PlainReason(cut(refusal)))
    return book.version != version


def _by(robot: str, claim: str, *, is_secured: bool) -> str:
    """Requester of a task or a cancellation: only the robot vouches for the name that it reports."""
    return cut(f"robot:{robot} for {claim or 'nobody named'}") if is_secured else claim


def _accept(book: TaskBook, robot: str, asked: TaskAsked, ahead_ns: int, *, is_secured: bool) -> Task | None:
    """Add a task that robots have accepted to the book. None if it is there already; robots receive it again."""
    submission = asked.submission
    record = book.find(submission.task.id)
    if record is not None:
        book.republish_change(record)
        return None
    try:
        task = submission.task_at(asked.at_ns - ahead_ns)
    except (ValueError, msgspec.ValidationError):
        return None  # no robot has accepted that
    reason = PlainReason(f"{robot} had no coordinator and accepted it")
    book.add(task, by=_by(robot, submission.by, is_secured=is_secured), asked=submission.word, reason=reason)
    return task
