"""The scenario `plume`: a mote notices heat, a rule makes a task, a robot finds where it comes from."""

import math

import pytest

from robrain.coordinator.rules.task_rules import TaskRules
from robrain.protocol.messages.tasks.task_messages import TaskFilter
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.scenarios.scenario import Scenario

pytestmark = pytest.mark.slow

NEAR_M = 0.5
"""How near to the true source the found one is over ten seeds: docs/how-to/rules.md."""


def test_one_task_is_made_and_the_run_goes_on_until_the_source_is_found():
    runs, told = [], {}

    def look(_):
        tasks, rules = runs[0].coordinator.tasks, runs[0].coordinator.part(TaskRules)
        told["records"] = tasks.journal.select(TaskFilter(by="rule:heat"))
        told["histories"] = [tasks.journal.history(record.task.id) for record in told["records"]]
        told["rule"] = rules.status()[0]

    scenario = Scenario.builtin("plume").replace(seed=2)
    result = scenario.run(until_explored=0.5, before_start=runs.append, on_progress=look)
    assert result.ended == "explored"
    assert result.sim_time_s > 50.0  # half of the floor is known after some 15 s
    assert result.collisions == 0
    (record,) = told["records"]
    assert record.state is TaskState.DONE
    source = runs[0].arena._field._plumes[0]
    assert math.hypot(record.result["x_m"] - source.x_m, record.result["y_m"] - source.y_m) < NEAR_M
    first = told["histories"][0][0]
    assert first.reason.code == "rule_reading"
    assert first.reason.values["value"] > 23.0
    assert first.reason.values["held_s"] >= 6.0
    assert (told["rule"].name, told["rule"].made, told["rule"].alarms) == ("heat", 1, 1)
