"""A field of simulated motes with a coordinator that keeps it alive by itself, and without: the whole stack."""

from statistics import fmean

import msgspec
import pytest

from robrain.coordinator.planning.policy import MoteFieldPolicy, PlanningPolicy
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.scenarios.scenario import Scenario

pytestmark = pytest.mark.slow

ONLY_WATCH = MoteFieldPolicy(turns_s=1e6, rest_factor=1.0)
"""Tells how the field is doing, and does nothing for it."""


def field(policy: MoteFieldPolicy, motes: int, *, sensitivity_dbm: float = -90.0, **spec: float) -> Scenario:
    scenario = Scenario.builtin("arena_small").replace(robots=1, motes=motes)
    radio = msgspec.structs.replace(scenario.network.radio, sensitivity_dbm=sensitivity_dbm)
    kind = msgspec.structs.replace(scenario.network.motes, **spec)
    network = msgspec.structs.replace(scenario.network, motes=kind, radio=radio)
    return scenario.replace(network=network, planning=PlanningPolicy(mote_field=policy))


def told(team):
    return team.state().mote_field


def flat(team) -> int:
    return sum(mote.battery.is_flat for mote in team.transport.run.arena._motes.motes)


def test_data_of_motes_out_of_reach_stay_young_if_robots_are_sent_to_collect() -> None:
    oldest_s, arrived = {}, {}
    for policy in (ONLY_WATCH, MoteFieldPolicy(collect_age_s=40.0)):
        with field(policy, 8, sensitivity_dbm=-72.0).team(seed=4) as team:
            seen = []
            for _ in range(12):
                team.run_for(10.0)
                seen.append(told(team))
            records = [record for record in team.list() if record.by == "mote field"]
            oldest_s[policy], arrived[policy] = (
                max(one.oldest_s for one in seen),
                fmean(one.delivery_ratio for one in seen),
            )
            if policy is not ONLY_WATCH:
                done = [record for record in records if record.state is TaskState.DONE]
                assert {record.task.kind for record in done} == {"collect"}
                assert {record.robot for record in done} == {"r1"}
                assert "newest reading of" in team.why(done[0].task.id).changes[0].why
            else:
                assert records == []
    watched, kept = oldest_s
    assert oldest_s[kept] < 0.8 * oldest_s[watched]
    assert arrived[kept] > arrived[watched] + 0.1


def test_motes_on_duty_in_turn_tell_of_the_floor_when_all_would_be_dead() -> None:
    covered, dead = {}, {}
    for policy in (ONLY_WATCH, MoteFieldPolicy(turns_s=10.0, rest_factor=10.0)):
        with field(policy, 10, capacity_mah=0.015, used_at_start_max=0.2).team(seed=4) as team:
            team.run_for(85.0)
            covered[policy], dead[policy] = told(team).coverage, flat(team)
            assert told(team).dead == dead[policy]
            assert (told(team).last_dead_ns is None) == (dead[policy] < 10)
    watched, kept = covered
    assert (dead[watched], covered[watched]) == (10, 0.0)
    assert dead[kept] <= 2
    assert covered[kept] > 0.9
