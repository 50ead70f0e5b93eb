"""From a situation to a plan: first the auction's, then better ones for as long as the caller asks for more."""

import logging
from collections.abc import Iterator

import msgspec

from robrain.coordinator.planning.path_lengths import Ways
from robrain.coordinator.planning.plan_in_force import Planned, planned
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.problem_builder import Asked, ask, greatest_radius_m, needed_m
from robrain.coordinator.planning.snapshot import Situation
from robrain.coordinator.planning.solver import Thinking
from robrain.protocol.model.navigation.clearance import mapped_clearance_m
from robrain.protocol.model.ranges import cut
from robrain.protocol.wire.messages.plan_messages import PlanProblem
from robrain.protocol.wire.reasons.tasks import CannotBePlanned, TaskReason

logger = logging.getLogger(__name__)


class Drafting:
    """Turns situations into plans, the auction's first; caches path lengths until the floor changes."""

    def __init__(self) -> None:
        self._ways: Ways | None = None

    def draft(self, situation: Situation, policy: PlanningPolicy) -> "Draft":
        """Start a plan; tasks that cannot be planned are set aside, each with its reason.

        Re-raises the planner's error if it is not due to single tasks.
        """
        try:
            return self._draft(situation, policy)
        except Exception:
            # The figures come from outside and the solver may raise anything; one bad task must not block all others.
            logger.exception("no plan %d can be made; looking for the tasks that prevent it", situation.number)
            wrong = self._find_wrong(situation, policy)
            if not wrong:
                raise
        sound = tuple(record for record in situation.records if record.task.id not in wrong)
        draft = self._draft(msgspec.structs.replace(situation, records=sound), policy)
        draft.asked.waiting.update(wrong)
        return draft

    def _find_wrong(self, situation: Situation, policy: PlanningPolicy) -> dict[str, TaskReason]:
        wrong: dict[str, TaskReason] = {}
        for record in situation.records:
            alone = msgspec.structs.replace(situation, records=(record,), orders={})
            try:
                self._draft(alone, policy)
            except Exception as error:  # see `draft`
                logger.exception("task %s cannot be planned", record.task.id)
                wrong[record.task.id] = CannotBePlanned(cut(f"{type(error).__name__}: {error}"))
        return wrong

    def _draft(self, situation: Situation, policy: PlanningPolicy) -> "Draft":
        needed = needed_m(situation)
        version = 0 if situation.floor is None else situation.floor.version
        ways = self._ways
        if ways is None or (ways.version, ways.needed_m, ways.unknown_cost) != (version, needed, policy.unknown_cost):
            floor, radius_m = situation.floor, greatest_radius_m(situation)
            narrow_m = None if floor is None else mapped_clearance_m(radius_m, floor.geometry.resolution_m)
            ways = self._ways = Ways(floor, needed, policy.unknown_cost, narrow_m)
        return Draft(situation, policy, ask(situation, ways, policy))


class Draft:
    """One plan in the making."""

    def __init__(self, situation: Situation, policy: PlanningPolicy, asked: Asked) -> None:
        self._situation = situation
        self._policy = policy
        self.asked = asked
        self._problem = asked.question.problem()
        visits = sum(job.robots for job in self._problem.jobs if not job.pinned_to)
        self._iterations = policy.iterations_for(visits)
        self.thinking = Thinking(
            self._problem,
            policy.objective,
            policy.method,
            seed=policy.seed,
            iterations=self._iterations,
            gain_min=policy.gain_min,
            orders=situation.orders,
        )

    def improve(self) -> Iterator[None]:
        """Yields before each search."""
        return self.thinking.improve()

    def planned(self, took_s: float = 0.0) -> Planned:
        """The plan as it is so far."""
        situation, policy = self._situation, self._policy
        plan = self.thinking.plan
        written = PlanProblem(
            plan=situation.number,
            asked_ns=situation.now_ns,
            objective=policy.objective,
            method=policy.method,
            seed=policy.seed,
            rounds=self.thinking.rounds,
            iterations=self._iterations,
            gain_min=policy.gain_min,
            question=self.asked.question.encode(),
            warm_start=tuple(situation.orders.items()),
            routes=tuple((route.worker, route.jobs) for route in plan.routes if route.stops),
            cause=situation.cause,
        )
        return planned(situation, self.asked, self.thinking.problem, plan, written, took_s)
