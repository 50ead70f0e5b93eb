"""A task that somebody has named as the coordinator names its own does not get in its way."""

import pytest

from robrain import Scenario, TaskFilter

pytestmark = pytest.mark.slow


def test_coordinator_passes_over_ids_that_are_taken() -> None:
    with Scenario.builtin("arena_small").replace(robots=1, motes=0).team() as team:
        taken = [f"explore-{number}" for number in range(1, 4)]
        for name in taken:
            team.submit("visit", id=name, place=(2.0, 1.0), earliest_s=900.0)
        team.run_for(5.0)
        own = [record.task.id for record in team.list(TaskFilter(own=True)) if record.own]
    assert own[0] == "explore-4"
    assert not set(own) & set(taken)
