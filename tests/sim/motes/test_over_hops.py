"""Motes out of reach of every base station: requests, acknowledgements and duties come to them over other motes."""

import numpy as np

from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.motes.mote_messages import MOTE_DUTY, MOTE_READING, MoteDuty
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_TX
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.tinyos.packet import ActiveMessage
from robrain.protocol.tinyos.payloads import DUTY_TYPE, ROUTED_TYPE, DutyPayload, RoutedPayload
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.motes.field import Plume, SimulatedField
from robrain.sim.motes.gateway import MoteGateway
from robrain.sim.motes.mote import ArenaMote, MeshSpec
from robrain.sim.motes.motes import MoteField
from robrain.sim.motes.radio import MoteState, RadioModel
from tests.sim.motes.test_mesh import MESH, RADIO, STEP_M, a_line, network

TICK_S = 0.02
LAST = 4
"""Index of the last mote of a line of five; its name is m5."""
LOSSY = RadioModel(shadowing_db=5.0, static_share=0.0, sensitivity_dbm=-86.0)


class Ends:
    """A line of motes with a gateway beside the first one, and what it tells."""

    def __init__(self, wire, places=None, radio=RADIO, mesh=MESH, seed=1, is_gateway_on=True):
        places = a_line(5) if places is None else places
        spec = network(mesh, radio)
        placed = [ArenaMote(name=f"m{n}", number=n, place=Point2D(*place)) for n, place in enumerate(places, 1)]
        self.wire = wire
        self.told = Inbox(1_000_000)
        self.said = Inbox(1_000_000)
        wire.token(COORDINATOR_ALIVE)
        wire.subscribe(self.told, MOTE_READING)
        wire.subscribe(self.said, ARENA_RADIO_TX)
        ground = SimulatedField(spec.field, [Plume(0.0, 0.0, 0.0, 0.0)], Point2D(-100.0, -100.0), (200.0, 200.0))
        rng = np.random.default_rng(seed)
        self.field = MoteField(placed, [], spec, ground, wire, rng, TICK_S, gateways=placed[:1])
        self.gateway = MoteGateway("m1", wire, 100) if is_gateway_on else None
        self.came = {}
        self.start_ns = wire.clock.now_ns()
        self.ticks = 0

    @property
    def last(self):
        return self.field.motes[LAST]

    @property
    def down(self):
        return self.field.mesh.down.counters

    def run(self, seconds):
        for _ in range(round(seconds / TICK_S)):
            self.ticks += 1
            self.wire.clock.advance_to(self.start_ns + to_ns(self.ticks * TICK_S))
            self.field.step([])
            if self.gateway is not None:
                self.gateway.step()
        for received in self.told.drain():
            self.came.setdefault(received.message.mote, set()).add(received.message.sequence)

    def set_duty(self, mote, period_s):
        self.wire.publisher(MOTE_DUTY, mote=mote).put(MoteDuty(mote=mote, period_s=period_s, by="test"))

    def routed(self):
        """Routed packets that the gateway has sent: first mote and payload."""
        packets = [ActiveMessage.unpack(received.message) for received in self.said.drain()]
        return [(one.destination, RoutedPayload.unpack(one.payload)) for one in packets if one.type == ROUTED_TYPE]


def test_a_duty_reaches_the_last_mote_of_a_line_along_the_way_that_its_readings_came(wire):
    ends = Ends(wire)
    ends.run(40.0)
    ends.set_duty("m5", 9.0)
    ends.run(40.0)
    assert ends.last.period_ds == 90
    assert [mote.period_ds for mote in ends.field.motes[:LAST]] == [40] * LAST
    duties = [(first, packet) for first, packet in ends.routed() if packet.kind == DUTY_TYPE]
    assert {(first, packet.route) for first, packet in duties} <= {(1, (2, 3, 4, 5)), (2, (3, 4, 5))}
    assert {packet.inner for _, packet in duties} == {DutyPayload(90).pack()}
    assert len(duties) < 4  # the gateway stops when a reading has the new period
    ends.run(60.0)
    assert not [packet for _, packet in ends.routed() if packet.kind == DUTY_TYPE]


def test_a_request_brings_stored_readings_of_the_last_mote_and_only_what_has_arrived_is_deleted(wire):
    ends = Ends(wire)
    ends.run(30.0)
    kept = ends.field.mesh._strengths_dbm[LAST]
    ends.field.mesh._strengths_dbm[LAST] = {}  # what m5 sends is lost, and it is not told
    before = set(ends.came["m5"])
    ends.run(40.0)
    ends.field.mesh._stations[LAST].unsent.clear()
    assert ends.came["m5"] <= before | {max(before) + 1}
    ends.field.mesh._strengths_dbm[LAST] = kept
    ends.run(160.0)
    came = ends.came["m5"]
    assert set(range(max(came) + 1)) == came
    deleted = {number for number in range(ends.last.newest + 1) if number not in ends.last.log}
    assert deleted
    assert deleted <= came
    assert len(deleted) > 0.5 * len(came)


def test_a_fifth_of_the_packets_lost_on_each_hop_is_repaired(wire):
    ends = Ends(wire, radio=LOSSY)
    ends.run(60.0)
    ends.set_duty("m5", 5.0)
    ends.run(540.0)
    air = ends.field.mesh.air
    tried = air.received + air.crc_errors + air.lost
    assert 0.15 < (air.crc_errors + air.lost) / tried < 0.30
    assert ends.last.period_ds == 50
    came = ends.came["m5"]
    newest = max(came)
    assert len(came) >= newest - 8
    assert set(range(newest - 20)) <= came
    assert {number for number in range(ends.last.newest + 1) if number not in ends.last.log} <= came


DETOUR = [*a_line(5), (2.0 * STEP_M, 3.0)]
"""m6 stands beside m3."""


def test_a_dead_next_hop_is_counted_and_then_avoided(wire):
    ends = Ends(wire, DETOUR, mesh=MeshSpec(hops=8, routes_s=20.0))
    ends.run(60.0)
    way = ends.gateway._over_hops.route(5, wire.clock.now_ns())
    middle = 3 if 3 in way else 6
    other = 9 - middle
    ends.field.motes[middle - 1].battery.spend(MoteState.SEND, 1e12)
    assert ends.field.motes[middle - 1].battery.is_flat
    packet = RoutedPayload(DUTY_TYPE, 1, (middle, 4), DutyPayload(77).pack())
    ends.field.mesh.down.from_station(1, packet.pack(), ends.field._tick)
    ends.run(5.0)
    assert ends.down.undelivered == 1
    ends.set_duty("m5", 8.0)
    ends.run(120.0)
    assert ends.last.period_ds == 80
    assert other in ends.gateway._over_hops.route(5, wire.clock.now_ns())


def test_equal_seeds_give_equal_packets_over_hops():
    def said(seed):
        session = open_lockstep_session()
        wire = Endpoint(session, "test", VirtualClock(), Drive.LOCKSTEP)
        ends = Ends(wire, radio=LOSSY, seed=seed)
        ends.set_duty("m5", 5.0)
        ends.run(120.0)
        wire.close()
        session.close()
        return ends.routed(), ends.down, ends.field.mesh.counters, ends.came

    first = said(1)
    assert first[0]
    assert first == said(1)
    assert first != said(2)
