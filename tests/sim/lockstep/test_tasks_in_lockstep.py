"""Tasks that somebody asks for, in lockstep: simulated robots do them, and equal seeds give equal runs."""

from typing import NamedTuple

import pytest

from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.sim.scenarios.scenario import Scenario

TASKS = [
    Task(id="a", kind="visit", place=Point2D(2.0, 1.0)),
    Task(id="b", kind="visit", place=Point2D(4.2, 3.0), after=("a",)),
]
LONGEST_S = 90.0


class Outcome(NamedTuple):
    records: list[TaskRecord]
    digest: str


def outcome(seed: int) -> Outcome:
    with Scenario.builtin("arena_small").replace(robots=2, motes=0).team(seed=seed, by="test") as team:
        team.run_for(1.0)
        records = team.wait_all([team.submit(task, deadline_s=LONGEST_S) for task in TASKS])
    assert team.transport.summary is not None
    return Outcome(records, team.transport.summary.digest)


@pytest.fixture(scope="module")
def first() -> Outcome:
    return outcome(3)


def test_simulated_robots_do_what_is_asked_for_in_order(first: Outcome) -> None:
    assert [record.state for record in first.records] == [TaskState.DONE, TaskState.DONE]
    one, other = first.records
    assert one.changed_ns < other.changed_ns
    assert all(record.result["off_m"] < 0.5 for record in first.records)


@pytest.mark.slow
def test_equal_seeds_give_equal_runs_with_tasks_too(first: Outcome) -> None:
    assert outcome(3) == first
