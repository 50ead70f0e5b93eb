"""Robots and coordinator that hear each other by radio: range, relays, partitions, and what the team makes of it."""

import math

import msgspec
import pytest

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE
from robrain.protocol.messages.team.arena_messages import ARENA_LINKS
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, HALT, Halt
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.errors import ScenarioError
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.link_spec import LinkSpec, PartitionSpec
from tests.sim.links.radio_team import RadioTeam, corridor, counted, robots_in

RANGE = "range_m = 10.0"
CUT_R2 = '[[links.partitions]]\nfrom_s = {from_s}\nuntil_s = {until_s}\ngroups = [["r2"]]'


def up(state):
    return {robot.name for robot in state.robots if robot.up}


def last_state(inbox):
    return inbox.drain()[-1].message


@pytest.mark.slow
def test_through_relays_the_last_robot_of_a_chain_is_heard_and_does_the_task_there():
    with RadioTeam(RANGE, [2.0, 10.0, 18.0, 26.0]) as team:
        heard = team.hear(ROBOT_STATE, "coordinator")
        team.go(2.0)
        assert robots_in(heard) == {"r1", "r2", "r3", "r4"}
        assert counted(team.run)["relayed"] > 0
        task = team.team.submit("visit", id="far", place=(28.0, 2.0))
        record = team.team.wait(task, timeout_s=40.0)
        assert (record.state, record.robot) == (TaskState.DONE, "r4")


@pytest.mark.slow
def test_partition_cuts_at_its_times_and_the_coordinator_gets_the_robot_and_its_token_back():
    cut = CUT_R2.format(from_s=4.0, until_s=10.0)
    with RadioTeam(f"lost_after_s = 2.0\n{cut}", [2.0, 4.0]) as team:
        summaries, presence = team.hear(COORDINATOR_STATE), team.wire("coordinator").watch(ROBOT_ALIVE)
        seen = []
        for until_s, robots in ((3.9, {"r1", "r2"}), (7.5, {"r1"}), (9.9, {"r1"}), (11.0, {"r1", "r2"})):
            while team.run.sim_time_s < until_s:
                team.run.tick()
                seen += [(one.names["robot"], one.present, team.run.sim_time_s) for one in presence.changes()]
            assert up(last_state(summaries)) == robots
        assert [(name, there) for name, there, _ in seen] == [
            ("r1", True), ("r2", True), ("r2", False), ("r2", True),
        ]  # fmt: skip
        assert seen[2][2] == pytest.approx(6.0, abs=0.15)
        assert seen[3][2] == pytest.approx(10.0, abs=0.15)


@pytest.mark.slow
def test_no_task_is_lost_in_a_team_that_is_cut_again_and_again():
    cuts = "\n".join(
        f'[[links.partitions]]\nfrom_s = {at_s}\nuntil_s = {at_s + 5}\ngroups = [["r{1 + at_s // 10 % 3}"]]'
        for at_s in range(5, 35, 10)
    )
    with RadioTeam(f"loss = 0.1\ndelay_s = 0.05\n{cuts}", [2.0, 14.0, 26.0]) as team:
        team.go(2.0)
        tasks = [team.team.submit("visit", id=f"t{n}", place=(3.0 + 5.0 * n, 2.0)) for n in range(4)]
        ended = [team.team.wait(task, timeout_s=200.0) for task in tasks]
        assert [record.state for record in ended] == [TaskState.DONE] * len(tasks)
        assert len(team.team.list()) == len(tasks)


@pytest.mark.slow
@pytest.mark.parametrize(("return_after_s", "is_back"), [(1.0, True), (math.inf, False)])
def test_robot_that_drives_out_of_reach_returns_to_its_start_and_is_heard(return_after_s, is_back):
    links = f"{RANGE}\nrelays = false\nreturn_after_s = {return_after_s}"
    with RadioTeam(links, [2.0, 10.0]) as team:
        team.go(3.0)
        team.team.unload("r1", "visit")
        team.team.submit("visit", id="far", place=(20.0, 2.0))
        up_at = []
        for now_s in range(4, 22):
            team.go(now_s)
            up_at.append(next(robot.up for robot in team.team.state().robots if robot.name == "r2"))
        away = up_at.index(False)
        assert any(up_at[away:]) is is_back


@pytest.mark.slow
def test_halt_that_a_robot_misses_stops_it_when_it_is_back():
    with RadioTeam(CUT_R2.format(from_s=1.0, until_s=5.0), [2.0, 4.0]) as team:
        team.go(2.0)
        team.wire("coordinator").publisher(HALT).put(Halt(halted=True, by="operator", reason="a test"))
        team.go(4.9)
        assert [team.team.state(name).halted for name in ("r1", "r2")] == [True, False]
        team.go(6.5)
        assert [team.team.state(name).halted for name in ("r1", "r2")] == [True, True]


@pytest.mark.slow
def test_radio_that_loses_nothing_changes_nothing_but_its_own_messages():
    def recorded(links):
        scenario = Scenario.builtin("depot").replace(robots=2, seed=2, links=links)
        run = scenario.open(scenario.world())
        kept = []
        run.follow(lambda heard, _: kept.extend((key, payload) for _, key, payload, _, _ in heard))
        for _ in range(75):
            run.tick()
        run.close()
        return kept

    free = corridor("", robots=1).links
    key = ARENA_LINKS.key("default")
    assert [one for one in recorded(free) if one[0] != key] == recorded(None)


@pytest.mark.slow
def test_who_hears_whom_is_published_for_viewers():
    with RadioTeam(f"{RANGE}\ncoordinator_m = [1.0, 2.0]", [2.0, 10.0, 18.0, 29.0]) as team:
        heard, by_robot = team.hear(ARENA_LINKS), team.hear(ARENA_LINKS, "r1")
        team.go(2.0)
        message = last_state(heard)
        assert {one.party: one.receives for one in message.radios} == {
            "coordinator": ["r1", "r2"],
            "r1": ["coordinator", "r2"],
            "r2": ["coordinator", "r1", "r3"],
            "r3": ["r2"],
            "r4": [],
        }
        assert [one.hops for one in message.radios] == [0, 1, 1, 2, None]
        assert message.radios[0].place.x_m == 1.0
        assert message.counters.out_of_reach > 0
        assert len(by_robot.drain()) == 4


@pytest.mark.parametrize("run", [lambda one: one.run(listen="tcp/127.0.0.1:0"),
                                 lambda one: one.open(one.world(), listen="tcp/127.0.0.1:0")])  # fmt: skip
def test_run_that_others_may_join_has_no_links(run):
    with pytest.raises(ScenarioError, match="corridor: links: expected a run that no other process can join"):
        run(corridor(RANGE, robots=1))


@pytest.mark.slow
def test_robots_that_were_apart_have_one_map_again_and_refuse_nothing_of_each_other():
    cut = PartitionSpec(from_s=3.0, until_s=8.0, groups=(("r2",),))
    scenario = Scenario.builtin("depot").replace(robots=2, seed=4, links=LinkSpec(partitions=(cut,)))
    run = scenario.open(scenario.world())
    wire = Endpoint(run.session, "default", run.clock, Drive.LOCKSTEP)
    states = Inbox()
    wire.subscribe(states, ROBOT_STATE)

    def known_m2():
        by_robots = [
            float(wire.ask(ROBOT_CALL, b"[]", robot=name, plugin="mapper", function="known_area_m2"))
            for name in ("r1", "r2")
        ]
        return [*by_robots, run.coordinator.team_map.known_area_m2]

    while run.sim_time_s < 7.9:
        run.tick()
    apart = known_m2()
    assert max(apart) > 1.05 * min(apart)
    while run.sim_time_s < 9.5:
        run.tick()
    known_by_one_m2 = max(known_m2())
    while run.sim_time_s < 10.5:
        run.tick()
    assert min(known_m2()) >= known_by_one_m2
    assert [state.message.refused for state in states.drain()] == [msgspec.UNSET] * 2
    wire.close()
    run.close()


FAR = """
[scenario]
name = "far"
until_explored = 0.3
time_limit_s = {time_limit_s}
[floor]
size_m = [14.0, 4.0]
[team]
robots = 1
near_m = [1.5, 2.0]
[links]
range_m = 6.0
return_after_s = 3.0
[robot]
consensus = {consensus}
[[tasks]]
kind = "visit"
place_m = [11.0, 2.0]
"""


@pytest.mark.slow
def test_a_task_beyond_the_radio_is_left_out_after_two_tries_with_what_helps():
    outcomes = {}
    for consensus in ("false", "true"):
        scenario = Scenario.from_toml(FAR.format(consensus=consensus, time_limit_s=50.0))
        [outcomes[consensus]] = scenario.run().tasks
    assert outcomes["true"].state is TaskState.DONE
    assert outcomes["false"].state is TaskState.QUEUED
    assert "r1 lost contact with the coordinator at x " in outcomes["false"].words
    assert "consensus" in outcomes["false"].words
