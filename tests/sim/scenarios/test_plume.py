"""The scenario `plume`: a mote notices heat, a rule makes a task, a robot finds where it comes from."""

import math

import pytest

from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.messages.tasks.task_messages import TaskFilter
from robrain.protocol.wire.reasons.tasks import RuleReading
from robrain.sim.scenarios.scenario import Scenario

pytestmark = pytest.mark.slow

NEAR_M = 0.5
"""How near to the true source the found one is over ten seeds: docs/how-to/rules.md."""


@pytest.fixture
def run():
    opened = []

    def begin(seed):
        scenario = Scenario.builtin("plume").replace(seed=seed)
        opened.append(scenario.open(scenario.world()))
        return opened[-1]

    yield begin
    for one in opened:
        one.close()


def test_one_task_is_made_and_the_source_found(run):
    begun = run(2)
    source = begun.arena.sensors._field._plumes[0]
    journal = begun.coordinator.tasks.journal
    records = []
    while begun.sim_time_s < 150.0:
        begun.tick()
        records = journal.select(TaskFilter(by="rule:heat"))
        if records and records[0].state.ended:
            break
    (record,) = records
    assert record.state is TaskState.DONE
    assert math.hypot(record.result["x_m"] - source.x_m, record.result["y_m"] - source.y_m) < NEAR_M
    first = journal.history(record.task.id)[0]
    assert isinstance(first.reason, RuleReading)
    assert first.reason.value > 23.0
    assert first.reason.held_s >= 6.0
    assert begun.truth.robots[0].collisions == 0
    told = begun.coordinator.rules.status()[0]
    assert (told.name, told.made, told.alarms) == ("heat", 1, 1)


def test_the_run_goes_on_until_the_task_of_the_rule_has_ended():
    result = Scenario.builtin("plume").replace(seed=2).run(until_explored=0.5)
    assert result.ended == "explored"
    assert result.sim_time_s > 50.0  # half of the floor is known after some 15 s
