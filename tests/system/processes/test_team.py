"""`robrain.Team`: the same calls have the same answers in lockstep and with a live team of real processes."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import robrain
from robrain import (
    BadTask,
    CallError,
    ErrorCode,
    NobodyThere,
    Objective,
    Point2D,
    Scenario,
    Task,
    TaskFilter,
    TaskState,
    Team,
)
from robrain.protocol.errors import BadName
from robrain.sim.lockstep.lockstep import LockstepTransport
from tests.system.conftest import Commands
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

LAMP = """
from robrain import Device, external


class Lamp(Device):
    @external
    def switch(self, on: bool) -> str:
        return "on" if on else "off"
"""
MANIFEST = """
[plugin]
class = "lamp:Lamp"

[tag]
visibility = ["command"]
shared = false
"""


class Bench(NamedTuple):
    """A team, and what a test needs beside it."""

    team: Team
    other: Team
    """A second client of the same team, by another name."""
    folder: Path
    """From where its robots may load plugins."""


@pytest.fixture(scope="module", params=["lockstep", "live"])
def bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("team")
    (folder / "lamp").mkdir()
    (folder / "lamp" / "lamp.py").write_text(LAMP)
    (folder / "lamp" / "lamp.toml").write_text(MANIFEST)
    if request.param == "lockstep":
        with Scenario.builtin("arena_small").replace(robots=2, motes=3).team(by="ann") as team:
            team.run_for(1.0)  # all have heard of each other
            assert isinstance(team.transport, LockstepTransport)
            yield Bench(team, Team(LockstepTransport(team.transport.run), by="bob"), folder)
        return
    commands = Commands(folder)
    try:
        endpoint = commands.team(2, "--motes", "3")
        with (
            Team.connect(endpoint, by="ann", patience_s=PATIENCE_S) as team,
            Team.connect(endpoint, by="bob", patience_s=PATIENCE_S) as other,
        ):
            until(lambda: [robot.name for robot in team.state().robots if robot.up] == ["r1", "r2"])
            yield Bench(team, other, folder)
    finally:
        commands.stop_all()


@pytest.fixture
def team(bench: Bench) -> Team:
    return bench.team


# -- tasks ------------------------------------------------------------------------------------------------------


def test_a_task_is_named_done_and_told_of(team: Team) -> None:
    task = team.submit("visit", place=(2, 1), deadline_s=900.0, priority=2.0, parameters={"service_s": 0.5})
    assert task.task.id.startswith("visit-")
    assert (task.task.place, task.task.priority, task.task.service_s) == (Point2D(2.0, 1.0), 2.0, 0.5)
    assert task.by == "ann"
    states = [event.state for event in team.events([task], timeout_s=PATIENCE_S)]
    assert states[-1] is TaskState.DONE
    assert team.wait(task, timeout_s=0.0).state is TaskState.DONE  # it has ended already
    assert team.get(task.task.id).robot in team.robots
    why = team.why(task)
    assert why.record.task.id == task.task.id
    assert [change.state for change in why.changes][-1] is TaskState.DONE
    assert task.task.id in [record.task.id for record in team.list(TaskFilter(states=[TaskState.DONE]))]


def test_a_dry_run_submits_nothing(team: Team) -> None:
    before = [record.task.id for record in team.list()]
    found = team.dry_run("visit", place=(2, 1), service_s=5.0)
    assert (found.refused, found.known, found.task.place) == ("", None, Point2D(2.0, 1.0))
    assert [one.robot for one in found.robots] == ["r1", "r2"]
    guard = {"area": [(1.5, 0.5), (2.5, 0.5), (2.5, 1.5)], "duration_s": 600.0}

    def foreseen_j() -> float:
        estimate = team.dry_run("guard", place=(2, 1), parameters=guard).estimate
        return 0.0 if estimate is None else estimate.energy_j

    until(lambda: foreseen_j() > 3000.0, "robots tell the cost", step=lambda: team.transport.pass_time(0.5))
    whole = Task(id="whole", kind="visit", place=Point2D(2.0, 1.0), deadline_ns=1)
    assert "its deadline was" in team.dry_run(whole).refused
    assert [record.task.id for record in team.list()] == before
    with pytest.raises(BadTask, match="task whole is whole already: leave out id, place"):
        team.dry_run(whole, place=(1, 1), id="other")
    with pytest.raises(BadTask, match="a task to visit needs place"):
        team.dry_run("visit")


def test_a_whole_task_is_submitted_once_under_its_id(team: Team) -> None:
    task = Task(id="whole", kind="visit", place=Point2D(1.0, 1.0))
    first, again = (team.submit(task, earliest_s=900.0) for _ in range(2))
    assert first.submitted_ns == again.submitted_ns
    with pytest.raises(CallError, match="there is another task whole: priority"):
        team.submit("visit", id="whole", place=(1.0, 1.0), earliest_s=900.0, priority=7.0)
    assert team.cancel(first, "too late").why == "cancelled by ann: too late"
    assert team.wait(first, timeout_s=PATIENCE_S).state is TaskState.CANCELLED


def test_tasks_wait_for_others_by_record_or_id_and_end_in_that_order(team: Team) -> None:
    first = team.submit("visit", place=(2.0, 1.0))
    second = team.submit("visit", place=(1.0, 1.0), after=[first])
    third = team.submit("visit", place=(2.0, 1.0), after=[second.task.id])
    records = team.wait_all([first, second, third], timeout_s=PATIENCE_S)
    assert [record.state for record in records] == [TaskState.DONE] * 3
    ends = [record.changed_ns for record in records]
    assert ends == sorted(ends)
    with pytest.raises(CallError, match="has ended already") as refused:
        team.cancel(first)
    assert refused.value.code is ErrorCode.REFUSED


def test_what_plans_are_for_can_be_changed(team: Team) -> None:
    assert team.set_objective(Objective.MAKESPAN).objective is Objective.MAKESPAN
    assert team.planning().objective is Objective.MAKESPAN
    team.set_objective(Objective.ENERGY)


# -- robots -----------------------------------------------------------------------------------------------------


def test_functions_are_called_by_position_by_name_and_as_text(team: Team) -> None:
    assert set(team.call("r1", "driver", "pose")) == {"x_m", "y_m", "yaw_rad"}
    assert team.call("r1", "counter", "seconds") >= 0.0
    assert float(team.command("r1", "call counter seconds()")) >= 0.0
    with pytest.raises(CallError) as refused:
        team.call("r1", "driver", "turn", named={"angle": "far"})
    assert refused.value.code is ErrorCode.BAD_ARGUMENTS
    with pytest.raises(CallError) as refused:
        team.call("r1", "driver", "fly")
    assert refused.value.code is ErrorCode.UNKNOWN_FUNCTION
    with pytest.raises(ValueError, match="by position or by name, got both"):
        team.call("r1", "driver", "turn", 1.0, named={})


def test_a_robot_that_is_not_there_is_told_with_those_that_are(team: Team) -> None:
    wanted = "no robot r9 in team default; there are: r1, r2"
    asked = [
        lambda: team.call("r9", "driver", "pose"),
        lambda: team.command("r9", "call driver pose()"),
        lambda: team.plugins("r9"),
        lambda: team.state("r9"),
        lambda: team.halt("r9"),
        lambda: team.reload("r9", "driver"),
    ]
    for ask in asked:
        with pytest.raises(NobodyThere) as missing:
            ask()
        assert str(missing.value) == wanted
    with pytest.raises(BadName):
        team.state("r/9")


def test_a_plugin_is_loaded_held_reloaded_and_unloaded(bench: Bench) -> None:
    team, other = bench.team, bench.other
    assert [(info.name, info.state) for info in team.load("r1", bench.folder / "lamp")] == [("lamp", "active")]
    assert "lamp" in [info.name for info in team.plugins("r1")]
    assert other.call("r1", "lamp", "switch", True) == "on"
    team.hold("r1", "lamp", lease_s=60.0)
    assert team.call("r1", "lamp", "switch", named={"on": False}) == "off"
    assert team.command("r1", "call lamp switch(true)") == "on"
    for call in (lambda: other.call("r1", "lamp", "switch", True), lambda: other.hold("r1", "lamp")):
        with pytest.raises(CallError) as refused:
            call()
        assert refused.value.code is ErrorCode.BUSY
    assert team.release("r1", "lamp")
    assert not team.release("r1", "lamp")
    assert other.call("r1", "lamp", "switch", True) == "on"
    (bench.folder / "lamp" / "lamp.py").write_text(LAMP.replace('"on"', '"bright"'))
    team.reload("r1", "lamp")
    assert team.call("r1", "lamp", "switch", True) == "bright"
    assert [info.name for info in team.unload("r1", "lamp")] == ["lamp"]
    with pytest.raises(CallError) as refused:
        team.call("r1", "lamp", "switch", True)
    assert refused.value.code is ErrorCode.UNKNOWN_PLUGIN


def test_readings_of_motes_are_heard_as_they_come(team: Team) -> None:
    first = next(team.readings(PATIENCE_S))
    assert first.via in team.robots
    assert next(team.readings(PATIENCE_S, mote=first.mote)).mote == first.mote


# -- emergency halt ---------------------------------------------------------------------------------------------


def test_a_halted_team_says_who_has_stopped_and_goes_on_when_its_halter_says_so(bench: Bench) -> None:
    team, other = bench.team, bench.other
    halted = team.halt(reason="a test")
    assert (halted.halted, halted.by, halted.confirmed, halted.unconfirmed) == (True, "ann", ("r1", "r2"), {})
    assert team.state("r1").has_stopped
    refused = other.resume()
    assert refused.confirmed == ()
    assert "bob may not end the halt of ann" in refused.unconfirmed["r1"]
    resumed = team.resume()
    assert (resumed.halted, resumed.confirmed) == (False, ("r1", "r2"))
    team.run_for(PATIENCE_S, until=lambda: not team.state("r1").halted)
    assert not team.state("r1").halted


# -- time -------------------------------------------------------------------------------------------------------


def test_a_team_that_nobody_answers_for_is_one_sentence() -> None:
    with pytest.raises(NobodyThere, match=r"nobody answers at tcp/127\.0\.0\.1:9"):
        robrain.Team.connect("tcp/127.0.0.1:9")
    with pytest.raises(BadName):
        robrain.Team.connect("tcp/127.0.0.1:9", team="a/b")
