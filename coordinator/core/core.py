"""The team, its tasks and plans: what the parts of a coordinator share."""

import math
from collections.abc import Sequence

from robrain.coordinator.core.part import PartFactory, Parts
from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.planning.coalition import Coalitions
from robrain.coordinator.planning.dry_run import DryRuns
from robrain.coordinator.planning.own_decisions import own_decision
from robrain.coordinator.planning.plan_executor import PlanExecutor
from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.task_explanation import TaskExplanation
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.tasks.task_requests import TaskRequests
from robrain.coordinator.team.capabilities import Capabilities
from robrain.coordinator.team.halts import TeamHalts
from robrain.coordinator.team.roster import Robot, Roster
from robrain.coordinator.team.stale_topics import StaleTopics
from robrain.coordinator.team.team_map import TeamMap
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.messages.team.standing_messages import RobotRemoval
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.table.standing_topics import COORDINATOR_REMOVE_ROBOT
from robrain.protocol.table.topics import TASK_EVENT
from robrain.protocol.wire.endpoint import Endpoint, Request, Serve

NS_PER_MS = 1_000_000


class Core:
    """The shared state of one coordinator.

    Args:
        wire: its Zenoh endpoint.
        journal: stores its tasks; None keeps them in memory.
        policy: parameters of planning.
        parts: what features add, in the order in which they are called.

    """

    def __init__(
        self, wire: Endpoint, journal: Journal | None, policy: PlanningPolicy, parts: Sequence[PartFactory]
    ) -> None:
        self.wire = wire
        self.guard = RecordGuard(wire.refusals, (JournalUnwritable,))
        self.parts = Parts()
        # Milliseconds: one that takes over later has a greater epoch, and numbers for its tasks that are unused.
        first_epoch = wire.clock.now_ns() // NS_PER_MS
        self.tasks = TaskBook(wire.clock, first_epoch, wire.publisher(TASK_EVENT).put, journal)
        at_robots = {record.robot: record.task.id for record in self.tasks.open if record.robot}
        self.roster = Roster(self.tasks.journal, at_robots, wire.clock.now_ns())
        self.stale = StaleTopics(self.roster)
        self.halts = TeamHalts(wire, self.roster)
        self.team_map = TeamMap()
        self.capabilities = Capabilities(wire)
        self.lifecycle = TaskLifecycle(wire, self.tasks, self.roster, self.capabilities, self.parts)
        backoff, eligibility = self.lifecycle.backoff, self.lifecycle.eligibility
        self.planning = Planning(
            wire,
            self.tasks,
            self.roster,
            self.capabilities,
            backoff,
            self.team_map,
            policy,
            eligibility.wait_reason,
        )
        self.explanation = TaskExplanation(
            self.tasks, self.roster, backoff, eligibility, self.planning, self.parts.verdicts
        )
        coalitions = Coalitions(
            self.planning,
            self.lifecycle,
            self.explanation,
            self.tasks,
            self.roster,
            self.team_map,
            self.new_id,
        )
        self.executor = PlanExecutor(
            self.planning, self.lifecycle, self.tasks, self.roster, self.explanation, coalitions
        )
        self.requests = TaskRequests(
            wire,
            self.tasks,
            self.team_map,
            self.capabilities,
            self.explanation.explain,
            DryRuns(self.tasks, self.roster, eligibility, self.explanation).of,
            self.parts.mote_quantities,
            self.planning.chargers.places,
            self.parts,
        )
        self.term = max(first_epoch, self.tasks.journal.new_epoch(first_epoch))
        """The first epoch of this coordinator."""
        self._own_tasks = self.term
        self.assign_due_ns = self.summary_due_ns = 0
        wire.answer(COORDINATOR_REMOVE_ROBOT, self._remove_robot, serve=Serve.IN_STEP)
        self.parts.build(parts, self)

    def assign_soon(self) -> None:
        """Give robots tasks in this step, or the next."""
        self.assign_due_ns = 0

    def report_soon(self) -> None:
        """Publish the summary in this step, or the next."""
        self.summary_due_ns = 0

    def new_id(self, kind: str) -> str:
        """An unused id for a task of the coordinator's own."""
        while True:
            self._own_tasks += 1
            task_id = f"{kind}-{self._own_tasks}"
            if self.tasks.find(task_id) is None:
                return task_id

    def idle(self, robots: Sequence[Robot]) -> list[Robot]:
        """The robots without a task."""
        return [robot for robot in robots if self.tasks.of_robot(robot.name) is None]

    def offer_own(self, task: Task, robot: str, now_ns: int, path_length_m: float = math.nan) -> None:
        """Offer a task of the coordinator's own, and publish what it will cost.

        Args:
            task: with a new id.
            robot: which gets it.
            now_ns: the time.
            path_length_m: to its place; nan if unknown.

        """
        self.tasks.add(task, own=True)
        known, planning = self.roster.robots.get(robot), self.planning
        state = known.state if known is not None else None
        decision = own_decision(task, state, path_length_m, planning.number, planning.policy)
        if decision is not None:
            planning.publish_own(decision)
        self.lifecycle.offer(task.id, robot, now_ns)

    def close(self) -> None:
        """End what runs beside the coordinator's loop."""
        self.planning.close()
        self.parts.close()

    def _remove_robot(self, request: Request[RobotRemoval]) -> None:
        name = request.asked.robot
        self.roster.remove_gone(name, [record.task.id for record in self.tasks.bound_to(name)])
        self.report_soon()
