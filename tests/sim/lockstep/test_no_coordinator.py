"""Simulated robots whose coordinator is killed: they do the open tasks, each once; one that returns takes that in."""

import pytest

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


def test_a_task_may_be_cancelled_and_another_submitted_without_a_coordinator_and_one_that_comes_notes_both() -> None:
    with team_of(3) as (team, run, watch):
        pass_time(team, watch, 6.0)
        old = team.submit("visit", place=PLACES[0], service_s=6.0).task.id
        pass_time(team, watch, 2.0)
        assert team.get(old).state is TaskState.RUNNING
        run.end_coordinator()
        pass_time(team, watch, 3.0)
        record = team.cancel(old, why="not needed")
        assert (record.task.id, record.state) == (old, TaskState.CANCELLED)
        assert record.why.startswith("there is no coordinator; r1, r")
        pass_time(team, watch, 9.0)
        assert not any(host.desk.is_busy for host in run.hosts)
        new = team.submit("visit", place=PLACES[0], service_s=2.0)
        assert new.state is TaskState.QUEUED
        pass_time(team, watch, 40.0, until=lambda: bool(watch.done))
        run.begin_coordinator()
        pass_time(team, watch, 5.0)
        assert [team.get(name).state for name in (old, new.task.id)] == [TaskState.CANCELLED, TaskState.DONE]
        assert watch.done == {new.task.id: 1}
