"""Readings that motes pass on to base stations, hop by hop.

If no base station has received a mote's reading, the mote sends it to its next hop. The next hop acknowledges and
forwards it. Answers to requests are forwarded in the same manner. Packets of base stations for motes out of their reach
come down by `mesh_down`. Packets and acknowledgements meet the radio's path loss, shadowing and noise. A mote spends
energy on each packet that it sends or receives.

Next hops are those of `lifetime_routes`, from the links, the motes' energy, and the motes that are near base stations
at that time. Real motes agree on them by beacons; here they are computed in one place. The beacons' energy is counted,
not their losses.
"""

import heapq
from collections import deque
from collections.abc import Callable, Mapping, Sequence

import msgspec
import numpy as np

from robrain.algorithms.motes.mote_energy import CELL_V, OVERHEAD_BITS, MoteEnergy
from robrain.algorithms.motes.routes import NO_ROUTE, LinkGraph, Tree, lifetime_routes
from robrain.protocol.tinyos.packet import ActiveMessage, BadPacket
from robrain.protocol.tinyos.payloads import (
    DECI,
    FORWARDED_TYPE,
    READING_TYPE,
    STORED_TYPE,
    ForwardedPayload,
    ReadingPayload,
    RoutedPayload,
)
from robrain.sim.motes.mote import LOG_S, SENSE_S, MeshSpec, SimulatedMote
from robrain.sim.motes.radio import (
    AIRTIME_S,
    CPU_ACTIVE_MA,
    CPU_IDLE_MA,
    LOG_WRITE_MA,
    PACKET_BYTES,
    RECEIVE_MA,
    SENSOR_BOARD_MA,
    SLEEP_MA,
    FadingLinks,
    MoteState,
    RadioCounters,
    RadioModel,
    send_ma,
    shadow_of_pairs,
)

SEEN_DOWN = 16
"""Routed packets that a mote remembers, to pass on each once."""

Hand = Callable[[int, int, Callable[[], bool]], bool]
"""Sends a packet from a mote to another one, which accepts it by the function; returns whether that was acknowledged.
"""


class DownCounters(msgspec.Struct):
    """Counters of routed packets."""

    accepted: int = 0
    """From base stations."""
    passed_on: int = 0
    """By a mote, to the next one."""
    delivered: int = 0
    """To the mote that they were for."""
    undelivered: int = 0
    """Dropped because a next mote was dead, out of reach or never acknowledged."""
    refused: int = 0
    """Not taken for lack of room."""


class _Waiting(msgspec.Struct):
    """A routed packet at a mote."""

    at: int
    """Index of the mote."""
    routed: RoutedPayload
    failed: int = 0


class RoutedDown:
    """State of the motes' routed packets.

    Args:
        spec: tries, room and interval of waking.
        index_of: index of each mote by its number.
        hand: sends on a hop.
        deliver: gives a mote the packet that is for it.
        wake_ticks: interval of waking.

    """

    def __init__(
        self,
        spec: MeshSpec,
        index_of: Mapping[int, int],
        hand: Hand,
        deliver: Callable[[int, ActiveMessage], None],
        wake_ticks: int,
    ) -> None:
        self.counters = DownCounters()
        self._spec = spec
        self._index_of = index_of
        self._hand = hand
        self._deliver = deliver
        self._wake_ticks = wake_ticks
        self._due: list[tuple[int, int, _Waiting]] = []
        self._held: dict[int, int] = {}
        """Packets at each mote that holds any."""
        self._seen: dict[int, dict[tuple[int, int, int, bytes], None]] = {}
        self._number = 0

    def step(self, tick: int) -> None:
        """Send due packets."""
        while self._due and self._due[0][0] <= tick:
            self._pass_on(heapq.heappop(self._due)[2], tick)

    def from_station(self, index: int, payload: bytes, tick: int) -> None:
        """A mote has received a routed packet of a base station; an impossible packet is ignored."""
        try:
            routed = RoutedPayload.unpack(payload)
        except BadPacket:
            return
        self.counters.accepted += self._accept(index, routed, tick)

    def _accept(self, index: int, routed: RoutedPayload, tick: int) -> bool:
        """A mote receives a packet that it is to forward; whether it acknowledges it."""
        if self._held.get(index, 0) >= self._spec.queue:
            self.counters.refused += 1
            return False
        if not self._has_seen(index, routed):
            self._held[index] = self._held.get(index, 0) + 1
            self._wait(_Waiting(index, routed), tick)
        return True

    def _pass_on(self, waiting: _Waiting, tick: int) -> None:
        routed = waiting.routed
        to = self._index_of.get(routed.route[0])
        if to is not None and self._hand(waiting.at, to, lambda: self._arrive(to, routed, tick)):
            self.counters.passed_on += 1
        else:
            waiting.failed += 1
            if to is not None and waiting.failed < self._spec.tries:
                self._wait(waiting, tick)
                return
            self.counters.undelivered += 1
        self._held[waiting.at] -= 1

    def _arrive(self, index: int, routed: RoutedPayload, tick: int) -> bool:
        rest = msgspec.structs.replace(routed, route=routed.route[1:])
        if rest.route:
            return self._accept(index, rest, tick)
        if not self._has_seen(index, rest):
            self.counters.delivered += 1
            number = routed.route[0]
            self._deliver(index, ActiveMessage(type=routed.kind, payload=routed.inner, source=0, destination=number))
        return True

    def _wait(self, waiting: _Waiting, tick: int) -> None:
        self._number += 1
        heapq.heappush(self._due, (tick + self._wake_ticks, self._number, waiting))

    def _has_seen(self, index: int, routed: RoutedPayload) -> bool:
        seen = self._seen.setdefault(index, {})
        key = routed.kind, routed.serial, routed.route[-1] if routed.route else -1, routed.inner
        if key in seen:
            return True
        seen[key] = None
        if len(seen) > SEEN_DOWN:
            del seen[next(iter(seen))]
        return False


SHORT_S = OVERHEAD_BITS / 8 / PACKET_BYTES * AIRTIME_S
"""An acknowledgement or a beacon on the air."""
GAP_S = 0.04
"""Between two packets of a mote that passes several on."""
GOOD_DB = 5.0
"""Links count as good whose mean strength is so far above the sensitivity: by default, 99 of 100 packets arrive."""
PAUSE_WAKES = 4
"""First pause, in intervals of waking, after which a next hop that has not answered any attempt is tried once more.
Each further pause is twice as long (chosen).
"""
TREES = 8
"""Routes that are computed at once and used in turn (chosen)."""
SEEN = 128
"""Readings that a mote remembers to have passed on."""
REPEATS_S = 8.0
"""A reading that arrives again within this time was repeated because its acknowledgement was lost (chosen)."""
MILLI = 1e-3

SendToStations = Callable[[int, ActiveMessage], bool]
"""Sends a mote's packet to the base stations; returns whether one has received and acknowledged it."""


class MeshCounters(msgspec.Struct):
    """Counters of packets between motes."""

    sent: int = 0
    """To a next hop, repetitions included."""
    passed_on: int = 0
    """Readings taken in by a mote to be passed on."""
    repeated: int = 0
    """Readings that a mote had taken in before: its acknowledgement was lost."""
    refused: int = 0
    """Packets for which a mote had no room."""
    too_far: int = 0
    """Readings dropped because enough motes had passed them on; their own motes keep them."""
    waits: int = 0
    """Pauses of motes whose next hop did not answer."""


class _Packet(msgspec.Struct):
    """A reading in transit."""

    reading: ReadingPayload
    at_tick: int
    """Time at which its age was right."""
    kind: int = READING_TYPE
    hops: int = 0
    forwarder: int = 0

    def message(self, source: int, to: int | None, tick: int, tick_s: float) -> ActiveMessage:
        """As it is sent now."""
        waited_ds = round(DECI * (tick - self.at_tick) * tick_s)
        reading = msgspec.structs.replace(self.reading, age_ds=self.reading.age_ds + waited_ds)
        payload = ForwardedPayload(reading, self.forwarder, self.hops) if self.hops else reading
        message = ActiveMessage(type=self.kind, payload=payload.pack(), source=source)
        return message if to is None else msgspec.structs.replace(message, destination=to)


class _Station:
    """Packets that one mote has yet to forward."""

    def __init__(self) -> None:
        self.queue: deque[_Packet] = deque()
        self.due_tick = 0
        self.failed = 0
        """Packets in a row that were not acknowledged."""
        self.paused_tick = 0
        """Until then nothing is sent to the next hop, which has not answered or has no room."""
        self.unsent: deque[int] = deque()
        """Own readings in its log for which it had no route."""
        self.seen: dict[tuple[int, int], int] = {}
        """Readings that it has accepted, and the times at which it received them last."""

    def has_seen(self, packet: _Packet, tick: int, repeats_ticks: int) -> bool:
        """Whether it has taken this reading in a short while before; it remembers it from now on.

        A reading that comes again later was asked for because it did not arrive.
        """
        key = packet.reading.mote, packet.reading.sequence
        seen_tick = self.seen.pop(key, None)
        self.seen[key] = tick
        if seen_tick is not None and tick - seen_tick <= repeats_ticks:
            return True
        if len(self.seen) > SEEN:
            del self.seen[next(iter(self.seen))]
        return False


class MoteMesh:
    """The air between the motes, and the packets that they hold for each other.

    Args:
        motes: all of them.
        spec: settings of forwarding.
        radio: properties of the air.
        energy: energy of a mote's states and packets.
        rate_hz: readings a second of each mote.
        seed: seed of the randomness of each pair of motes.
        tick_s: length of a tick.
        send_to_stations: sends to base stations.
        near: motes whose packets a base station receives now, by the mean, at least at a strength in dBm.
        deliver: gives a mote a packet that has come to it over others.

    """

    def __init__(
        self,
        motes: Sequence[SimulatedMote],
        spec: MeshSpec,
        radio: RadioModel,
        energy: MoteEnergy,
        rate_hz: float,
        seed: np.random.SeedSequence,
        tick_s: float,
        send_to_stations: SendToStations,
        near: Callable[[float], list[int]],
        deliver: Callable[[int, ActiveMessage], None],
    ) -> None:
        self.counters = MeshCounters()
        self.air = RadioCounters()
        self.next_hops: Tree = [NO_ROUTE] * len(motes)
        """Of each mote; the number of motes stands for a base station."""
        self._motes = motes
        self._index = {mote.mote.number: index for index, mote in enumerate(motes)}
        self._spec, self._radio, self._energy, self._rate_hz = spec, radio, energy, rate_hz
        self._tick_s, self._send_to_stations, self._near = tick_s, send_to_stations, near
        self._sink = len(motes)
        self._stations = [_Station() for _ in motes]
        self._strengths_dbm = _strengths_dbm(motes, radio, seed)
        self._links = FadingLinks(radio, seed, self.air)
        self._wake_ticks = max(1, round(spec.wake_s / tick_s))
        self._repeats_ticks = round(REPEATS_S / tick_s)
        self._gap_ticks = max(1, round(GAP_S / tick_s))
        self._routes_ticks = max(1, round(spec.routes_s / tick_s))
        self._routes_tick = 0
        self._trees: list[Tree] = []
        self._made_for: tuple[list[int], list[int]] = [], []
        self._wakes: list[tuple[int, int]] = []
        self.down = RoutedDown(spec, self._index, self._hand, deliver, self._wake_ticks)
        """Packets of base stations for motes out of their reach."""

    def step(self, tick: int) -> None:
        """Choose routes if it is time, and send due packets."""
        if tick >= self._routes_tick:
            self._routes_tick = tick + self._routes_ticks
            self._choose()
        while self._wakes and self._wakes[0][0] <= tick:
            due_tick, index = heapq.heappop(self._wakes)
            if self._stations[index].due_tick == due_tick:
                self._send(index, tick)
        self.down.step(tick)

    def sent(self, index: int, message: ActiveMessage, tick: int, *, is_received: bool) -> None:
        """A mote has just sent its own reading, or one of its log; whether a base station has received it."""
        station = self._stations[index]
        packet = _Packet(ReadingPayload.unpack(message.payload), tick, message.type)
        is_stored = message.type == STORED_TYPE  # asked for: it is asked for again if it does not arrive
        is_paused = tick < station.paused_tick
        if is_received or (not is_paused and self._reach_next(index, packet, tick)):
            station.failed = 0
            if not is_stored:
                self._catch_up(index, tick)
        elif is_paused or self.next_hops[index] == NO_ROUTE or len(station.queue) >= self._spec.queue:
            if not is_stored:
                self._keep(index)
        else:
            self._put(index, packet, tick, self._wake_ticks)

    # -- sending --------------------------------------------------------------------------------------------

    def _send(self, index: int, tick: int) -> None:
        station, mote = self._stations[index], self._motes[index]
        if not station.queue or mote.battery.is_flat:
            return
        hop = self.next_hops[index]
        if hop == NO_ROUTE or tick < station.paused_tick:
            self._wake(index, max(tick + self._wake_ticks, station.paused_tick))
            return
        packet = station.queue[0]
        if packet.hops >= self._spec.hops and hop != self._sink:
            self.counters.too_far += 1
            station.queue.popleft()
            self._wake(index, tick + self._gap_ticks)
            return
        to = self._motes[hop].mote.number if hop != self._sink else None
        mote.battery.spend(MoteState.SEND, AIRTIME_S)
        message = packet.message(mote.mote.number, to, tick, self._tick_s)
        if self._send_to_stations(index, message) or self._reach_next(index, packet, tick):
            station.failed = 0
            station.queue.popleft()
            self._wake(index, tick + self._gap_ticks)
            return
        station.failed += 1
        if station.failed >= self._spec.tries:
            self.counters.waits += 1
            pause_ticks = (PAUSE_WAKES * self._wake_ticks) << (station.failed - self._spec.tries)
            station.paused_tick = tick + min(pause_ticks, self._routes_ticks)
        self._wake(index, tick + self._wake_ticks)

    def _reach_next(self, index: int, packet: _Packet, tick: int) -> bool:
        """Whether the next hop has received a packet that was sent, and its acknowledgement has come back."""
        hop = self.next_hops[index]
        if hop in (NO_ROUTE, self._sink):
            return False
        self.counters.sent += 1
        return self._receive(index, hop, lambda: self._accept(hop, index, packet, tick))

    def _hand(self, index: int, hop: int, accept: Callable[[], bool]) -> bool:
        """Send a packet that comes from a base station on to a mote; whether it has acknowledged it."""
        if self._motes[index].battery.is_flat:
            return False
        self._motes[index].battery.spend(MoteState.SEND, AIRTIME_S)
        return self._receive(index, hop, accept)

    def _receive(self, index: int, hop: int, accept: Callable[[], bool]) -> bool:
        """Whether a mote receives a packet of another one and accepts it, and its acknowledgement comes back."""
        self._motes[index].battery.spend(MoteState.LISTEN, SHORT_S)
        other = self._motes[hop]
        if other.battery.is_flat or not self._arrives(index, hop):
            return False
        other.battery.spend(MoteState.LISTEN, AIRTIME_S)
        if not accept():
            return False
        other.battery.spend(MoteState.SEND, SHORT_S)
        return self._arrives(hop, index)

    def _accept(self, index: int, sender: int, packet: _Packet, tick: int) -> bool:
        """A mote receives a neighbour's packet; whether it acknowledges it."""
        station = self._stations[index]
        if len(station.queue) >= self._spec.queue:
            self.counters.refused += 1
            return False
        if station.has_seen(packet, tick, self._repeats_ticks):
            self.counters.repeated += 1
            return True
        self.counters.passed_on += 1
        first = packet.forwarder if packet.hops else self._motes[index].mote.number
        self._put(
            index,
            _Packet(packet.reading, packet.at_tick, FORWARDED_TYPE, packet.hops + 1, first),
            tick,
            self._wake_ticks,
        )
        return True

    def _arrives(self, sender: int, receiver: int) -> bool:
        if receiver not in self._strengths_dbm[sender]:
            return False
        return self._links.receive_dbm((sender, receiver), self._strengths_dbm[sender][receiver]) is not None

    def _put(self, index: int, packet: _Packet, tick: int, after_ticks: int) -> None:
        station = self._stations[index]
        station.queue.append(packet)
        if len(station.queue) == 1:
            self._wake(index, tick + after_ticks)

    def _wake(self, index: int, tick: int) -> None:
        self._stations[index].due_tick = tick
        if self._stations[index].queue:
            heapq.heappush(self._wakes, (tick, index))

    def _keep(self, index: int) -> None:
        """There is no route for a mote's newest reading: it stays in its log."""
        unsent = self._stations[index].unsent
        unsent.append(self._motes[index].newest)
        if len(unsent) > self._motes[index].log.capacity:
            unsent.popleft()

    def _catch_up(self, index: int, tick: int) -> None:
        """There is a route again: an older reading may follow each new one."""
        station = self._stations[index]
        while station.unsent and len(station.queue) < self._spec.queue:
            reading = self._motes[index].stored(station.unsent.popleft(), tick)
            if reading is not None:
                self._put(index, _Packet(reading, tick, STORED_TYPE), tick, self._gap_ticks)
                return

    # -- routes ---------------------------------------------------------------------------------------------

    def _choose(self) -> None:
        alive = [index for index, mote in enumerate(self._motes) if not mote.battery.is_flat]
        flat = {index for index, mote in enumerate(self._motes) if mote.battery.is_flat}
        near = [index for index in self._near(self._radio.sensitivity_dbm) if index not in flat]
        for index in alive:
            battery = self._motes[index].battery
            battery.spend(MoteState.SEND, SHORT_S)
            battery.spend(MoteState.LISTEN, SHORT_S * len(self._strengths_dbm[index]))
        if not self._trees or self._made_for != (alive, near):
            self._made_for = alive, near
            self._trees = self._plan(alive, near)
        before, self.next_hops = self.next_hops, self._trees.pop(0)
        for station, old, new in zip(self._stations, before, self.next_hops, strict=True):
            if old != new:
                station.failed = station.paused_tick = 0

    def _plan(self, alive: list[int], near: list[int]) -> list[Tree]:
        """Routes over good links; motes that have none to a base station use weaker ones."""
        good_dbm = self._radio.sensitivity_dbm + GOOD_DB
        well = set(self._near(good_dbm))
        graph = LinkGraph([*self._linked(good_dbm, set()), [index for index in near if index in well]])
        cut_off = set(alive) - graph.reachable(alive)
        if cut_off:
            graph = LinkGraph(
                [*self._linked(good_dbm, cut_off), [index for index in near if index in well or index in cut_off]]
            )
        left_j = [mote.battery.left_share * self._energy.capacity_j for mote in self._motes]
        return lifetime_routes(graph, left_j, alive, self._energy, self._rate_hz, TREES).trees

    def _linked(self, good_dbm: float, content: set[int]) -> list[list[int]]:
        """Neighbours of each mote by good links; by any link for, and between, motes that accept weaker ones."""
        return [
            sorted(
                other
                for other, strength_dbm in strengths.items()
                if strength_dbm >= good_dbm or index in content or other in content
            )
            for index, strengths in enumerate(self._strengths_dbm)
        ]


def energy_of(radio: RadioModel, duty: float, capacity_mah: float) -> MoteEnergy:
    """Energy of a simulated mote's states and packets, as routes are computed from it."""
    send_w = CELL_V * MILLI * (CPU_ACTIVE_MA + send_ma(radio.transmit_dbm))
    listen_w = CELL_V * MILLI * (CPU_IDLE_MA + RECEIVE_MA)
    asleep_w = CELL_V * MILLI * SLEEP_MA
    sense_w, log_w = CELL_V * MILLI * (CPU_ACTIVE_MA + SENSOR_BOARD_MA), CELL_V * MILLI * (CPU_ACTIVE_MA + LOG_WRITE_MA)
    return MoteEnergy(
        capacity_j=CELL_V * MILLI * capacity_mah * 3600.0,
        asleep_w=asleep_w,
        awake_w=(1.0 - duty) * asleep_w + duty * listen_w,
        reading_j=sense_w * SENSE_S + log_w * LOG_S,
        send_j=send_w * AIRTIME_S + listen_w * SHORT_S,
        receive_j=listen_w * AIRTIME_S + send_w * SHORT_S,
        hand_over_j=send_w * AIRTIME_S,
        beacon_send_j=send_w * SHORT_S,
        beacon_receive_j=listen_w * SHORT_S,
    )


def _strengths_dbm(
    motes: Sequence[SimulatedMote], radio: RadioModel, seed: np.random.SeedSequence
) -> list[dict[int, float]]:
    """Mean strength at which each mote receives others, of those in reach; alike in both directions.

    Shadowing belongs to the places of both ends, as between robots (`RobotAir`).
    """
    xs_m = np.array([mote.mote.place.x_m for mote in motes])
    ys_m = np.array([mote.mote.place.y_m for mote in motes])
    shadows_db = shadow_of_pairs(radio, seed).at(xs_m, ys_m)
    found: list[dict[int, float]] = []
    for index in range(len(motes)):
        distances_m = np.hypot(xs_m - xs_m[index], ys_m - ys_m[index])
        strengths_dbm = radio.mean_rssi_dbm_of(distances_m) + shadows_db + shadows_db[index]
        received = np.flatnonzero(strengths_dbm >= radio.sensitivity_dbm).tolist()
        found.append({other: float(strengths_dbm[other]) for other in received if other != index})
    return found
