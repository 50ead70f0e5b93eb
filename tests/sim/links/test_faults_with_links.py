"""Faults of processes and of the wire in a team whose robots hear each other by radio."""

import pytest

from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultSpec
from tests.sim.links.radio_team import RadioTeam, counted, robots_in

pytestmark = pytest.mark.slow

RANGE = "range_m = 10.0"
CHAIN = [2.0, 10.0, 15.0]
"""r3 is heard by way of r2."""


def fault(kind, robot="r2", at_s=2.0, **options):
    return FaultSpec(robot=robot, kind=kind, at_s=at_s, **options)


def team_of(*faults, xs_m=CHAIN, links=RANGE, seed=1):
    return RadioTeam(links, xs_m, seed=seed, faults=faults)


def heard_within(team, inbox, until_s):
    inbox.drain()
    team.go(until_s)
    return robots_in(inbox)


def tokens(team, party="coordinator"):
    return [names["robot"] for names in team.wire(party).present(ROBOT_ALIVE)]


def test_faults_that_are_not_yet_due_change_nothing_with_links():
    def digest(*faults):
        with team_of(*faults, links=f"{RANGE}\nloss = 0.2\ndelay_s = 0.03") as team:
            team.go(1.5)
            return team.run.digest

    assert digest() == digest(fault(FaultKind.LOSE, at_s=900.0, share=0.5), fault(FaultKind.HANG, at_s=900.0))


def test_a_relay_that_is_cut_off_takes_those_behind_it_with_it_and_gives_them_back():
    with team_of(fault(FaultKind.PARTITION, until_s=8.0)) as team:
        heard = team.hear(ROBOT_STATE, "coordinator")
        assert heard_within(team, heard, 1.9) == {"r1", "r2", "r3"}
        team.go(2.1)
        assert heard_within(team, heard, 7.9) == {"r1"}
        assert tokens(team) == ["r1"]
        assert heard_within(team, heard, 9.0) == {"r1", "r2", "r3"}
        assert sorted(tokens(team)) == ["r1", "r2", "r3"]


def test_messages_that_faults_lose_are_lost_on_the_hop_and_counted():
    with team_of(fault(FaultKind.LOSE, until_s=6.0, share=1.0)) as team:
        heard = team.hear(ROBOT_STATE, "coordinator")
        team.go(2.1)
        before = counted(team.run)["lost"]
        assert heard_within(team, heard, 5.9) == {"r1"}
        assert counted(team.run)["lost"] > before
        assert team.run.lost_by_faults > 0
        assert sorted(tokens(team)) == ["r1", "r2", "r3"]  # a lossy link is a link


def test_a_relay_that_hangs_cuts_the_traffic_that_it_carries_and_keeps_its_token():
    with team_of(fault(FaultKind.HANG, until_s=8.0)) as team:
        heard = team.hear(ROBOT_STATE, "coordinator")
        team.go(2.1)
        assert heard_within(team, heard, 7.9) == {"r1"}
        assert tokens(team) == ["r1", "r2"]
        assert heard_within(team, heard, 9.0) == {"r1", "r2", "r3"}


def test_who_asks_a_hanging_robot_waits_in_vain_and_the_robot_sees_to_it_later():
    with team_of(fault(FaultKind.HANG, until_s=4.0)) as team:
        team.go(3.0)
        timed_out = counted(team.run)["timed_out"]
        with pytest.raises(CallError) as error:
            team.wire("coordinator").ask(ROBOT_PLUGINS, robot="r2")
        assert error.value.code is ErrorCode.TIMEOUT
        assert counted(team.run)["timed_out"] == timed_out + 1
        team.go(4.5)
        assert team.wire("coordinator").ask(ROBOT_PLUGINS, robot="r2")
        assert team.run.outside == 0


def test_a_killed_relay_is_gone_at_once_says_nothing_and_relays_again_when_it_is_back():
    with team_of(fault(FaultKind.KILL, until_s=6.0)) as team:
        heard = team.hear(ROBOT_STATE, "coordinator")
        everywhere = team.hear(ROBOT_STATE)
        team.go(1.98)
        everywhere.drain()
        team.go(2.04)
        assert tokens(team) == ["r1", "r3"]  # those behind it are missed after `lost_after_s`
        assert "r2" not in robots_in(everywhere)
        assert heard_within(team, heard, 5.9) == {"r1"}
        assert heard_within(team, heard, 9.0) == {"r1", "r2", "r3"}
        assert sorted(tokens(team)) == ["r1", "r2", "r3"]
        assert [host.name for host in team.run.hosts] == ["r1", "r2", "r3"]


def test_a_killed_coordinator_with_links_ends_the_task_that_it_had_accepted():
    with team_of(fault(FaultKind.KILL, COORDINATOR, at_s=4.0, until_s=8.0)) as team:
        team.go(2.0)
        task = team.team.submit("visit", id="near", place=(9.0, 3.2))
        states = team.hear(COORDINATOR_STATE)
        team.go(4.1)
        states.drain()
        team.go(7.9)
        assert not states.drain()
        team.go(9.0)
        record = team.team.wait(task, timeout_s=100.0)
        assert record.state is TaskState.DONE
