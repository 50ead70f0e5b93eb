"""A task planned and done by simulated robots; `make bench ARGS=planning` compares a dozen with nearest first."""

from pathlib import Path

import pytest

from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.scenarios.scenario import Scenario
from tests.coordinator.planning.recorded_plans import replay_decisions


@pytest.mark.slow
def test_simulated_robots_do_a_task_together_and_the_recording_decides_the_same_again(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with Scenario.builtin("arena_small").replace(robots=2, motes=0).team(seed=5, record=path) as team:
        team.run_for(12.0)
        lift = team.submit("visit", place=(2.0, 2.6), robots=2, service_s=3.0)
        record = team.wait(lift, timeout_s=108.0)
    assert record.state is TaskState.DONE, record.why
    assert record.result["robots"] == ["r1", "r2"]
    assert record.result["energy_j"] > 0
    plans = list(replay_decisions(path))
    assert plans
    assert all(plan.is_same for plan in plans)
