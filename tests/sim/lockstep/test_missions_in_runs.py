"""Missions in whole runs: started by people and by schedules, with restarts of the coordinator."""

from collections.abc import Iterator
from contextlib import contextmanager

import msgspec
import pytest

from robrain import Scenario, Team
from robrain.protocol.errors import CallError
from robrain.protocol.messages.tasks.mission_messages import MissionState, MissionStatus
from robrain.protocol.messages.tasks.task_messages import TaskFilter
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.rules.mission import Mission
from robrain.protocol.model.rules.rule import Rule
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport
from robrain.sim.maps.drawing import FloorDrawing
from robrain.sim.world.world import Fidelity

ROUND = msgspec.convert(
    {
        "name": "round",
        "parameters": {"x_m": 8.0},
        "steps": [
            {"name": "gate", "task": {"kind": "visit", "place": ["{x_m}", 5.0]}},
            {"name": "late", "task": {"kind": "visit", "place": [8, 1], "deadline_in_s": 0.5}, "on_failure": "skip"},
            {"name": "home", "task": {"kind": "visit", "place": [2.0, 2.0]}},
        ],
    },
    Mission,
)  # fmt: skip
NIGHT = msgspec.convert(
    {
        "name": "night",
        "schedule": {"rrule": "FREQ=MINUTELY;INTERVAL=2"},
        "mission": {"name": "round", "parameters": {"x_m": 7.0}},
    },
    Rule,
)
HALL = Scenario(
    name="hall",
    floor=FloorDrawing(size_m=(10.0, 6.0)),
    robots=2,
    near=Point2D(1.5, 1.5),
    fidelity=Fidelity.POINTS,
    idle=True,
    missions=(ROUND,),
)


@contextmanager
def hall(scenario: Scenario = HALL) -> Iterator[tuple[LockstepRun, Team]]:
    run = scenario.open(scenario.world())
    assert isinstance(run, LockstepRun)
    with Team(LockstepTransport(run), by="ann") as team:
        team.run_for(2.0)
        yield run, team


def ended(team: Team, mission: MissionStatus) -> MissionStatus:
    def state() -> MissionStatus:
        return next(one for one in team.missions() if one.id == mission.id)

    assert team.run_for(120.0, until=lambda: state().state.ended)
    return state()


@pytest.mark.slow
def test_a_mission_is_done_across_restarts_of_the_coordinator() -> None:
    with hall() as (run, team):
        mission = team.start_mission("round", parameters={"x_m": 6.0})
        assert (mission.id, mission.by) == ("round-1", "ann")
        for _ in range(8):
            team.run_for(1.5)
            run.end_coordinator()
            run.begin_coordinator()
        found = ended(team, mission)
        assert (found.state, found.why) == (MissionState.DONE, "")
        assert [(step.name, step.state) for step in found.steps] == [
            ("gate", "done"), ("late", "skipped"), ("home", "done"),
        ]  # fmt: skip
        records = {record.task.id: record for record in team.list(TaskFilter(by="mission:round-1"))}
        assert [*records] == ["round-1.gate", "round-1.late", "round-1.home"]
        assert records["round-1.gate"].task.place == Point2D(6.0, 5.0)
        assert team.why("round-1.gate").changes[0].why == "step gate of mission round-1"
        assert team.start_mission("round").id == "round-2"


def test_a_cancelled_mission_makes_no_further_tasks() -> None:
    with hall() as (_, team):
        mission = team.start_mission("round", id="mine")
        team.run_for(2.0)
        assert team.cancel_mission(mission, "rain").state is MissionState.CANCELLED
        team.run_for(2.0)
        assert [(one.task.id, one.state) for one in team.list()] == [("mine.gate", TaskState.CANCELLED)]
        [shown] = team.state().missions  # type: ignore[misc]
        assert (shown.state, shown.why, shown.steps) == (MissionState.CANCELLED, "cancelled by ann: rain", [])
        with pytest.raises(CallError, match="there is no mission dance; known are round"):
            team.start_mission("dance")


@pytest.mark.slow
def test_a_schedule_that_is_put_while_the_team_runs_starts_a_mission_once() -> None:
    with hall() as (run, team):
        team.run_for(60.0)
        assert [state.name for state in team.change_rules(NIGHT).states] == ["night"]
        team.run_for(65.0)
        run.end_coordinator()
        run.begin_coordinator()
        team.run_for(5.0)
        [mission] = team.missions()
        assert (mission.mission, mission.by) == ("round", "rule:night")
        assert team.get(f"{mission.id}.gate").task.place == Point2D(7.0, 5.0)
        assert team.change_rules(remove=["night"]).rules == []
        assert ended(team, mission).state is MissionState.DONE
        team.run_for(180.0)
        assert len(team.missions()) == 1
