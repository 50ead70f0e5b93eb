"""Simulated robots whose coordinator is killed: they do the open tasks, each once; one that returns takes that in."""

import pytest

from robrain.client.members import team_found
from robrain.protocol.errors import NobodyThere
from robrain.protocol.model.tasks.task import TaskState
from tests.agent.consensus.leaderless import pass_time, team_of

pytestmark = pytest.mark.slow

PLACES = ((2.0, 2.6), (1.5, 1.0), (1.0, 1.6), (2.2, 2.0))


def test_simulated_robots_do_orphaned_tasks_once_each_and_the_journal_takes_them_in() -> None:
    with team_of(3) as (team, run, watch):
        pass_time(team, watch, 6.0)
        names = [team.submit("visit", place=place, service_s=2.0).task.id for place in PLACES]
        pass_time(team, watch, 0.5)
        assert not watch.done
        run.end_coordinator()
        pass_time(team, watch, 2.0)
        assert not any(run.coordinator.tasks.find(name).state.ended for name in names)
        pass_time(team, watch, 88.0, until=lambda: len(watch.done) == len(names))
        assert watch.done == dict.fromkeys(names, 1)
        assert 0 < watch.largest_ballot < 4096
        run.begin_coordinator()
        pass_time(team, watch, 2.0)
        assert {name: team.get(name).state for name in names} == dict.fromkeys(names, TaskState.DONE)
        pass_time(team, watch, 3.0)
        assert watch.done == dict.fromkeys(names, 1)


def test_without_consensus_simulated_robots_drop_what_they_do() -> None:
    with team_of(1, consensus=False) as (team, run, watch):
        pass_time(team, watch, 10.0)
        team.submit("visit", place=PLACES[0], service_s=30.0)
        pass_time(team, watch, 2.0)
        run.end_coordinator()
        pass_time(team, watch, 3.0)
        status = run.hosts[0].desk.status
        assert status is not None
        assert status.state is TaskState.CANCELLED
        assert watch.ballots == 0


def test_a_task_that_is_submitted_without_a_coordinator_is_done_once_and_noted_by_one_that_comes() -> None:
    with team_of(3) as (team, run, watch):
        pass_time(team, watch, 6.0)
        run.end_coordinator()
        pass_time(team, watch, 3.0)
        record = team.submit("visit", place=PLACES[0], service_s=2.0)
        name = record.task.id
        assert record.state is TaskState.QUEUED
        assert record.why.startswith("there is no coordinator; r1, r")
        pass_time(team, watch, 40.0, until=lambda: bool(watch.done))
        run.begin_coordinator()
        pass_time(team, watch, 2.0)
        assert team.get(name).state is TaskState.DONE
        pass_time(team, watch, 3.0)
        assert watch.done == {name: 1}


def test_a_running_task_that_is_cancelled_without_a_coordinator_is_ended_and_stays_so() -> None:
    with team_of(3) as (team, run, watch):
        pass_time(team, watch, 6.0)
        name = team.submit("visit", place=PLACES[0], service_s=6.0).task.id
        pass_time(team, watch, 2.0)
        assert team.get(name).state is TaskState.RUNNING
        run.end_coordinator()
        pass_time(team, watch, 3.0)
        record = team.cancel(name, why="not needed")
        assert (record.task.id, record.state) == (name, TaskState.CANCELLED)
        assert record.why.startswith("there is no coordinator; r1, r")
        pass_time(team, watch, 9.0)
        assert not any(host.desk.is_busy for host in run.hosts)
        run.begin_coordinator()
        pass_time(team, watch, 5.0)
        assert team.get(name).state is TaskState.CANCELLED
        assert not watch.done


def test_a_coordinator_that_comes_while_robots_are_asked_takes_the_task(monkeypatch) -> None:
    def found(wire):
        run.begin_coordinator()
        return team_found(wire)

    with team_of(2, consensus=False) as (team, run, watch):
        pass_time(team, watch, 5.0)
        run.end_coordinator()
        pass_time(team, watch, 3.0)
        monkeypatch.setattr("robrain.client.requests.team_found", found)
        record = team.submit("visit", place=PLACES[0])
        assert record.why == ""
        assert team.get(record.task.id).task == record.task


def test_robots_without_consensus_say_that_they_take_none() -> None:
    with team_of(2, consensus=False) as (team, run, watch):
        pass_time(team, watch, 5.0)
        run.end_coordinator()
        pass_time(team, watch, 3.0)
        with pytest.raises(NobodyThere, match=r"no coordinator .* answers.*r1: .*`consensus = true`"):
            team.submit("visit", place=PLACES[0])
