"""In lockstep time passes only within methods that wait, and equal calls give equal runs."""

import inspect
from pathlib import Path
from typing import Any

import msgspec
import pytest

import robrain
from robrain import BadTask, NobodyThere, Outcome, Scenario, Team
from robrain.sim.lockstep.lockstep import LockstepTransport
from robrain.sim.world.scenario_tasks import TaskSpec

SCENARIO = Scenario.builtin("arena_small").replace(robots=1, motes=1)


@pytest.mark.slow
def test_time_stands_still_while_a_team_is_asked() -> None:
    with SCENARIO.team() as team:
        with pytest.raises(NobodyThere, match="r1 has sent no state yet: let some time pass"):
            team.state("r1")
        team.run_for(1.0)
        task = team.submit("visit", place=(2, 1))
        for ask in (team.state, team.list, team.planning, lambda: team.why(task), lambda: team.state("r1")):
            ask()
        team.call("r1", "driver", "pose")
        team.halt("r1")
        team.resume("r1")
        assert team.robots == ["r1"]
        assert team.now_s == 1.0
        assert team.halt().confirmed == ("r1",)
        assert 1.0 < team.now_s < 1.6
        ended_s = team.now_s
        team.wait(team.cancel(task))
        assert team.now_s == ended_s  # it has ended already


@pytest.mark.slow
def test_a_dry_run_takes_the_arguments_of_a_submission() -> None:
    assert inspect.signature(Team.dry_run).parameters == inspect.signature(Team.submit).parameters
    with SCENARIO.team() as team:
        team.run_for(1.0)
        given: dict[str, Any] = {"id": "look", "place": (2, 1), "priority": 2.0, "earliest_s": 3.0, "deadline_s": 90.0}
        given |= {"service_s": 4.0, "needs": ["camera"], "after": ["door"], "robots": 1}
        kind: dict[str, Any] = {"parameters": {"look_at": (1, 1)}}
        team.submit("visit", id="door", place=(3, 1))
        foreseen = team.dry_run("inspect", **given, **kind)
        submitted = team.submit("inspect", **given, **kind)
        assert (foreseen.refused, foreseen.task) == ("", submitted.task)
        for ask in (team.submit, team.dry_run):
            with pytest.raises(BadTask, match="a task to visit has no plce"):
                ask("visit", parameters={"plce": (2, 1)})
            with pytest.raises(BadTask, match="give place as an argument"):
                ask("visit", place=(2, 1), parameters={"place": (2, 1)})
            with pytest.raises(BadTask, match="task look is whole already: leave out place"):
                ask(submitted.task, place=(2, 1))


@pytest.mark.slow
def test_equal_seeds_and_calls_give_equal_recordings_and_other_seeds_others(tmp_path: Path) -> None:
    def digest(name: str, seed: int) -> str:
        with SCENARIO.team(seed=seed, record=tmp_path / name) as team:
            team.submit("visit", place=(2, 1))
            team.run_for(1.0)
        assert isinstance(team.transport, LockstepTransport)
        assert team.transport.summary is not None
        return team.transport.summary.digest

    assert digest("one.mcap", 3) == digest("two.mcap", 3) != digest("three.mcap", 4)
    told = robrain.load(tmp_path / "one.mcap").messages("task_event")
    assert {event.message.task.id for event in told} >= {"visit-1"}


@pytest.mark.slow
def test_what_is_listened_to_ends_with_the_loop_and_with_the_team() -> None:
    with SCENARIO.team() as team:
        kept = len(team._listening._open)
        for _ in range(3):
            team.wait(team.submit("visit", place=(2, 1)))
        for _ in team.events():
            break
        assert len(team._listening._open) == kept
        events = team.events()
        next(events)
        assert len(team._listening._open) == kept + 1
    team.close()
    assert team._listening._open == []


@pytest.mark.slow
def test_action_that_a_behavior_supersedes_ends_with_its_name() -> None:
    with SCENARIO.team() as team:
        team.run_for(2.0)
        end = team.act("r1", "driver", "drive", -3.0, timeout_s=10.0)
        assert (end.outcome, end.by, end.words) == (Outcome.SUPERSEDED, "explore", "superseded by explore")
        assert end.action.startswith("drive-")


@pytest.mark.slow
def test_nothing_supersedes_an_action_in_an_idle_team() -> None:
    with SCENARIO.replace(idle=True).team() as team:
        team.run_for(2.0)
        end = team.act("r1", "driver", "turn", 1.0)
        assert (end.outcome, end.by) == (Outcome.DONE, msgspec.UNSET)
        with pytest.raises(TimeoutError, match=r"has not ended after 0\.5 s"):
            team.act("r1", "driver", "turn", 3.0, timeout_s=0.5)


@pytest.mark.slow
def test_idle_team_explores_only_as_a_task_says_and_ends_with_its_tasks() -> None:
    tasks = (TaskSpec(kind="visit", place_m=(5.5, 3.2)),)
    result = SCENARIO.replace(idle=True, tasks=tasks, time_limit_s=60.0).run()
    assert (result.ended, [task.state for task in result.tasks]) == ("tasks_ended", ["done"])
    with SCENARIO.replace(idle=True).team() as team:
        team.run_for(2.0)
        assert team.state().robots[0].idle.code == "exploration_off"
        team.transport.run.end_coordinator()  # alone, a robot would choose a frontier after 3 s
        began = team.state("r1").pose
        team.run_for(5.0)
        assert team.state("r1").pose.distance_m(began) < 0.05
