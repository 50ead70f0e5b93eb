"""The coordinator: receives states, merges maps, assigns tasks, publishes the team's state."""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import msgspec
from msgspec import UNSET

from robrain.algorithms.exploration.strategies import NO_EXPLORATION
from robrain.coordinator.core.core import CoordinatorPart, Core, PartFactory
from robrain.coordinator.core.robot_reports import RobotReports
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.leadership.election import Elected
from robrain.coordinator.leadership.leadership import ElectedLeadership, Leadership
from robrain.coordinator.motes.mote_field import FieldKeeper
from robrain.coordinator.motes.mote_members import MoteMembers
from robrain.coordinator.parts.backups import Backups
from robrain.coordinator.parts.charging import Charging
from robrain.coordinator.parts.exploration import Exploration
from robrain.coordinator.parts.floor_publisher import FloorPublisher
from robrain.coordinator.parts.missions import Missions
from robrain.coordinator.parts.robot_service import RobotService
from robrain.coordinator.parts.zone_keeper import ZoneKeeper
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.rules.task_rules import TaskRules
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, COORDINATOR_STATE, TeamState
from robrain.protocol.model.rules.mission import Mission
from robrain.protocol.model.rules.rule import Rule
from robrain.protocol.model.tasks.task import FREE_AFTER_S
from robrain.protocol.reasons import IdleReason, plain
from robrain.protocol.refusals import most_refused
from robrain.protocol.wire.endpoint import Endpoint

if TYPE_CHECKING:  # loads kernels
    from robrain.algorithms.slam.floor_map import FloorMap

ASSIGN_PERIOD_NS = to_ns(0.5)
SUMMARY_PERIOD_NS = to_ns(0.5)
CHECK_PERIOD_NS = to_ns(0.1)
"""Robots publish their states at this period; in between, only messages and requests lead to a check of tasks."""
PAUSE_NS = to_ns(FREE_AFTER_S)
"""A longer gap between two steps is no silence of the robots: the coordinator was paused, or its clock was set."""
REPUBLISHED_TASKS = 256
"""Tasks whose last change is published again when a coordinator starts."""

P = TypeVar("P", bound=CoordinatorPart)


class Coordinator:
    """Coordinates one team.

    Args:
        wire: the coordinator's place on the wire; its owner closes it.
        journal: stores its tasks, and the state from which it continues; its owner closes it. None keeps them in
            memory.
        policy: parameters of planning.
        rules: by which it makes tasks from readings and events.
        elected: the election that it has won; None if it is alone.
        missions: those that can be started.
        floor: known before the run; the team then explores only if a task requests it.

    """

    def __init__(
        self,
        wire: Endpoint,
        journal: Journal | None = None,
        policy: PlanningPolicy | None = None,
        rules: Sequence[Rule] = (),
        elected: Elected | None = None,
        missions: Sequence[Mission] = (),
        floor: "FloorMap | None" = None,
    ) -> None:
        policy = policy or PlanningPolicy()
        if floor is not None:
            policy = msgspec.structs.replace(policy, exploration=NO_EXPLORATION)
        self.core = core = Core(wire, journal, policy, stock_parts(rules, elected, missions, floor))
        self.tasks, self.roster, self.team_map = core.tasks, core.roster, core.team_map
        self.planning, self.lifecycle, self.halts = core.planning, core.lifecycle, core.halts
        self._wire, self._stage = wire, core.guard.stage
        self.refusals = wire.refusals
        self._now_ns = wire.clock.now_ns()
        self._reports = RobotReports(core)
        self.merge_held_patches = self._reports.merge_held_patches
        self._summary = wire.publisher(COORDINATOR_STATE)
        wire.token(COORDINATOR_ALIVE)
        self._check_due_ns = 0
        with self.lifecycle.as_far_as_written(self._now_ns):
            self.tasks.fail_unreadable()
        self.tasks.republish(REPUBLISHED_TASKS)

    @property
    def end_reason(self) -> str:
        """Why it must end, as text; empty if it may continue."""
        return self.core.parts.end_reason

    def part(self, kind: type[P]) -> P:
        """Its part of a class (KeyError if there is none)."""
        return self.core.parts.find(kind)

    def set_policy(self, policy: PlanningPolicy) -> None:
        """Plan and explore with other parameters from now on."""
        self.planning.set_policy(policy, "the planning policy has changed")
        for part in self.core.parts.overriding["policy_changed"]:
            part.policy_changed(policy)

    def step(self) -> None:
        """Receive, decide, act, publish."""
        now_ns = self._wire.clock.now_ns()
        if now_ns - self._now_ns > PAUSE_NS:
            self.roster.restart_silence(now_ns - self._now_ns)
            self.lifecycle.restart_silence(now_ns)
        self._now_ns = now_ns
        has_received = self._receive(now_ns)
        has_checked = self._decide(now_ns, has_received=has_received)
        self._act(now_ns, has_checked=has_checked)
        self._publish(now_ns)

    def close(self) -> None:
        """End all activity beside `step`; the owners of the wire and the journal close them."""
        self.core.close()

    def _receive(self, now_ns: int) -> bool:
        core, stage = self.core, self._stage
        if self._wire.has_waiting:
            self._wire.serve()
        has_received = self._reports.receive(now_ns)
        if stage("answers", False, self.lifecycle.process_answers, now_ns):
            core.assign_soon()
        if stage("halts", True, self.halts.receive):
            core.report_soon()
        for part in core.parts.receiving:
            if part.inbox.has_some:
                stage(type(part).__name__, None, part.receive, now_ns)
        return has_received

    def _decide(self, now_ns: int, *, has_received: bool) -> bool:
        core, stage = self.core, self._stage
        has_checked = has_received or core.requests.has_changed or now_ns >= self._check_due_ns
        if has_checked:
            self._check_due_ns = now_ns + CHECK_PERIOD_NS
            for part in core.parts.overriding["check"]:
                stage(type(part).__name__, None, part.check, now_ns)
            stage("tasks", None, self._check_tasks, now_ns)
            stage("robots", None, self.roster.write, now_ns)
        for part in core.parts.overriding["decide"]:
            stage(type(part).__name__, None, part.decide, now_ns)
        if stage("planning", False, self.planning.step, now_ns):
            core.assign_soon()
        return has_checked

    def _check_tasks(self, now_ns: int) -> None:
        core = self.core
        if core.capabilities.follow(self.roster.up(now_ns), now_ns):
            core.assign_soon()
        if self.lifecycle.settle(now_ns) or core.requests.has_changed:
            core.requests.has_changed = False
            core.assign_soon()

    def _act(self, now_ns: int, *, has_checked: bool) -> None:
        core, stage = self.core, self._stage
        is_due = now_ns >= core.assign_due_ns
        if not (has_checked or is_due) or not core.parts.may_act(now_ns):
            return
        if has_checked:
            stage("withdrawals", None, self.lifecycle.withdraw_strays, now_ns)
        if not is_due:
            return
        core.assign_due_ns = now_ns + ASSIGN_PERIOD_NS
        there = [] if self.halts.is_halted else self.roster.up(now_ns)
        robots = [robot for robot in there if robot.state and not robot.state.halted and not robot.out_of_service]
        if stage("offers", False, core.executor.step, core.idle(robots), now_ns, is_halted=self.halts.is_halted):
            core.assign_soon()
        with self.lifecycle.as_far_as_written(now_ns):
            for part in core.parts.overriding["assign"]:
                stage(type(part).__name__, None, part.assign, robots, now_ns)

    def _publish(self, now_ns: int) -> None:
        core, stage = self.core, self._stage
        if stage("deadlines", False, core.stale.check, now_ns):
            core.report_soon()
        if now_ns >= core.summary_due_ns:
            core.summary_due_ns = now_ns + SUMMARY_PERIOD_NS
            stage("summary", None, self._publish_summary, now_ns)
        for part in core.parts.overriding["publish"]:
            stage(type(part).__name__, None, part.publish, now_ns)

    def _publish_summary(self, now_ns: int) -> None:
        core = self.core
        self.roster.forget_unseen(now_ns)
        state = TeamState(
            robots=self.roster.summaries(now_ns, self._idle_reasons(now_ns)),
            known_area_m2=round(self.team_map.known_area_m2, 3),
            tasks_open=len(self.tasks.open),
            tasks_done=self.tasks.done_count,
            messages=self._reports.received,
            halt=self.halts.status(now_ns),
            refused=most_refused(self.refusals),
            stale=core.stale.found or UNSET,
            unwritable=self.tasks.journal.failing or UNSET,
            last_change=self.tasks.last_change,
        )
        for part in core.parts.overriding["summary"]:
            state = part.summary(state, now_ns)
        self._summary.put(state)
        for part in core.parts.overriding["reported"]:
            self._stage(type(part).__name__, None, part.reported, now_ns)

    def _idle_reasons(self, now_ns: int) -> dict[str, IdleReason]:
        """Why each robot that is up and idle has no task."""
        known, idle = self.core.parts.idle_reasons(), self.core.idle(self.roster.up(now_ns))
        if self.halts.is_halted:
            return {robot.name: plain("team_halted", "idle because the team is halted") for robot in idle}
        return {robot.name: known[robot.name] for robot in idle if robot.name in known}


def stock_parts(
    rules: Sequence[Rule] = (),
    elected: Elected | None = None,
    missions: Sequence[Mission] = (),
    floor: "FloorMap | None" = None,
) -> list[PartFactory]:
    """Robrain's parts, in the order in which they are called; entry points of other distributions add theirs."""
    return [
        partial(Missions, missions=missions),
        partial(TaskRules, rules=rules),
        MoteMembers,
        FieldKeeper,
        *(() if floor is None else (partial(FloorPublisher, floor=floor),)),
        ZoneKeeper,
        RobotService,
        Charging,
        Exploration,
        Backups,
        Leadership if elected is None else partial(ElectedLeadership, elected=elected),
    ]
