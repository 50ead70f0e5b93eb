import pytest

from robrain import Scenario
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.errors import ScenarioError

HALL = """
[scenario]
name = "hall"
until_explored = 0.5
time_limit_s = 60.0
[floor]
size_m = [6.0, 4.0]
[team]
robots = 2
"""
VISITS = """
[[tasks]]
kind = "visit"
place_m = [5.0, 1.0]
name = "second"
after = ["first"]
[[tasks]]
kind = "visit"
place_m = [5.0, 3.0]
name = "first"
at_s = 3.0
priority = 2.0
service_s = 1.0
deadline_s = 50.0
[[tasks]]
kind = "inspect"
place_m = [1.0, 1.0]
parameters = { look_at = [2.0, 2.0] }
"""


@pytest.mark.slow
def test_tasks_of_a_scenario_are_done_before_its_run_ends():
    result = Scenario.from_toml(HALL + VISITS).run()
    assert result.ended == "explored"
    assert [(one.task, one.kind, one.state) for one in result.tasks] == [
        ("second", "visit", TaskState.DONE),
        ("first", "visit", TaskState.DONE),
        ("inspect-1", "inspect", TaskState.DONE),
    ]
    assert all(one.robot in ("r1", "r2") for one in result.tasks)
    assert result.sim_time_s > 3.0


@pytest.mark.slow
def test_a_task_is_submitted_at_its_time_by_the_scenario_and_recorded():
    with Scenario.from_toml(HALL + VISITS).team() as team:
        team.run_for(2.9)
        assert [record.task.id for record in team.list()] == ["inspect-1"]
        team.run_for(0.2)
        records = {record.task.id: record for record in team.list()}
    assert records.keys() == {"first", "second", "inspect-1"}
    first = records["first"]
    assert (first.by, first.submitted_ns) == ("scenario", 3_000_000_000)
    assert (first.task.priority, first.task.service_s, first.task.deadline_ns) == (2.0, 1.0, 53_000_000_000)
    assert records["second"].task.after == ("first",)
    assert records["inspect-1"].task.parameters == {"look_at": {"x_m": 2.0, "y_m": 2.0}}


def test_tasks_of_a_script_are_checked_as_well():
    scenario = Scenario.from_toml(HALL + VISITS)
    with pytest.raises(ScenarioError, match="no task first"):
        scenario.replace(tasks=scenario.tasks[:1])
    assert Scenario.from_toml(scenario.to_toml()).tasks == scenario.tasks
