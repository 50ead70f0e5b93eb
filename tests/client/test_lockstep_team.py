"""In lockstep time passes only within methods that wait, and equal calls give equal runs."""

from pathlib import Path

import pytest

import robrain
from robrain import NobodyThere, Scenario, Team
from robrain.sim.lockstep.lockstep import LockstepTransport

SCENARIO = Scenario.builtin("arena_small").replace(robots=1, motes=1)


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


def test_a_wait_ends_in_the_tick_of_the_end() -> None:
    with SCENARIO.team() as team:
        team.run_for(1.0)
        record = team.wait(team.submit("visit", place=(2, 1)))
        assert team.now_s - record.changed_ns / 1e9 < 0.021


def test_equal_seeds_and_calls_give_equal_recordings_and_other_seeds_others(tmp_path: Path) -> None:
    def digest(name: str, seed: int) -> str:
        with SCENARIO.team(seed=seed, record=tmp_path / name) as team:
            team.wait(team.submit("visit", place=(2, 1)))
        assert isinstance(team.transport, LockstepTransport)
        assert team.transport.summary is not None
        return team.transport.summary.digest

    assert digest("one.mcap", 3) == digest("two.mcap", 3) != digest("three.mcap", 4)
    told = robrain.load(tmp_path / "one.mcap").messages("task_event")
    assert {event.message.task.id for event in told} >= {"visit-1"}


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


def test_a_client_is_made_of_any_transport() -> None:
    with SCENARIO.team() as team:
        other = Team(team.transport, by="bob")
        assert other.submit("visit", place=(2, 1)).by == "bob"
        other._listening.close()
