"""Readings that simulated motes pass on to base stations, hop by hop."""

from collections import Counter

import numpy as np
import pytest

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_RX
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.tinyos.packet import ActiveMessage
from robrain.protocol.tinyos.payloads import FORWARDED_TYPE, READING_TYPE, STORED_TYPE, ForwardedPayload, ReadingPayload
from robrain.protocol.wire.endpoint import Endpoint
from robrain.sim.motes.field import FieldSpec, Levels, Plume, SimulatedField
from robrain.sim.motes.mesh import SHORT_S
from robrain.sim.motes.mote import ArenaMote, MeshSpec, MoteSpec
from robrain.sim.motes.motes import MoteField, SensorNetwork
from robrain.sim.motes.radio import AIRTIME_S, MoteState, RadioModel

TICK_S = 0.02
MESH = MeshSpec(hops=8, routes_s=5.0)
RADIO = RadioModel(shadowing_db=0.0)
STEP_M = 6.0
"""Motes hear each other well up to 6.8 m, and not at all at 12 m."""


def network(mesh: MeshSpec = MESH, radio: RadioModel = RADIO, **of_motes: float) -> SensorNetwork:
    kind: dict[str, float] = {"jitter_s": 0.0, "drift_ppm": 0.0, "used_at_start_max": 0.0} | of_motes
    quiet = FieldSpec(temperature=Levels(base=20.0, plume=9.0, noise=0.0))
    return SensorNetwork(motes=MoteSpec(mesh=mesh, **kind), radio=radio, field=quiet)


class Line:
    """Motes on the floor, and a robot that can be moved."""

    def __init__(
        self, wire: Endpoint, motes: list[tuple[float, float]], spec: SensorNetwork, seed: int = 1, at_m: float = 0.0
    ) -> None:
        self.robot = Point2D(at_m, 0.0)
        self._inbox = Inbox(1_000_000)
        wire.subscribe(self._inbox, ARENA_RADIO_RX)
        placed = [ArenaMote(name=f"m{n}", number=n, place=Point2D(*place)) for n, place in enumerate(motes, 1)]
        field = SimulatedField(spec.field, [Plume(0.0, 0.0, 0.0, 0.0)], Point2D(-100.0, -100.0), (200.0, 200.0))
        self.field = MoteField(placed, ["r1"], spec, field, wire, np.random.default_rng(seed), TICK_S)
        self.ticks = 0

    def run(self, seconds: float) -> list[tuple[ActiveMessage, ReadingPayload, int, int]]:
        """Packets that the robot has heard: message, reading, first forwarder and hops (0 for the mote itself)."""
        for _ in range(round(seconds / TICK_S)):
            self.ticks += 1
            self.field.step([self.robot])
        heard = []
        for received in self._inbox.drain():
            message = ActiveMessage.unpack(received.message)
            if message.type == FORWARDED_TYPE:
                way = ForwardedPayload.unpack(message.payload)
                heard.append((message, way.reading, way.forwarder, way.hops))
            else:
                heard.append((message, ReadingPayload.unpack(message.payload), 0, 0))
        return heard


def a_line(count: int) -> list[tuple[float, float]]:
    return [(STEP_M * index, 1.0) for index in range(count)]


def test_readings_of_motes_that_no_base_station_hears_arrive_over_their_neighbours(wire):
    heard = Line(wire, a_line(5), network()).run(60.0)
    ways = {reading.mote: (forwarder, hops) for _, reading, forwarder, hops in heard}
    assert ways == {1: (0, 0), 2: (0, 0), 3: (2, 1), 4: (3, 2), 5: (4, 3)}
    numbers = {mote: {reading.sequence for _, reading, _, _ in heard if reading.mote == mote} for mote in ways}
    assert all(set(range(13)) <= numbers[mote] for mote in ways)


def test_no_more_motes_pass_a_reading_on_than_allowed(wire):
    line = Line(wire, a_line(5), network(MeshSpec(hops=1, routes_s=5.0)))
    heard = line.run(120.0)
    assert {reading.mote for _, reading, _, _ in heard} == {1, 2, 3}
    assert line.field.mesh is not None
    assert line.field.mesh.counters.too_far > 20
    assert {hops for _, _, _, hops in heard} == {0, 1}


def test_packets_between_motes_meet_the_radio_and_are_sent_again(wire):
    near_the_edge = RadioModel(shadowing_db=5.0, static_share=0.0, sensitivity_dbm=-88.4)
    line = Line(wire, a_line(4), network(radio=near_the_edge))
    heard = line.run(400.0)
    assert line.field.mesh is not None
    counters, air = line.field.mesh.counters, line.field.mesh.air
    assert air.crc_errors + air.lost > 0.02 * counters.sent
    assert counters.repeated > 0
    arrived = {reading.sequence for _, reading, _, _ in heard if reading.mote == 4}
    assert len(arrived) >= 0.97 * 99
    packets = Counter((reading.mote, reading.sequence) for message, reading, _, _ in heard if message.source == 2)
    assert packets[4, 30] <= 3


def test_who_passes_readings_on_spends_energy_on_it(wire):
    states, passed_on = {}, 0
    for hops in (0, 8):
        line = Line(wire, a_line(3), network(MeshSpec(hops=hops, duty=0.0, routes_s=5.0)))
        line.run(60.0)
        states[hops] = [dict(mote.battery.state_s) for mote in line.field.motes]
        passed_on = line.field.mesh.counters.passed_on if line.field.mesh is not None else 0
    more_s = [{state: states[8][index][state] - states[0][index][state] for state in MoteState} for index in range(3)]
    assert more_s[1][MoteState.SEND] > 14 * 0.018  # fourteen readings of m3, and acknowledgements
    assert more_s[0][MoteState.LISTEN] > 0.0
    # The middle mote has heard readings, and the beacons of one neighbour more, twelve times.
    heard_s = more_s[1][MoteState.LISTEN] - more_s[0][MoteState.LISTEN]
    assert heard_s == pytest.approx(passed_on * AIRTIME_S + 12 * SHORT_S)
    line = Line(wire, a_line(3), network(MeshSpec(hops=8, duty=0.05)))
    line.run(60.0)
    assert line.field.motes[0].battery.state_s[MoteState.LISTEN] > 0.045 * 60.0


def test_motes_with_equal_energy_take_turns_and_one_with_little_is_spared(wire):
    diamond = [(0.0, 1.0), (5.0, 3.0), (5.0, -3.0), (10.0, 0.0)]
    ways = []
    for used_s in (0.0, 90.0):
        line = Line(wire, diamond, network(capacity_mah=0.5), at_m=-4.0)
        line.field.motes[1].battery.spend(MoteState.LISTEN, used_s)
        heard = line.run(160.0)
        ways.append(Counter(forwarder for _, reading, forwarder, _ in heard if reading.mote == 4))
    assert min(ways[0][2], ways[0][3]) > 10
    assert ways[1][3] > 9 * ways[1][2]


def test_a_mote_without_a_good_link_uses_a_weak_one_and_others_leave_such_links_alone(wire):
    far = [(0.0, 1.0), (6.0, 1.0), (14.5, 1.0), (14.5, 4.0)]
    line = Line(wire, far, network(radio=RadioModel(shadowing_db=1.0, static_share=0.0)), at_m=-2.0)
    heard = line.run(200.0)
    assert {forwarder for _, reading, forwarder, _ in heard if reading.mote == 3} == {2}
    assert len({reading.sequence for _, reading, _, _ in heard if reading.mote == 3}) >= 45
    assert line.field.mesh is not None
    assert line.field.mesh.next_hops[:3] == [4, 0, 1]  # the robot, 8 m from m2, would hear it weakly


def test_routes_lead_around_a_mote_that_has_died(wire):
    diamond = [(0.0, 1.0), (5.0, 3.0), (5.0, -3.0), (10.0, 0.0)]
    line = Line(wire, diamond, network(), at_m=-4.0)
    line.run(30.0)
    line.field.motes[1].battery.spend(MoteState.LISTEN, 1e9)
    line.run(10.0)
    heard = line.run(60.0)
    assert {forwarder for _, reading, forwarder, _ in heard if reading.mote == 4} == {3}
    assert len({reading.sequence for _, reading, _, _ in heard if reading.mote == 4}) >= 14


def test_a_mote_whose_next_hop_has_died_tries_it_ever_less_often_until_there_are_new_routes(wire):
    diamond = [(0.0, 1.0), (5.0, 3.0), (5.0, -3.0), (10.0, 0.0)]
    line = Line(wire, diamond, network(MeshSpec(hops=8, routes_s=60.0)), at_m=-4.0)
    line.run(30.0)
    mesh = line.field.mesh
    assert mesh is not None
    hop = mesh.next_hops[3]
    assert hop in (1, 2)
    line.field.motes[hop].battery.spend(MoteState.LISTEN, 1e9)
    before = mesh.counters.sent
    line.run(29.0)
    of_the_other = 8  # its readings, by way of m1
    probes = 4  # after pauses of 2, 4, 8 and 16 s
    assert mesh.counters.sent - before <= MESH.tries + 2 + probes + of_the_other
    assert 3 <= mesh.counters.waits <= 1 + probes
    heard = line.run(40.0)
    assert {reading.sequence for _, reading, _, _ in heard if reading.mote == 4} >= set(range(8, 20))


def test_readings_wait_in_the_log_while_there_is_no_way_and_follow_later(wire):
    line = Line(wire, a_line(3), network(), at_m=-60.0)
    assert line.run(60.0) == []
    line.robot = Point2D(-4.0, 0.0)
    heard = line.run(100.0)
    arrived = {reading.sequence for _, reading, _, _ in heard if reading.mote == 3}
    assert set(range(30)) <= arrived
    assert {message.type for message, _, _, _ in heard} == {READING_TYPE, STORED_TYPE, FORWARDED_TYPE}
    old = [reading for _, reading, _, _ in heard if reading.mote == 3 and reading.sequence == 0]
    assert 600 <= old[0].age_ds <= 750


def test_a_mote_holds_no_more_readings_than_it_has_room_for_and_none_is_lost(wire):
    line = Line(wire, a_line(6), network(MeshSpec(hops=8, queue=1, routes_s=5.0)))
    heard = line.run(200.0)
    assert line.field.mesh is not None
    assert line.field.mesh.counters.refused > 0
    assert max(len(station.queue) for station in line.field.mesh._stations) <= 1
    numbers = {reading.sequence for _, reading, _, _ in heard if reading.mote == 6}
    assert len(numbers) >= 35
