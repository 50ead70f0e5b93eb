"""Simulated motes are members of the team: they sense where they are, for less than a robot, and robots stand in."""

import pytest

from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.motes.radio import MoteState
from robrain.sim.scenarios.scenario import Scenario

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def team():
    with Scenario.builtin("arena_small").replace(robots=2, motes=6).team(seed=4) as team:
        team.run_for(30.0)
        yield team


def places(team):
    return {mote.name: mote.place for mote in team.transport.run.world.motes}


def flatten(team, name):
    """The mote's cells are empty from now on."""
    index = [mote.name for mote in team.transport.run.world.motes].index(name)
    mote = team.transport.run.arena._motes.motes[index]
    mote.battery.spend(MoteState.LISTEN, 1e9)


def test_reading_is_brought_by_the_mote_that_is_there_for_less_than_a_robot_would_take(team):
    distance_m = sum(robot.distance_m for robot in team.transport.run.truth.robots)
    team.submit("sense", id="warm", place=places(team)["m1"])
    verdicts = {one.robot: one for one in team.why("warm").robots}
    assert [name for name, one in verdicts.items() if one.chosen] == ["m1"]
    record = team.wait("warm", timeout_s=30.0)
    assert (record.state, record.robot) == (TaskState.DONE, "mote:m1")
    assert record.result["energy_j"] < 0.01 * min(verdicts[name].energy_j for name in ("r1", "r2"))
    assert sum(robot.distance_m for robot in team.transport.run.truth.robots) < distance_m + 20.0


def test_dead_mote_s_task_is_done_by_a_robot(team):
    flatten(team, "m1")
    team.submit("sense", id="dead", place=places(team)["m1"], parameters={"timeout_s": 12.0})
    record = team.wait("dead", timeout_s=90.0)
    assert record.state is TaskState.DONE
    assert record.robot in ("r1", "r2")
    states = [change.state for change in team.why("dead").changes]
    assert states.count(TaskState.RUNNING) == 2


def test_mote_monitors_more_often_for_as_long_as_it_is_asked_to(team):
    rounds = {"duration_s": 15.0, "interval_s": 1.0, "quantity": "temperature_c"}
    team.submit("monitor", id="watch", place=places(team)["m2"], parameters=rounds)
    record = team.wait("watch", timeout_s=60.0)
    assert (record.state, record.robot) == (TaskState.DONE, "mote:m2")
    assert record.result["rounds"] >= 8
    assert [reading.period_s for reading in team.readings(10.0, mote="m2")][-1] == 4.0
