"""The core that the parts of a coordinator share (team, tasks, plans), and the base class of the parts."""

import logging
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, TypeVar

import msgspec

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.planning.coalition import Coalitions
from robrain.coordinator.planning.plan_executor import PlanExecutor
from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.task_explanation import TaskExplainer
from robrain.coordinator.planning.task_requests import TaskRequests
from robrain.coordinator.tasks.task_book import NS_PER_MS, TaskBook
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.team.capabilities import Capabilities
from robrain.coordinator.team.halts import TeamHalts
from robrain.coordinator.team.roster import Robot, Roster, StaleTopics
from robrain.coordinator.team.team_map import TeamMap
from robrain.protocol.border.border import Received
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT
from robrain.protocol.messages.tasks.task_messages import RobotVerdict, TaskRecord
from robrain.protocol.messages.team.standing_messages import COORDINATOR_REMOVE_ROBOT, JournalAlarm, RobotRemoval
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.reasons import IdleReason, OfferRefusal, TaskReason
from robrain.protocol.registry import Registry
from robrain.protocol.topic import Topic
from robrain.protocol.wire.endpoint import Endpoint, Request, Serve

logger = logging.getLogger(__name__)

S = TypeVar("S", bound=msgspec.Struct)


class CoordinatorPart:
    """Part of a coordinator that one feature adds. Methods that a part does not override cost nothing.

    Args:
        core: the team, its tasks and plans.

    """

    inbox_max: ClassVar[int] = 1024
    """Messages that wait for a step at most; of more the oldest are dropped."""
    end_reason = ""
    """Why the coordinator must end, as text; empty if it may continue."""

    def __init__(self, core: "Core") -> None:
        self.core = core
        self.inbox = Inbox(capacity=self.inbox_max)
        self._guard = RecordGuard(core.wire.refusals)

    def subscribe(self, topic: Topic[Any], **names: str) -> None:
        """Have `handle` called with each message of a topic.

        Args:
            topic: which.
            names: names in the key; those that are not given match any.

        """
        self.core.wire.subscribe(self.inbox, topic, **names)
        if self not in self.core.parts.receiving:
            self.core.parts.receiving.append(self)

    # -- a step, in this order ------------------------------------------------------------------------------

    def receive(self, now_ns: int) -> None:
        """Handle the messages that have arrived."""
        self._guard.messages(self.inbox.drain(), partial(self.handle, now_ns=now_ns))

    def handle(self, received: Received, now_ns: int) -> None:
        """Handle one message."""

    def check(self, now_ns: int) -> None:
        """Look at the robots before their tasks are: when something has arrived, and at 10 Hz."""

    def decide(self, now_ns: int) -> None:
        """Make or change tasks, in each step; `core.assign_soon()` if robots may get others now."""

    def assign(self, robots: Sequence[Robot], now_ns: int) -> None:
        """Give robots tasks of the coordinator's own, after the plan's: every 0.5 s, and after changes.

        Args:
            robots: those that are up, in service and not halted.
            now_ns: the time.

        """

    def summary(self, state: TeamState, now_ns: int) -> TeamState:
        """Add its share to the summary."""
        return state

    def reported(self, now_ns: int) -> None:
        """The summary has been published."""

    def publish(self, now_ns: int) -> None:
        """Publish the changes of the step."""

    def close(self) -> None:
        """The coordinator ends."""

    # -- what it stores --------------------------------------------------------------------------------------

    def stored(self, kind: type[S]) -> S:
        """The state that this part has stored in the journal; a new one if there is none, or it cannot be read."""
        name = type(self).__name__
        try:
            return msgspec.convert(self.core.tasks.journal.part_states.get(name, {}), kind)
        except msgspec.ValidationError as error:
            logger.warning("the state of %s in the journal cannot be read: %s", name, error)
            return kind()

    def store(self, state: msgspec.Struct, alarm: JournalAlarm | None = None) -> None:
        """Store this part's state in the journal, in place of its last one (JournalUnwritable).

        Args:
            state: its state.
            alarm: source for which a rule has changed it, in the same transaction.

        """
        self.core.tasks.journal.record_part_state(type(self).__name__, state, alarm)

    # -- questions ------------------------------------------------------------------------------------------

    def may_act(self, now_ns: int) -> bool:
        """Whether the coordinator may offer and withdraw tasks."""
        return True

    def offer_refusal(self) -> TaskReason | None:
        """Why no submitted task is offered; None if tasks are."""
        return None

    def request_refusal(self) -> str:
        """Why no task is accepted or cancelled, in words; empty if tasks are."""
        return ""

    def when_kept(self, on_kept: Callable[[], None], on_lost: Callable[[str], None]) -> None:
        """Call `on_kept` once all changes up to now are kept wherever this part needs them, else `on_lost`."""
        on_kept()

    def verdicts(self, record: TaskRecord, now_ns: int) -> list[RobotVerdict]:
        """How members of the team that are no robots stand to a task."""
        return []

    def idle_reasons(self) -> Mapping[str, IdleReason]:
        """Why robots without a task have none, by name."""
        return {}

    def mote_quantities(self) -> Mapping[str, str]:
        """All known motes, each with the quantity that it senses."""
        return {}

    # -- events ---------------------------------------------------------------------------------------------

    def policy_changed(self, policy: PlanningPolicy) -> None:
        """Plans are made with other parameters."""

    def robots_gone(self, robots: Sequence[Robot], now_ns: int) -> None:
        """The tokens of robots have gone."""

    def task_ended(self, record: TaskRecord, robot: str, status: TaskStatus, now_ns: int) -> None:
        """A robot's task has ended; `record` is from before."""

    def task_refused(self, record: TaskRecord, robot: str, refusal: OfferRefusal, now_ns: int) -> None:
        """A robot has refused one of the coordinator's own tasks."""


P = TypeVar("P", bound=CoordinatorPart)
PartFactory = Callable[["Core"], CoordinatorPart]
COORDINATOR_PARTS: Registry[PartFactory] = Registry("coordinator part", "robrain.coordinator_parts", {})
"""The parts of other distributions by name."""


class Parts:
    """All parts of one coordinator, in the order in which they are called."""

    def __init__(self) -> None:
        self.all: list[CoordinatorPart] = []
        self.receiving: list[CoordinatorPart] = []
        """Those with subscriptions."""
        self.overriding: defaultdict[str, list[CoordinatorPart]] = defaultdict(list)
        """The parts that override each method of `CoordinatorPart`."""

    def build(self, factories: Sequence[PartFactory], core: "Core") -> None:
        """Make the stock parts, then those of other distributions, whose failure is counted."""
        for make in factories:
            self.all.append(make(core))
        for name, make in COORDINATOR_PARTS.entries().items():
            part = core.guard.stage(f"coordinator part {name}", None, make, core)
            self.all += [] if part is None else [part]
        for name, method in vars(CoordinatorPart).items():
            self.overriding[name] = [part for part in self.all if getattr(type(part), name) is not method]

    def find(self, kind: type[P]) -> P:
        """The part of a class (KeyError if there is none)."""
        for part in self.all:
            if isinstance(part, kind):
                return part
        raise KeyError(kind.__name__)

    @property
    def end_reason(self) -> str:
        """Why the coordinator must end, as text; empty if it may continue."""
        return next((part.end_reason for part in self.all if part.end_reason), "")

    def may_act(self, now_ns: int) -> bool:
        """Whether all parts agree that tasks are offered and withdrawn."""
        return all(part.may_act(now_ns) for part in self.overriding["may_act"])

    def offer_refusal(self) -> TaskReason | None:
        """Why no submitted task is offered; None if tasks are."""
        for part in self.overriding["offer_refusal"]:
            if (refusal := part.offer_refusal()) is not None:
                return refusal
        return None

    def request_refusal(self) -> str:
        """Why no task is accepted or cancelled, in words; empty if tasks are."""
        refusals = (part.request_refusal() for part in self.overriding["request_refusal"])
        return next((refusal for refusal in refusals if refusal), "")

    def when_kept(self, on_kept: Callable[[], None], on_lost: Callable[[str], None]) -> None:
        """Call `on_kept` once all changes up to now are kept wherever the parts need them, else `on_lost`."""
        for part in self.overriding["when_kept"]:
            on_kept = partial(part.when_kept, on_kept, on_lost)
        on_kept()

    def verdicts(self, record: TaskRecord, now_ns: int) -> list[RobotVerdict]:
        """How members of the team that are no robots stand to a task."""
        return [verdict for part in self.overriding["verdicts"] for verdict in part.verdicts(record, now_ns)]

    def idle_reasons(self) -> dict[str, IdleReason]:
        """Why robots without a task have none, by name."""
        parts = self.overriding["idle_reasons"]
        return {name: reason for part in parts for name, reason in part.idle_reasons().items()}

    def mote_quantities(self) -> dict[str, str]:
        """All known motes, each with the quantity that it senses."""
        parts = self.overriding["mote_quantities"]
        return {mote: quantity for part in parts for mote, quantity in part.mote_quantities().items()}

    def task_refused(self, record: TaskRecord, robot: str, refusal: OfferRefusal, now_ns: int) -> None:
        """A robot has refused one of the coordinator's own tasks."""
        for part in self.overriding["task_refused"]:
            part.task_refused(record, robot, refusal, now_ns)


class Core:
    """The shared state of one coordinator.

    Args:
        wire: its Zenoh endpoint.
        journal: stores its tasks; None keeps them in memory.
        policy: parameters of planning.
        parts: parts that features add, in the order in which they are called.

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
        self.lifecycle = TaskLifecycle(wire, self.tasks, self.roster, self.capabilities, self.parts, self.team_map)
        self.planning = Planning(self.lifecycle, policy)
        self.explanation = TaskExplainer(self.lifecycle, self.planning)
        coalitions = Coalitions(self.planning, self.lifecycle, self.new_id)
        self.executor = PlanExecutor(self.planning, self.lifecycle, self.explanation, coalitions)
        self.requests = TaskRequests(self.lifecycle, self.explanation, self.planning.chargers)
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

    def offer_own(self, task: Task, robot: str, now_ns: int) -> None:
        """Offer a task of the coordinator's own, with a new id, to a robot."""
        self.tasks.add(task, own=True)
        self.lifecycle.offer(task.id, robot, now_ns)

    def close(self) -> None:
        """End all activity beside the coordinator's loop."""
        self.planning.close()
        for part in self.parts.overriding["close"]:
            part.close()

    def _remove_robot(self, request: Request[RobotRemoval]) -> None:
        name = request.asked.robot
        self.roster.remove_gone(name, [record.task.id for record in self.tasks.bound_to(name)])
        self.report_soon()
