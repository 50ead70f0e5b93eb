"""The mote field: sensor motes on the floor, and the air between them and the robots' base stations.

A robot's packet to all motes also reaches the base stations of other robots in reach. Gateways have base stations as
well, which stand. Motes forward each other's readings with `[motes.mesh]` (`mesh`).

Packets meet path loss, shadowing and noise (`radio`), not each other: collisions on the air are not simulated.
"""

import heapq
from collections.abc import Sequence

import msgspec
import numpy as np

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_RX, ARENA_RADIO_TX
from robrain.protocol.tinyos.packet import BROADCAST, ActiveMessage, BadPacket
from robrain.protocol.tinyos.payloads import BEACON_TYPE, ROUTED_TYPE, Quantity, with_rssi
from robrain.protocol.wire.endpoint import Endpoint
from robrain.sim.motes.field import FieldSpec, SimulatedField
from robrain.sim.motes.mesh import MoteMesh, energy_of
from robrain.sim.motes.mote import ArenaMote, MoteSpec, SimulatedMote
from robrain.sim.motes.radio import FadingLinks, Floats, RadioCounters, RadioModel, RobotAir, ShadowField
from robrain.sim.robot.robot_body import Body

BETWEEN_ROBOTS = 0xBA5E
"""Keeps the randomness between robots apart from that of any mote, however many there are."""
BETWEEN_MOTES = 0x3E54
"""The same of the randomness between motes."""


class SensorNetwork(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Motes, radio and field of a scenario."""

    motes: MoteSpec = MoteSpec()
    radio: RadioModel = RadioModel()
    field: FieldSpec = FieldSpec()


class MoteField:
    """All motes, woken in order of time.

    Each mote, and each pair of mote and robot, has its own randomness: more motes or robots do not change the others'.

    Args:
        motes: places of all bodies; their order decides the assignment of randomness.
        robots: names of the robots with a base station, in the order in which `step()` gets their bodies.
        network: properties of the motes and their radio.
        field: the field that motes sense.
        endpoint: receiver of the packets that arrive, and source of base stations' packets.
        rng: source of the motes' randomness.
        tick_s: length of a tick.
        gateways: motes beside which another base station stands, which is called like its mote.

    """

    def __init__(
        self,
        motes: Sequence[ArenaMote],
        robots: Sequence[str],
        network: SensorNetwork,
        field: SimulatedField,
        endpoint: Endpoint,
        rng: np.random.Generator,
        tick_s: float,
        gateways: Sequence[ArenaMote] = (),
    ) -> None:
        quantities = [Quantity[name.upper()] for name in network.motes.quantities]
        self.counters = RadioCounters()
        self.motes: list[SimulatedMote] = []
        self._air: list[_Air] = []
        for index, (mote, both) in enumerate(zip(motes, rng.spawn(len(motes)), strict=True)):
            own, air = both.spawn(2)
            quantity = quantities[index % len(quantities)]
            self.motes.append(SimulatedMote(mote, network.motes, quantity, network.radio.transmit_dbm, own, tick_s))
            self._air.append(_Air(self.motes[-1], network.radio, air, self.counters))
        self._field = field
        stations = [*robots, *(mote.name for mote in gateways)]
        self._robots = len(robots)
        self._receivers = [endpoint.publisher(ARENA_RADIO_RX, robot=station) for station in stations]
        self._robot_index = {station: index for index, station in enumerate(stations)}
        self._mote_index = {mote.number: index for index, mote in enumerate(motes)}
        self._xs_m = np.array([0.0] * len(robots) + [mote.place.x_m for mote in gateways])
        self._ys_m = np.array([0.0] * len(robots) + [mote.place.y_m for mote in gateways])
        self._places_tick = -1
        own_seed = rng.bit_generator.seed_seq
        assert isinstance(own_seed, np.random.SeedSequence)
        between = np.random.SeedSequence(own_seed.entropy, spawn_key=(*own_seed.spawn_key, BETWEEN_ROBOTS))
        self.between_robots = RobotAir(network.radio, between)
        self.mesh: MoteMesh | None = None
        """None if motes do not receive each other's packets."""
        kind = network.motes
        if motes and kind.mesh.hops:
            seed = np.random.SeedSequence(own_seed.entropy, spawn_key=(*own_seed.spawn_key, BETWEEN_MOTES))
            energy = energy_of(network.radio, kind.mesh.duty, kind.capacity_mah)
            rate_hz = 1.0 / kind.period_s
            self.mesh = MoteMesh(
                self.motes,
                kind.mesh,
                network.radio,
                energy,
                rate_hz,
                seed,
                tick_s,
                self._send_to_stations,
                self._near_stations,
                self._deliver,
            )
        self._inbox = Inbox()
        if motes or len(robots) > 1:
            endpoint.subscribe(self._inbox, ARENA_RADIO_TX)
        self._tick = 0
        self._wakes = [(mote.next_tick, index) for index, mote in enumerate(self.motes)]
        heapq.heapify(self._wakes)

    def step(self, robots: Sequence[Body]) -> None:
        """Advance by a tick: base stations' packets reach motes; motes whose time has come sense and send."""
        self._tick += 1
        if self._inbox.has_some:
            self._update_robot_places(robots)
            for received in self._inbox.drain():
                self._from_robot(received.names["robot"], received.message)
        while self._wakes and self._wakes[0][0] <= self._tick:
            tick, index = heapq.heappop(self._wakes)
            mote = self.motes[index]
            if mote.battery.is_flat or mote.next_tick != tick:  # flat for good, or woken at another time instead
                continue
            self._update_robot_places(robots)
            self._send(index, mote.wake(tick, self._field))
            heapq.heappush(self._wakes, (mote.next_tick, index))
        if self.mesh is not None:
            self._update_robot_places(robots)
            self.mesh.step(self._tick)

    def _send(self, index: int, message: ActiveMessage) -> None:
        is_received = self._send_to_stations(index, message)
        if self.mesh is not None:
            self.mesh.sent(index, message, self._tick, is_received=is_received)

    def _send_to_stations(self, index: int, message: ActiveMessage) -> bool:
        """To each base station in reach, with its own signal strength; whether there is one."""
        self.counters.sent += 1
        packet = message.pack()
        received = self._air[index].receivers_of(self._xs_m, self._ys_m)
        for station, rssi_dbm in received:
            self._receivers[station].put_bytes(with_rssi(packet, rssi_dbm))
        return bool(received)

    def _near_stations(self, least_dbm: float) -> list[int]:
        """Motes whose packets a base station receives at least at this mean strength."""
        return [index for index, air in enumerate(self._air) if air.best_dbm(self._xs_m, self._ys_m) >= least_dbm]

    def _from_robot(self, name: str, packet: bytes) -> None:
        robot = self._robot_index.get(name)
        try:
            message = ActiveMessage.unpack(packet)
        except BadPacket:
            return
        if robot is None:
            return
        if message.destination == BROADCAST:
            self._to_robots(robot, packet, is_beacon=message.type == BEACON_TYPE)
        if message.type == BEACON_TYPE:  # motes leave it alone
            return
        self.counters.sent += 1
        addressed = self._mote_index.get(message.destination)
        wanted = range(len(self.motes)) if message.destination == BROADCAST else [addressed]
        for index in wanted:
            if index is None:
                continue
            mote = self.motes[index]
            if mote.listens_at(self._tick) and self._air[index].receives(robot, self._xs_m, self._ys_m):
                if message.type != ROUTED_TYPE:
                    self._deliver(index, message)
                elif self.mesh is not None:
                    self.mesh.down.from_station(index, message.payload, self._tick)

    def _deliver(self, index: int, message: ActiveMessage) -> None:
        """Give a mote a packet that it has received."""
        mote = self.motes[index]
        before = mote.next_tick
        mote.receive(message, self._tick)
        if mote.next_tick != before:
            heapq.heappush(self._wakes, (mote.next_tick, index))

    def _to_robots(self, sender: int, packet: bytes, *, is_beacon: bool) -> None:
        robots = self._robots
        if sender >= robots:  # a gateway: robots ignore its messages
            return
        xs_m, ys_m = self._xs_m[:robots], self._ys_m[:robots]
        for robot, rssi_dbm in self.between_robots.receivers_of(sender, xs_m, ys_m, self._tick):
            self._receivers[robot].put_bytes(with_rssi(packet, rssi_dbm) if is_beacon else packet)

    def _update_robot_places(self, robots: Sequence[Body]) -> None:
        if self._places_tick != self._tick:
            self._places_tick = self._tick
            self._xs_m[: self._robots] = [robot.x_m for robot in robots]
            self._ys_m[: self._robots] = [robot.y_m for robot in robots]


class _Air:
    """Links between one mote and all robots; both directions are alike."""

    def __init__(
        self, mote: SimulatedMote, radio: RadioModel, rng: np.random.Generator, counters: RadioCounters
    ) -> None:
        self._place = mote.mote.place
        self._radio = radio
        self._shadow = ShadowField(radio.static_db, radio.correlation_m, rng)
        seed = rng.bit_generator.seed_seq
        assert isinstance(seed, np.random.SeedSequence)
        self._links = FadingLinks(radio, seed, counters)

    def receivers_of(self, xs_m: Floats, ys_m: Floats) -> list[tuple[int, float]]:
        """Robots that one packet reaches, with its strength in dBm at each."""
        return self._links.receivers_of(self._expected_dbm(xs_m, ys_m))

    def receives(self, robot: int, xs_m: Floats, ys_m: Floats) -> bool:
        """Whether one packet of a robot reaches the mote."""
        strength_dbm = float(self._expected_dbm(xs_m[robot : robot + 1], ys_m[robot : robot + 1])[0])
        return strength_dbm >= self._links.weakest_dbm and self._links.receive_dbm((robot,), strength_dbm) is not None

    def best_dbm(self, xs_m: Floats, ys_m: Floats) -> float:
        """Mean strength at which the nearest base station, by the links between, receives the mote."""
        return float(self._expected_dbm(xs_m, ys_m).max(initial=-np.inf))

    def _expected_dbm(self, xs_m: Floats, ys_m: Floats) -> Floats:
        distances_m = np.hypot(xs_m - self._place.x_m, ys_m - self._place.y_m)
        return self._radio.mean_rssi_dbm_of(distances_m) + self._shadow.at(xs_m, ys_m)
