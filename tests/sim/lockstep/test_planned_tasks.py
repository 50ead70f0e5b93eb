"""A dozen tasks in a floor with walls, planned and done by simulated robots.

`make bench ARGS=planning` compares what they take with nearest first.
"""

from pathlib import Path

import pytest

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.recorded_plans import replay_decisions
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.scenarios.scenario import Scenario
from tests.bench.planning import TASKS, Outcome, run_tasks

FLOOR, SEED = "arena_small", 3


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("planned") / "run.mcap"


@pytest.fixture(scope="module")
def planned(recording: Path) -> Outcome:
    return run_tasks(SEED, PlanningPolicy(), FLOOR, recording)


@pytest.mark.slow
def test_the_recorded_run_decides_the_same_again(planned: Outcome, recording: Path) -> None:
    plans = list(replay_decisions(recording))
    assert planned.done == TASKS
    assert len(plans) >= TASKS / 3
    assert all(plan.is_same for plan in plans)


@pytest.mark.slow
def test_simulated_robots_do_a_task_together() -> None:
    with Scenario.builtin(FLOOR).replace(robots=2, motes=0).team(seed=5) as team:
        team.run_for(12.0)
        lift = team.submit("visit", place=(2.0, 2.6), robots=2, service_s=3.0)
        record = team.wait(lift, timeout_s=108.0)
    assert record.state is TaskState.DONE, record.why
    assert record.result["robots"] == ["r1", "r2"]
    assert record.result["energy_j"] > 0
