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
