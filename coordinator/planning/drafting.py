"""From a situation to a plan: the auction's first, then better ones as long as somebody asks for more."""

from collections.abc import Iterator

from robrain.coordinator.planning.asking import Asked, ask, needed_m
from robrain.coordinator.planning.planned import Planned, planned
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.situation import Situation
from robrain.coordinator.planning.thinking import Thinking
from robrain.coordinator.planning.ways import Ways
from robrain.protocol.wire.plan_messages import PlanProblem


class Drafting:
    """Turns situations into plans, the auction's first; keeps the ways of the floor for as long as that is the same."""

    def __init__(self) -> None:
        self._ways: Ways | None = None

    def draft(self, situation: Situation, policy: PlanningPolicy) -> "Draft":
        """A plan in the making."""
        needed = needed_m(situation)
        version = 0 if situation.floor is None else situation.floor.version
        ways = self._ways
        if ways is None or (ways.version, ways.needed_m, ways.unknown_cost) != (version, needed, policy.unknown_cost):
            ways = self._ways = Ways(situation.floor, needed, policy.unknown_cost)
        return Draft(situation, policy, ask(situation, ways, policy))


class Draft:
    """One plan in the making."""

    def __init__(self, situation: Situation, policy: PlanningPolicy, asked: Asked) -> None:
        self._situation = situation
        self._policy = policy
        self._asked = asked
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
            question=self._asked.question.encode(),
            warm_start=tuple(situation.orders.items()),
            routes=tuple((route.worker, route.jobs) for route in plan.routes if route.stops),
            cause=situation.cause,
        )
        return planned(situation, self._asked, self.thinking.problem, plan, written, took_s)
