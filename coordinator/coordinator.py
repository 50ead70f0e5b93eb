"""The coordinator: receives states, merges maps, assigns frontiers and tasks, publishes the team's state."""

import math
from collections.abc import Sequence
from operator import attrgetter

from msgspec import UNSET

from robrain.algorithms.exploration.explorer import Explorer
from robrain.algorithms.exploration.situation import Choice
from robrain.algorithms.exploration.strategies import strategy_of
from robrain.coordinator.charging.charge_desk import ChargeDesk
from robrain.coordinator.frontier_desk import FrontierDesk
from robrain.coordinator.journal.backup_desk import BackupDesk
from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.leadership.election import Elected
from robrain.coordinator.leadership.leadership import Leadership
from robrain.coordinator.motes.field_keeper import FieldKeeper
from robrain.coordinator.motes.mote_members import MoteDesk
from robrain.coordinator.planning.coalition import Coalitions
from robrain.coordinator.planning.dry_run import DryRuns
from robrain.coordinator.planning.own_decisions import own_decision
from robrain.coordinator.planning.plan_executor import PlanExecutor
from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.rules.rule import Rule
from robrain.coordinator.rules.rule_desk import RuleDesk
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.tasks.task_requests import TaskRequests
from robrain.coordinator.tasks.team_intake import take_in
from robrain.coordinator.team.capabilities import Capabilities
from robrain.coordinator.team.halt_watch import HaltWatch
from robrain.coordinator.team.left_desk import LeftDesk
from robrain.coordinator.team.roster import Robot, Roster
from robrain.coordinator.team.stale_watch import StaleWatch
from robrain.coordinator.team.team_map import TeamMap
from robrain.protocol.border.border import Received
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.clock import clock_difference_ns, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.messages.robots.robot_messages import RobotState, TaskStatus
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.messages.team.standing_messages import RobotRemoval
from robrain.protocol.messages.team.team_messages import FrontierSummary, TeamState
from robrain.protocol.model.tasks.stock_kinds import EXPLORE, RECHARGE, Recharge
from robrain.protocol.model.tasks.task import FREE_AFTER_S, Task, TaskState
from robrain.protocol.reasons import IdleReason, OfferRefusal, PositionLost, plain
from robrain.protocol.refusals import RefusalCode, most_refused
from robrain.protocol.table.standing_topics import COORDINATOR_REMOVE_ROBOT
from robrain.protocol.table.topics import (
    COORDINATOR_ALIVE,
    COORDINATOR_STATE,
    ROBOT_ALIVE,
    ROBOT_BALLOT,
    ROBOT_MAP,
    ROBOT_MAP_WHOLE,
    ROBOT_STATE,
    TASK_EVENT,
)
from robrain.protocol.wire.endpoint import Endpoint, Request, Serve

DECIDE_PERIOD_NS = to_ns(0.5)
SUMMARY_PERIOD_NS = to_ns(0.5)
LOOK_PERIOD_NS = to_ns(0.1)
"""Robots say how they are as often; in between, only what has come is worth a look at their tasks."""
PAUSE_NS = to_ns(FREE_AFTER_S)
"""Two steps that are so far apart are no silence of the robots: the coordinator stood still, or its clock was set."""
SHOWN_FRONTIERS = 64
RETOLD_TASKS = 256
"""Tasks whose last change is published again when a coordinator starts."""
NS_PER_MS = 1_000_000


class Coordinator:
    """Coordinates one team.

    Args:
        wire: the coordinator's place on the wire; its owner closes it.
        journal: where its tasks are written down, and from which it goes on; its owner closes it. None keeps them in
            memory.
        policy: what its plans are for, and how they are made.
        rules: by which it makes tasks from what is sensed.
        elected: the election that it has won, if robots of the team are witnesses.

    """

    def __init__(
        self,
        wire: Endpoint,
        journal: Journal | None = None,
        policy: PlanningPolicy | None = None,
        rules: Sequence[Rule] = (),
        elected: Elected | None = None,
    ) -> None:
        # Milliseconds: one that takes over later has a greater epoch, and numbers for its tasks that are unused.
        first_epoch = wire.clock.now_ns() // NS_PER_MS
        self.tasks = TaskBook(wire.clock, first_epoch, wire.publisher(TASK_EVENT).put, journal)
        at_robots = {record.robot: record.task.id for record in self.tasks.open if record.robot}
        self.roster = Roster(self.tasks.journal, at_robots, wire.clock.now_ns())
        self.stale = StaleWatch(self.roster)
        self.team_map = TeamMap()
        policy = policy or PlanningPolicy()
        self.explorer = Explorer(self.team_map, strategy_of(policy.exploration, self._record_strategy))
        self.capabilities = Capabilities(wire)
        self.lifecycle = TaskLifecycle(wire, self.tasks, self.roster, self.capabilities)
        lifecycle = self.lifecycle
        self.planning = lifecycle.reasons.planning = Planning(
            wire,
            self.tasks,
            self.roster,
            self.capabilities,
            lifecycle.backoff,
            self.team_map,
            policy,
            lifecycle.reasons.waits,
        )
        self._frontiers = FrontierDesk(
            self.explorer, self.team_map, self.tasks, self.roster, self.planning, lifecycle.backoff, wire.clock.now_ns()
        )
        lifecycle.on_refused = self._record_refusal
        self.motes = MoteDesk(wire, self.tasks, self.roster, lifecycle.reasons)
        self.mote_field = FieldKeeper(wire, self.tasks, policy.mote_field, self._new_id)
        self._following = PlanExecutor(self.planning, lifecycle, self.tasks)
        self._charge_desk = ChargeDesk(wire, self.planning, self.tasks, self.roster)
        self._together = Coalitions(self.planning, lifecycle, self.tasks, self.roster, self.team_map, self._new_id)
        self._wire = wire
        self._inbox = Inbox(capacity=16384)
        self._guard = RecordGuard(wire.refusals, (JournalUnwritable,))
        self._now_ns = wire.clock.now_ns()
        self._presence = wire.watch(ROBOT_ALIVE)
        wire.subscribe(self._inbox, ROBOT_STATE)
        wire.subscribe(self._inbox, ROBOT_MAP)
        wire.subscribe(self._inbox, ROBOT_BALLOT)
        self._backups = BackupDesk(wire, self.tasks.journal)
        wire.answer(COORDINATOR_REMOVE_ROBOT, self._remove_robot, serve=Serve.IN_STEP)
        self._own_tasks = max(first_epoch, self.tasks.journal.new_epoch(first_epoch))
        self.leadership = Leadership(wire, self.tasks, self.roster, self._own_tasks, elected, lifecycle.take_back)
        lifecycle.reasons.held_back = self.leadership.offer_refusal
        self.halts = HaltWatch(wire, self.roster)
        self.left = LeftDesk(wire, self.explorer, self.team_map, self.roster)
        self._summary = wire.publisher(COORDINATOR_STATE)
        wire.token(COORDINATOR_ALIVE)
        self._decide_due_ns = 0
        self._check_due_ns = 0
        self._summary_due_ns = 0
        reasons = lifecycle.reasons
        self._requests = TaskRequests(
            wire,
            self.tasks,
            self.team_map,
            self.capabilities,
            reasons.explain,
            DryRuns(self.tasks, self.roster, reasons),
            self.motes.table.quantities,
            self.planning.chargers.places,
            self.leadership,
        )
        self.rules: RuleDesk | None = None
        if rules:
            self.rules = RuleDesk(wire, rules, self.tasks, self.roster, self._requests, self._new_id)
        with self.lifecycle.as_far_as_written(wire.clock.now_ns()):
            self.tasks.fail_unreadable()
        self.tasks.republish(RETOLD_TASKS)

    def set_policy(self, policy: PlanningPolicy) -> None:
        """Plan and explore with other parameters from now on."""
        self.explorer.strategy = strategy_of(policy.exploration, self._record_strategy)
        self.planning.set_policy(policy, "the planning policy has changed")
        self.mote_field.set_policy(policy.mote_field)

    def step(self) -> None:
        """Hear, decide, act."""
        now_ns = self._wire.clock.now_ns()
        if now_ns - self._now_ns > PAUSE_NS:
            self.roster.restart_silence(now_ns - self._now_ns)
            self.lifecycle.restart_silence(now_ns)
        if self._wire.has_waiting:
            self._wire.serve()
        has_received = self._inbox.has_some
        self._receive(now_ns)
        stage = self._guard.stage
        if stage("answers", False, self.lifecycle.process_answers, now_ns):
            self._decide_due_ns = now_ns
        if stage("halts", True, self.halts.hear):
            self._summary_due_ns = now_ns
        if self.rules is not None and self.rules.has_some:
            stage("rules", None, self.rules.step, now_ns)
        if stage("leadership", True, self.leadership.step, now_ns):
            self._summary_due_ns = now_ns
        looks = has_received or self._requests.has_changed or now_ns >= self._check_due_ns
        if looks:
            self._check_due_ns = now_ns + LOOK_PERIOD_NS
            stage("fence", None, self.leadership.check_robots, now_ns)
            stage("tasks", None, self._look, now_ns)
            stage("robots", None, self.roster.write, now_ns)
        if stage("motes", False, self.motes.step, now_ns, self.lifecycle.as_far_as_written):
            self._decide_due_ns = now_ns
        field = self.mote_field
        if field.is_on and stage("mote field", False, field.step, now_ns, self.lifecycle.as_far_as_written):
            self._decide_due_ns = now_ns
        if stage("planning", False, self.planning.step, now_ns):
            self._decide_due_ns = now_ns
        if looks and self.leadership.leads(now_ns):
            stage("withdrawals", None, self.lifecycle.withdraw_strays, now_ns)
        if now_ns >= self._decide_due_ns:
            self._decide_due_ns = now_ns + DECIDE_PERIOD_NS
            self._hand_out(now_ns)
        if stage("deadlines", False, self.stale.look, now_ns):
            self._summary_due_ns = now_ns
        if now_ns >= self._summary_due_ns:
            self._summary_due_ns = now_ns + SUMMARY_PERIOD_NS
            stage("summary", None, self._publish_summary, now_ns)
        stage("stand-by", None, self.leadership.publish, now_ns)

    def _remove_robot(self, request: Request[RobotRemoval]) -> None:
        name = request.asked.robot
        self.roster.remove_gone(name, [record.task.id for record in self.tasks.bound_to(name)])
        self._summary_due_ns = 0

    def _new_id(self, kind: str) -> str:
        """An id for a task of the coordinator's own; whoever asked for a task may have named it alike."""
        while True:
            self._own_tasks += 1
            task_id = f"{kind}-{self._own_tasks}"
            if self.tasks.find(task_id) is None:
                return task_id

    def close(self) -> None:
        """End what runs beside `step`; the wire and the journal are their owners' to close."""
        self.planning.close()
        self._backups.close()
        self.leadership.close()

    # -- hearing --------------------------------------------------------------------------------------------

    def _receive(self, now_ns: int) -> None:
        gone = []
        for change in self._presence.changes() if self._presence.arrived else ():
            robot = self.roster.record_presence(change)
            if not change.present:
                gone.append(robot)
            if change.present:
                # It may have mapped before this coordinator came.
                self._wire.ask_into(self._inbox, ROBOT_MAP_WHOLE, ROBOT_MAP, robot=robot.name)
                self.capabilities.came(robot.name)
                self.planning.chargers.came(robot.name)
        if gone:
            self.leadership.record_gone(gone, now_ns)
        self._now_ns = now_ns
        if self._inbox.has_some:
            self._guard.messages(self._inbox.drain(), self._take)

    def _take(self, received: Received) -> None:
        now_ns = self._now_ns
        if received.topic is ROBOT_MAP:
            self._handle_patch(received)
            return
        if received.topic is ROBOT_BALLOT:
            if why := self.roster.why_unknown(received.message.robot, now_ns):
                self._wire.refusals.note(ROBOT_BALLOT.name, received.key, RefusalCode.UNKNOWN_SENDER, why)
                return
            self.roster.record_contact(
                received.message.robot, now_ns, hears_coordinator=received.message.hears_coordinator
            )
            if any(not self.tasks.is_possible(one.epoch) for one in (*received.message.held, *received.message.done)):
                why = "it reports an epoch that no coordinator gives out"
                self._wire.refusals.note(ROBOT_BALLOT.name, received.key, RefusalCode.NOT_PLAUSIBLE, why)
            self.lifecycle.held_elsewhere.hear(received.message, now_ns)
            is_secured, impossibility = self._wire.member is not None, self._requests.impossibility
            ahead_ns = clock_difference_ns(received.message.stamp_ns, now_ns)
            with self.lifecycle.as_far_as_written(now_ns):
                if take_in(self.tasks, received.message, impossibility, is_secured=is_secured, ahead_ns=ahead_ns):
                    self._decide_due_ns = now_ns
            return
        state: RobotState = received.message
        if why := self.roster.why_unknown(state.robot, now_ns):
            self._wire.refusals.note(ROBOT_STATE.name, received.key, RefusalCode.UNKNOWN_SENDER, why)
            return
        known = self.roster.robots.get(state.robot)
        before = known.state if known is not None else None
        self.planning.hear(before, state)
        self.roster.record_state(state, now_ns)
        self.halts.record_state(state)
        for status in (state.task_before, state.task):  # oldest first
            if status is not None:
                self._receive_task_status(state.robot, status, now_ns)
        self.planning.ends_soon(before, state, now_ns)

    def _handle_patch(self, received: Received) -> None:
        patch: MapPatch = received.message
        refusals = self._wire.refusals
        known = self.roster.robots.get(patch.robot)
        if known is None or not known.was_there:  # once its token appears, its whole map is queried
            refusals.note(ROBOT_MAP.name, received.key, RefusalCode.UNKNOWN_SENDER, f"{patch.robot} is not there")
            return
        if why := self.team_map.merge(patch, self._now_ns):
            refusals.note(ROBOT_MAP.name, received.key, RefusalCode.NOT_PLAUSIBLE, why)

    def _record_strategy(self, name: str, why: str) -> None:
        self._wire.refusals.record_failure("exploration_strategy", name, why)

    def merge_held_patches(self) -> None:
        """Merge the patches held back while the map's kernels were loading; hold none from now on."""
        for robot, why in self.team_map.release():
            key = ROBOT_MAP.key(self._wire.team, robot=robot)
            self._wire.refusals.note(ROBOT_MAP.name, key, RefusalCode.NOT_PLAUSIBLE, why)

    def _receive_task_status(self, robot: str, status: TaskStatus, now_ns: int) -> None:
        ended = self.lifecycle.hear(robot, status, now_ns)
        if ended is None:
            return
        if ended.task.kind == RECHARGE:
            self._charge_desk.ended(robot, status.state, now_ns)
        self._decide_due_ns = now_ns  # the next goal is there before the wheels stop
        self._frontiers.record_end(robot, ended.task, status, now_ns)
        if status.state is TaskState.FAILED:
            self.planning.blocked()

    def _record_refusal(self, record: TaskRecord, robot: str, refusal: OfferRefusal, now_ns: int) -> None:
        """A robot has refused a task of the coordinator's own."""
        if record.task.kind == RECHARGE:
            self._charge_desk.ended(robot, TaskState.FAILED, now_ns)
        elif record.task.kind == EXPLORE and not record.by and not isinstance(refusal, PositionLost):
            self._frontiers.record_refusal(robot, record.task, now_ns)

    # -- deciding -------------------------------------------------------------------------------------------

    def _look(self, now_ns: int) -> None:
        if self.capabilities.follow(self.roster.up(now_ns), now_ns):
            self._decide_due_ns = now_ns
        if self.lifecycle.settle(now_ns) or self._requests.has_changed:
            self._requests.has_changed = False
            self._decide_due_ns = now_ns

    def _hand_out(self, now_ns: int) -> None:
        mandate = self.leadership.mandate
        if mandate is not None and mandate.refusal(now_ns) is not None:
            return
        there = [] if self.halts.is_halted else self.roster.up(now_ns)
        up = [robot for robot in there if robot.state is not None and not robot.state.halted]
        stage = self._guard.stage
        if self.planning.is_on:
            stage("offers", None, self._offer_planned, now_ns)
        else:
            stage("dispatch", None, self.lifecycle.dispatch, self._idle(up), now_ns)
        with self.lifecycle.as_far_as_written(now_ns):
            if self.planning.is_on:
                stage("charging", None, self._send_to_charge, up, now_ns)
            stage("exploration", None, self._explore, up, now_ns)

    def _offer_planned(self, now_ns: int) -> None:
        self.lifecycle.publish_unfit(now_ns)
        if not self.halts.is_halted:
            if self._following.step(now_ns):
                self._decide_due_ns = now_ns
            self._together.step(now_ns)

    def _send_to_charge(self, up: list[Robot], now_ns: int) -> None:
        pauses = self.lifecycle.backoff.robots
        free = [robot for robot in self._idle(up) if not pauses.why(robot.name, now_ns)]
        for robot, charger, to_soc in self._charge_desk.choose(free, now_ns):
            name = self._new_id("recharge")
            wanted = Recharge(yaw_rad=charger.yaw_rad, until_soc=to_soc)
            task = Task(id=name, kind=RECHARGE, place=charger.place, parameters=wanted.json)
            self._offer_own(task, robot, now_ns)

    def _offer_own(self, task: Task, robot: str, now_ns: int, way_m: float = math.nan) -> None:
        self.tasks.add(task, own=True)
        known, planning = self.roster.robots.get(robot), self.planning
        decision = own_decision(
            task, known.state if known is not None else None, way_m, planning.number, planning.policy
        )
        if decision is not None:
            planning.publish_own(decision)
        self.lifecycle.offer(task.id, robot, now_ns)

    def _idle(self, robots: list[Robot]) -> list[Robot]:
        return [robot for robot in robots if self.tasks.of_robot(robot.name) is None]

    def _explore(self, up: list[Robot], now_ns: int) -> None:
        choices = self._frontiers.choose(up, self._idle(up), now_ns)
        self._charge_desk.lack_range = self._frontiers.lack_range

        def explore(choice: Choice) -> None:
            task = Task(id=self._new_id("explore"), kind=EXPLORE, place=choice.place)
            self._offer_own(task, choice.robot, now_ns, choice.way_m)

        self._guard.records(choices, explore, attrgetter("robot"), "frontier")

    # -- telling --------------------------------------------------------------------------------------------

    def _idle_reason(self, now_ns: int) -> dict[str, IdleReason]:
        """Why each idle robot that is up has no task."""
        known = self._frontiers.idle_reasons()
        idle = self._idle(self.roster.up(now_ns))
        if self.halts.is_halted:
            return {robot.name: plain("team_halted", "idle because the team is halted") for robot in idle}
        return {robot.name: known[robot.name] for robot in idle if robot.name in known}

    def _publish_summary(self, now_ns: int) -> None:
        frontiers = self.explorer.candidates[:SHOWN_FRONTIERS]
        has_ended = self._frontiers.is_settled(now_ns)
        self.roster.forget_unseen(now_ns)
        self._summary.put(
            TeamState(
                robots=self.roster.summaries(now_ns, self._idle_reason(now_ns)),
                known_area_m2=round(self.team_map.known_area_m2, 3),
                frontiers=[FrontierSummary(place=found.place, length_m=found.length_m) for found in frontiers],
                all_explored=has_ended,
                tasks_open=len(self.tasks.open),
                tasks_done=self.tasks.done_count,
                messages=self._inbox.received,
                halt=self.halts.status(now_ns),
                refused=most_refused(self._wire.refusals),
                stale=self.stale.found or UNSET,
                rules=UNSET if self.rules is None else self.rules.status(),
                mote_field=self.mote_field.state or UNSET,
                stand_by=self.leadership.stand_by(),
                unwritable=self.tasks.journal.failing or UNSET,
                lead=self.leadership.lead(now_ns),
                last_change=self.tasks.last_change,
            )
        )
        if has_ended:
            self._guard.stage("left", None, self.left.step, now_ns)
