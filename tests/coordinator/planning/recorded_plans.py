"""Computes the plans of a recorded run again, from their recorded inputs."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec

from robrain.coordinator.planning.plan_passes import STOCK_PASSES
from robrain.coordinator.planning.plan_search import PlanSolver
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.problem_codec import decode
from robrain.protocol.messages.tasks.plan_messages import TASK_PROBLEM, PlanProblem
from robrain.recording.reader.reading import read_messages

Routes = tuple[tuple[str, tuple[str, ...]], ...]


class ReplayedPlan(NamedTuple):
    """One plan of the recording, and the plan that is computed now."""

    recorded: PlanProblem
    routes: Routes
    """The routes computed now."""

    @property
    def is_same(self) -> bool:
        """Whether both plans are the same."""
        return self.routes == self.recorded.routes


def plan_again(problem: PlanProblem) -> Routes:
    """Compute the routes of a recorded problem (ValueError if it is invalid)."""
    policy = PlanningPolicy(
        objective=problem.objective,
        method=problem.method,
        seed=problem.seed,
        gain_min=problem.gain_min,
        passes=STOCK_PASSES if problem.passes is None else tuple(problem.passes),
    )
    solver = PlanSolver(decode(problem.question).problem(), policy, dict(problem.warm_start), problem.iterations)
    solver.run(problem.rounds)
    return tuple((route.worker, route.jobs) for route in solver.plan.routes if route.stops)


def replay_decisions(recording: Path) -> Iterator[ReplayedPlan]:
    """Compute each plan of a recording again."""
    decoder = msgspec.json.Decoder(PlanProblem)
    for message in read_messages(recording):
        if TASK_PROBLEM.parse(message.topic_key) is not None:
            recorded = decoder.decode(message.payload)
            yield ReplayedPlan(recorded, plan_again(recorded))
