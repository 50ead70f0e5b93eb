"""Deciding again: the plans of a recorded run, made anew from what they were made from."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec

from robrain.coordinator.planning.plan_passes import STOCK_PASSES
from robrain.coordinator.planning.plan_search import solve
from robrain.coordinator.planning.problem_codec import decode
from robrain.coordinator.recording.reader.reading import read_messages
from robrain.protocol.wire.messages.plan_messages import PlanProblem
from robrain.protocol.wire.topics import TASK_PROBLEM

Routes = tuple[tuple[str, tuple[str, ...]], ...]


class ReplayedPlan(NamedTuple):
    """One plan of the recording, and what comes of it now."""

    recorded: PlanProblem
    routes: Routes
    """As they are planned now."""

    @property
    def is_same(self) -> bool:
        """Whether the same was decided."""
        return self.routes == self.recorded.routes


def plan_again(problem: PlanProblem) -> Routes:
    """The routes that the allocator makes of a written problem (ValueError if it is none)."""
    plan, _ = solve(
        decode(problem.question).problem(),
        problem.objective,
        problem.method,
        seed=problem.seed,
        rounds=problem.rounds,
        iterations=problem.iterations,
        gain_min=problem.gain_min,
        orders=dict(problem.warm_start),
        passes=STOCK_PASSES if problem.passes is None else problem.passes,
    )
    return tuple((route.worker, route.jobs) for route in plan.routes if route.stops)


def replay_decisions(recording: Path) -> Iterator[ReplayedPlan]:
    """Each plan of a recording, made again.

    Equal versions of the allocators' libraries give equal plans; others may decide otherwise where two plans are as
    good as each other.

    Raises:
        RecordingError: there is no such file, it is no recording, or it is damaged.

    """
    decoder = msgspec.json.Decoder(PlanProblem)
    for message in read_messages(recording):
        if TASK_PROBLEM.parse(message.topic_key) is not None:
            recorded = decoder.decode(message.payload)
            yield ReplayedPlan(recorded, plan_again(recorded))
