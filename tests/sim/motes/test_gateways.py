"""Gateways between a field of simulated motes and the team's network: the whole stack in the scenario `islands`."""

from collections import Counter

import msgspec
import pytest

from robrain.coordinator.motes.mote_field import FieldKeeper
from robrain.coordinator.planning.policy import MoteFieldPolicy, PlanningPolicy
from robrain.protocol.clock import to_seconds
from robrain.protocol.links.exchange import COORDINATOR
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.motes.mote_messages import MOTE_READING
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.errors import ScenarioError
from robrain.sim.motes.mote import MeshSpec
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.link_spec import LinkSpec, PartitionSpec
from robrain.sim.world.robot_specs import RobotSpec

NORTH = {f"m{number}" for number in range(9, 17)}
"""Motes of the northern hall; the robot stays in the western one."""
CUT_S = (8.0, 28.0)


def standing_robot() -> Scenario:
    """The scenario with one robot, which does not explore."""
    robot = RobotSpec(place_m=(10.0, 5.1), without=("explore",))
    return Scenario.builtin("islands").replace(robots=1, near=None, roster=(robot,))


def islands(*, cut: bool = True, store: int = 4096, links: bool = True) -> Scenario:
    """A robot that stands in the western hall, and a gateway in the northern one, whose link is cut for a while."""
    scenario = standing_robot()
    radio = msgspec.structs.replace(scenario.network.radio, sensitivity_dbm=-86.0)
    kind = msgspec.structs.replace(
        scenario.network.motes, mesh=MeshSpec(hops=6), gateways=("m9",), gateway_readings=store
    )
    partition = PartitionSpec(from_s=CUT_S[0], until_s=CUT_S[1], groups=(("m9",),))
    return scenario.replace(
        network=msgspec.structs.replace(scenario.network, motes=kind, radio=radio),
        links=LinkSpec(partitions=(partition,) if cut else ()) if links else None,
        planning=PlanningPolicy(mote_field=MoteFieldPolicy(watch=True)),
    )


class Heard:
    """What arrives where the coordinator is."""

    def __init__(self, team) -> None:
        self.team = team
        run = team.transport.run
        self.run = run
        wire = Endpoint(run.session, team.transport.team, run.clock, Drive.LOCKSTEP, party=COORDINATOR)
        run._closers.append(wire.close)
        self._inbox = Inbox(1_000_000)
        wire.subscribe(self._inbox, MOTE_READING)
        self.readings = []

    def run_until(self, sim_time_s: float) -> list:
        """Readings that have arrived since the last call."""
        self.team.run_for(sim_time_s - self.run.sim_time_s)
        new = [received.message for received in self._inbox.drain()]
        self.readings += new
        return new


def own_numbers(run, name: str) -> set[int]:
    """Numbers of the readings that a mote has taken more than three seconds ago."""
    mote = next(mote for mote in run.arena._motes.motes if mote.mote.name == name)
    return set(range(mote.newest))


@pytest.mark.slow
def test_readings_of_a_cut_off_gateway_arrive_after_the_cut_none_twice_and_none_lost() -> None:
    with islands().team(seed=3) as team:
        heard = Heard(team)
        heard.run_until(CUT_S[0])
        (gateway,) = heard.run.arena.gateways
        during = heard.run_until(CUT_S[1] - 0.5)
        assert {reading.mote for reading in during} & NORTH == set()
        assert gateway.store.waiting >= 8 * 18 / 4 - 8
        assert heard.run.coordinator.part(FieldKeeper).state.oldest_s > 15.0
        heard.run_until(50.0)
        after = [reading for reading in heard.readings if reading.via == "m9"]
        late = [one for one in after if to_seconds(one.stamp_ns - one.measured_ns) > 10.0]
        assert len(late) > 8 * 10 / 4 - 8
        times = Counter((reading.mote, reading.sequence) for reading in heard.readings if reading.mote in NORTH)
        assert max(times.values()) == 1
        for name in NORTH:
            came = {number for mote, number in times if mote == name}
            assert set(range(max(came) + 1)) == came  # from the first on: none is missing
            assert own_numbers(heard.run, name) - came <= {max(own_numbers(heard.run, name))}
        (told,) = heard.run.coordinator.part(FieldKeeper).state.gateways
        assert (told.name, told.waiting, told.dropped) == ("m9", 0, 0)
        assert heard.run.coordinator.part(FieldKeeper).state.delivery_ratio > 0.97
        assert gateway.store.dropped == 0


@pytest.mark.slow
def test_a_gateway_with_too_little_room_drops_the_oldest_and_says_how_many() -> None:
    with islands(store=16).team(seed=3) as team:
        heard = Heard(team)
        heard.run_until(CUT_S[1] - 1.0)
        (gateway,) = heard.run.arena.gateways
        assert gateway.store.waiting == 16
        dropped = gateway.store.dropped
        assert dropped > 8
        heard.run_until(45.0)
        came = {(reading.mote, reading.sequence) for reading in heard.readings}
        lost = {(name, number) for name in NORTH for number in own_numbers(heard.run, name)} - came
        newest = {(name, max(own_numbers(heard.run, name))) for name in NORTH}
        assert len(lost - newest) == gateway.store.dropped >= dropped
        (told,) = heard.run.coordinator.part(FieldKeeper).state.gateways
        assert told.dropped == gateway.store.dropped
        assert f"gateway m9 stores 0, has dropped {told.dropped}" in heard.run.coordinator.part(FieldKeeper).state.words


@pytest.mark.slow
def test_the_field_tells_by_which_motes_readings_come() -> None:
    with islands(cut=False, links=False).team(seed=3) as team:
        team.run_for(20.0)
        state = team.state().mote_field
        names = {one.mote for one in state.forwarders}
        assert names & NORTH
        assert state.forwarded >= sum(one.readings for one in state.forwarders) > 0
        assert 1.0 <= state.hops <= 6.0
        assert f"most by {state.forwarders[0].mote}" in state.words
        motes = {reading.mote for reading in team.readings(8.0)}
        assert motes >= NORTH
    plain = standing_robot().replace(planning=islands().planning)
    with plain.team(seed=3) as team:
        team.run_for(10.0)
        state = team.state().mote_field
        assert (state.forwarded, state.hops, state.forwarders, state.gateways) == (msgspec.UNSET,) * 4
        assert not {reading.mote for reading in team.readings(8.0)} & NORTH


@pytest.mark.slow
def test_a_robot_that_is_a_gateway_stores_what_it_collects_out_of_reach_of_the_coordinator() -> None:
    scenario = islands(cut=False)
    kind = msgspec.structs.replace(scenario.network.motes, gateways=("r1",), mesh=MeshSpec())
    cut = PartitionSpec(from_s=8.0, until_s=28.0, groups=(("r1",),))
    scenario = scenario.replace(
        network=msgspec.structs.replace(scenario.network, motes=kind), links=LinkSpec(partitions=(cut,))
    )
    with scenario.team(seed=3) as team:
        heard = Heard(team)
        heard.run_until(8.0)
        assert heard.run_until(27.5) == []
        after = heard.run_until(44.0)
        ages_s = [to_seconds(reading.stamp_ns - reading.measured_ns) for reading in after]
        assert 15.0 < max(ages_s) < 35.0
        assert max(Counter((reading.mote, reading.sequence) for reading in heard.readings).values()) == 1
        assert {one.name for one in heard.run.coordinator.part(FieldKeeper).state.gateways} == {"r1"}


@pytest.mark.slow
def test_a_coordinator_that_begins_anew_is_told_what_was_sensed_while_there_was_none() -> None:
    with islands(links=False).team(seed=3) as team:
        run = team.transport.run
        team.run_for(10.0)
        before = own_numbers(run, "m12")
        run.end_coordinator()
        team.run_for(20.0)
        run.begin_coordinator()
        team.run_for(10.0)
        lives = run.coordinator.part(FieldKeeper).ledger.motes
        assert set(lives) >= NORTH
        first, newest = max(before), max(own_numbers(run, "m12"))
        assert lives["m12"].arrived >= newest - first - 1 >= 5
        assert run.coordinator.part(FieldKeeper).state.delivery_ratio > 0.95


@pytest.mark.slow
def test_gateways_that_are_no_robots_or_motes_are_refused_with_those_that_there_are() -> None:
    scenario = islands()

    def named(*names: str) -> Scenario:
        kind = msgspec.structs.replace(scenario.network.motes, gateways=names)
        return scenario.replace(network=msgspec.structs.replace(scenario.network, motes=kind), links=None)

    with pytest.raises(ScenarioError, match=r"islands: motes: gateways: no robot or mote 'm99'; there are robots r1"):
        named("m99").world()
    with pytest.raises(ScenarioError, match="expected each name once, got 'm3' twice"):
        named("m3", "m3").world()
    unknown = LinkSpec(partitions=(PartitionSpec(groups=(("m3",),)),))
    with pytest.raises(ScenarioError, match="no party 'm3'; there are coordinator and r1 to r1, gateway m9"):
        scenario.replace(links=unknown).world()
