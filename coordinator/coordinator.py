"""The coordinator: hears the team, merges its maps, hands out frontiers, tells how it stands."""

import logging

import msgspec

from robrain.coordinator.exploration.explorer import Explorer
from robrain.coordinator.halts import HaltWatch
from robrain.coordinator.roster import Robot, Roster
from robrain.coordinator.task_book import TaskBook
from robrain.coordinator.team_map import TeamMap
from robrain.protocol.model.task import Explore, TaskState
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.errors import CallError, NobodyThere
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages import (
    FrontierSummary,
    TaskAnswer,
    TaskEvent,
    TaskOffer,
    TaskWithdrawal,
    TeamState,
)
from robrain.protocol.wire.publisher import Publisher
from robrain.protocol.wire.topics import (
    COORDINATOR_ALIVE,
    COORDINATOR_STATE,
    ROBOT_ALIVE,
    ROBOT_MAP,
    ROBOT_MAP_WHOLE,
    ROBOT_OFFER,
    ROBOT_STATE,
    ROBOT_WITHDRAW,
    TASK_EVENT,
)

logger = logging.getLogger(__name__)

DECIDE_PERIOD_NS = to_ns(0.5)
SUMMARY_PERIOD_NS = to_ns(0.5)
LEASE_S = 5.0
SETTLED_NS = to_ns(3.0)
"""The floor counts as explored when for this long no robot could be given a frontier."""
SHOWN_FRONTIERS = 64
KEPT_TASK_EVENTS = 256
FORGOTTEN_NS = to_ns(1.0)
"""A robot that for this long does not speak of the task it was given has lost it, by a restart for instance."""
NS_PER_MS = 1_000_000


class Coordinator:
    """Coordinates one team.

    Args:
        wire: the coordinator's place on the wire; its owner closes it.

    """

    def __init__(self, wire: Endpoint) -> None:
        self.roster = Roster()
        self.team_map = TeamMap()
        self.explorer = Explorer(self.team_map)
        # Milliseconds of the clock: a coordinator that takes over later starts with a greater epoch, and with
        # numbers for its tasks that no earlier one has used.
        first_epoch = wire.clock.now_ns() // NS_PER_MS
        self.tasks = TaskBook(wire.clock, first_epoch, self._tell_task)
        self._wire = wire
        self._inbox = Inbox(capacity=16384)
        self._presence = wire.watch(ROBOT_ALIVE)
        wire.subscribe(self._inbox, ROBOT_STATE)
        wire.subscribe(self._inbox, ROBOT_MAP)
        self.halts = HaltWatch(wire, self.roster)
        self._summary = wire.publisher(COORDINATOR_STATE)
        self._task_events: dict[str, Publisher] = {}
        wire.token(COORDINATOR_ALIVE)
        self._decide_due_ns = 0
        self._summary_due_ns = 0
        self._explores = first_epoch
        self._busy_ns = wire.clock.now_ns()

    def step(self) -> None:
        """Hear, decide, act."""
        now_ns = self._wire.clock.now_ns()
        self._wire.serve()
        self._hear(now_ns)
        if self.halts.hear():
            self._summary_due_ns = now_ns
        self._note_lost(now_ns)
        if now_ns >= self._decide_due_ns:
            self._decide_due_ns = now_ns + DECIDE_PERIOD_NS
            self._hand_out_frontiers(now_ns)
        if now_ns >= self._summary_due_ns:
            self._summary_due_ns = now_ns + SUMMARY_PERIOD_NS
            self._tell_summary(now_ns)

    # -- hearing --------------------------------------------------------------------------------------------

    def _hear(self, now_ns: int) -> None:
        for change in self._presence.changes():
            robot = self.roster.note_presence(change)
            if change.present:
                # It may have mapped before this coordinator came.
                self._wire.ask_into(self._inbox, ROBOT_MAP_WHOLE, ROBOT_MAP, robot=robot.name)
        for received in self._inbox.drain():
            if received.topic is ROBOT_MAP:
                self.team_map.merge(received.message)
                continue
            state = received.message
            self.roster.note_state(state, now_ns)
            self.halts.note_state(state)
            if state.task is not None:
                ended = self.tasks.note_status(state.robot, state.task)
                if ended is not None:
                    self._decide_due_ns = now_ns  # the next goal is there before the wheels stop
                    if state.task.state is TaskState.FAILED:
                        self.explorer.note_failure(state.robot, ended.task.goal, now_ns)

    def _note_lost(self, now_ns: int) -> None:
        for record in self.tasks.open:
            robot = self.roster.robots.get(record.robot)
            if robot is None or not record.robot:
                continue
            if robot.is_up(now_ns):
                status = robot.state.task if robot.state is not None else None
                if status is None or (status.id, status.epoch) != (record.task.id, record.epoch):
                    if now_ns - record.changed_ns > FORGOTTEN_NS:
                        self.tasks.move(record.task.id, TaskState.CANCELLED, f"{robot.name} knows nothing of it")
                elif record.state is TaskState.LOST_CONTACT:
                    self.tasks.move(record.task.id, TaskState.RUNNING, "it is back")
            elif record.state is not TaskState.LOST_CONTACT:
                self.tasks.move(record.task.id, TaskState.LOST_CONTACT, robot.why_not_up(now_ns))
            elif robot.age_s(now_ns) > LEASE_S:
                # Its lease has run out on the robot's side too; the frontier is free for another.
                self.tasks.move(record.task.id, TaskState.CANCELLED, "the lease ran out")

    # -- deciding -------------------------------------------------------------------------------------------

    def _hand_out_frontiers(self, now_ns: int) -> None:
        there = [] if self.halts.is_halted else self.roster.up(now_ns)
        up = [robot for robot in there if robot.state is not None and not robot.state.halted]
        bound = {record.robot: record.task.goal for record in self.tasks.open}
        idle = [robot for robot in up if robot.name not in bound]
        for robot in idle:
            self._withdraw_unknown(robot)
        choices = self.explorer.choose(idle, list(bound.values()), now_ns) if idle else []
        if choices or bound or self.explorer.has_failures or not up or self.team_map.version == 0:
            self._busy_ns = now_ns
        for choice in choices:
            self._explores += 1
            task = Explore(id=f"explore-{self._explores}", goal=choice.place)
            self.tasks.add(task)
            self._offer(task, choice.robot, now_ns)

    def _offer(self, task: Explore, robot: str, now_ns: int) -> None:
        record = self.tasks.offered(task.id, robot)
        offer = TaskOffer(task=task, epoch=record.epoch, lease_s=LEASE_S)
        try:
            reply = self._wire.ask(ROBOT_OFFER, offer, robot=robot, timeout_s=1.0)
            answer = msgspec.json.decode(reply, type=TaskAnswer)
        except (CallError, NobodyThere, msgspec.DecodeError) as error:
            answer = TaskAnswer(accepted=False, why=str(error))
        if answer.accepted:
            self.tasks.move(task.id, TaskState.RUNNING)
        else:
            self.tasks.move(task.id, TaskState.CANCELLED, f"{robot} refused: {answer.why}")
            self.explorer.note_failure(robot, task.goal, now_ns)

    def _withdraw_unknown(self, robot: Robot) -> None:
        """A robot that is still at a task which the book has closed is told to stop."""
        status = robot.state.task if robot.state is not None else None
        if status is None or status.state.ended:
            return
        withdrawal = TaskWithdrawal(id=status.id, epoch=status.epoch, why="the coordinator knows nothing of it")
        try:
            self._wire.ask(ROBOT_WITHDRAW, withdrawal, robot=robot.name, timeout_s=1.0)
        except (CallError, NobodyThere) as error:
            logger.debug("%s: task %s could not be withdrawn: %s", robot.name, status.id, error)

    # -- telling --------------------------------------------------------------------------------------------

    def _tell_task(self, event: TaskEvent) -> None:
        publisher = self._task_events.get(event.task.id)
        if publisher is None:
            publisher = self._task_events[event.task.id] = self._wire.publisher(TASK_EVENT, task=event.task.id)
            if len(self._task_events) > KEPT_TASK_EVENTS:  # those that join late hear of the last ones only
                self._task_events.pop(next(iter(self._task_events))).close()
        publisher.put(event)

    def _tell_summary(self, now_ns: int) -> None:
        frontiers = self.explorer.candidates[:SHOWN_FRONTIERS]
        self._summary.put(
            TeamState(
                robots=self.roster.summaries(now_ns),
                known_area_m2=round(self.team_map.known_area_m2, 3),
                frontiers=[FrontierSummary(place=found.place, length_m=found.length_m) for found in frontiers],
                all_explored=self.team_map.version > 0 and now_ns - self._busy_ns > SETTLED_NS,
                tasks_open=len(self.tasks.open),
                tasks_done=self.tasks.done_count,
                messages=self._inbox.received,
                halt=self.halts.status(now_ns),
            )
        )
