"""Simulated gateways: beside a mote stands a base station with mains power, which has a radio of the team's network.

It does for readings the same as a robot's sensor network unit (`plugins/unit/snw_exploration`), and no more. It
publishes the readings that it receives, stores them while the network is away, and acknowledges them. If motes forward
readings, the gateway also requests missing readings. It sends motes their duty, over hops where they are out of its
reach.
"""

from collections.abc import Iterable, Sequence

from robrain.plugins.unit.snw_exploration.asking import OverHops
from robrain.plugins.unit.snw_exploration.mote_record import MoteRecord, ReadingStore
from robrain.plugins.unit.snw_exploration.snw_exploration import PREFIX, number_of, wire_reading
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.messages.motes.mote_messages import MOTE_DUTY, MOTE_READING, MoteReading
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_RX, ARENA_RADIO_TX
from robrain.protocol.tinyos.packet import ActiveMessage, BadPacket
from robrain.protocol.tinyos.payloads import (
    ACKNOWLEDGE_TYPE,
    FORWARDED_TYPE,
    READING_TYPE,
    STORED_TYPE,
    DutyPayload,
    ForwardedPayload,
    ReadingPayload,
)
from robrain.protocol.wire.endpoint import Endpoint
from robrain.sim.errors import ScenarioError
from robrain.sim.motes.mote import ArenaMote

ADDRESS = 0
"""Of base stations on the air."""
WINDOW = 4096
"""Number of latest sequence numbers of a mote that are distinguished."""
ACKNOWLEDGED_TOGETHER = 8


class MoteGateway:
    """One gateway.

    Args:
        name: its own, which is that of its mote.
        wire: its endpoint on the team's network.
        capacity: readings that it stores.

    """

    def __init__(self, name: str, wire: Endpoint, capacity: int) -> None:
        self.name = name
        self.store = ReadingStore(wire, capacity, self._put)
        self._wire = wire
        self._inbox = Inbox(4096)
        self._radio = wire.publisher(ARENA_RADIO_TX, robot=name)
        self._records: dict[int, MoteRecord] = {}
        self._publishers: dict[str, Publisher] = {}
        self._over_hops = OverHops(self._send, ACKNOWLEDGED_TOGETHER)
        self._is_meshed = False
        """Whether a reading has come over other motes."""
        self._duties = Inbox(4096)
        wire.subscribe(self._inbox, ARENA_RADIO_RX, robot=name)
        wire.subscribe(self._duties, MOTE_DUTY)

    def step(self) -> None:
        """Receive the packets of the base station, and forward stored readings."""
        now_ns = self._wire.clock.now_ns()
        self.store.step(now_ns)
        if self._duties.has_some:
            self._receive_duties(now_ns)
        if not self._inbox.has_some:
            return
        for _, _, packet in self._inbox.drain_raw():
            try:
                self._receive(ActiveMessage.unpack(packet), now_ns)
            except BadPacket:
                continue

    def _receive(self, message: ActiveMessage, now_ns: int) -> None:
        forwarded = None
        if message.type == FORWARDED_TYPE:
            forwarded = ForwardedPayload.unpack(message.payload)
            reading = forwarded.reading
        elif message.type in (READING_TYPE, STORED_TYPE):
            reading = ReadingPayload.unpack(message.payload)
        else:
            return
        record = self._record(reading.mote)
        is_live = message.type == READING_TYPE
        is_new = record.window.add(reading.sequence, is_live=is_live)
        if is_live:
            record.window.mote_holds_from(reading.oldest)
        if is_new:
            self.store.publish(wire_reading(reading, self.name, now_ns, forwarded))
        complete = record.window.complete() if forwarded is None else None
        if complete is not None and complete[1] >= ACKNOWLEDGED_TOGETHER:
            answer = ActiveMessage(
                type=ACKNOWLEDGE_TYPE, payload=complete[0].pack(), source=ADDRESS, destination=record.number
            )
            self._radio.put_bytes(answer.pack())
        if forwarded is not None:
            self._is_meshed = True
            self._over_hops.received_forwarded(record, reading, forwarded.forwarder, now_ns)
        elif self._is_meshed:
            self._over_hops.received_direct(record, reading, now_ns)

    def _receive_duties(self, now_ns: int) -> None:
        for received in self._duties.drain():
            duty = received.message
            try:
                record = self._record(number_of(duty.mote))
                record.want_period(DutyPayload.of_seconds(duty.period_s).period_ds, min(duty.stamp_ns, now_ns))
            except ValueError:
                continue

    def _record(self, number: int) -> MoteRecord:
        record = self._records.get(number)
        if record is None:
            record = self._records[number] = MoteRecord(f"{PREFIX}{number}", number, WINDOW)
        return record

    def _send(self, mote: int, kind: int, payload: bytes) -> None:
        message = ActiveMessage(type=kind, payload=payload, source=ADDRESS, destination=mote)
        self._radio.put_bytes(message.pack())

    def _put(self, reading: MoteReading) -> None:
        publisher = self._publishers.get(reading.mote)
        if publisher is None:
            publisher = self._publishers[reading.mote] = self._wire.publisher(MOTE_READING, mote=reading.mote)
        publisher.put(reading)


def gateway_motes(motes: Sequence[ArenaMote], names: Iterable[str]) -> list[ArenaMote]:
    """Motes with these names; other names are of robots."""
    return [mote for mote in motes if mote.name in set(names)]


def check_gateways(names: Sequence[str], robots: Sequence[str], motes: Sequence[ArenaMote], where: str) -> None:
    """Check that gateways are robots or motes that there are.

    Raises:
        ScenarioError: naming `where`, key and name.

    """
    known = {*robots, *(mote.name for mote in motes)}
    for name in names:
        if name not in known:
            there = f"robots r1 to r{len(robots)}" + (f" and motes m1 to m{len(motes)}" if motes else "")
            raise ScenarioError(f"{where}: motes: gateways: no robot or mote {name!r}; there are {there}")
        if list(names).count(name) > 1:
            raise ScenarioError(f"{where}: motes: gateways: expected each name once, got {name!r} twice")
