"""SNwExploration: the robot is the relay between the mote network and the global one."""

from collections.abc import Iterable
from typing import Annotated

import msgspec
from msgspec import UNSET, Meta

from robrain.agent.event import Event
from robrain.agent.plugin import Unit, external
from robrain.plugins.device.mote_base.interface import MoteBaseInterface, ReceivedPacket
from robrain.plugins.unit.snw_exploration.asking import Asking, AskingParameters, OverHops
from robrain.plugins.unit.snw_exploration.interface import ReceivedMote, ReceivedRobot, RssiMeasurement, SnwInterface
from robrain.plugins.unit.snw_exploration.mote_record import MoteRecord, ReadingStore, place_of
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.keys import is_name
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.motes.mote_messages import MOTE_DUTY, MOTE_READING, MoteDuty, MoteReading
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_LINKS, RadioLink, RobotLinks
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import NotNegativeInt, Positive, PositiveInt
from robrain.protocol.tinyos.packet import BROADCAST, BadPacket
from robrain.protocol.tinyos.payloads import (
    ACKNOWLEDGE_TYPE,
    BEACON_TYPE,
    CENTI,
    DECI,
    DUTY_TYPE,
    FORWARDED_TYPE,
    MAX_NAME_BYTES,
    READING_TYPE,
    SEQUENCES,
    STORED_TYPE,
    BeaconPayload,
    DutyPayload,
    ForwardedPayload,
    Quantity,
    ReadingPayload,
    sequences_after,
)

MAX_ROBOTS = 256


class _Link:
    """Reception of one other robot."""

    def __init__(self) -> None:
        self.sequence = -1
        self.packets = 0
        self.missed = 0
        self.sum_dbm = 0.0
        self.rssi_dbm = 0.0
        self.stamp_ns = 0


class BaseLinks:
    """The received base stations, and the robot's own beacons.

    Args:
        robot: its own name.

    """

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self.has_teammates = self._has_reported = False
        self._sequence = 0
        self._links: dict[str, _Link] = {}

    def record_robot(self, robot: str) -> None:
        """Record that a robot of this name is in the team."""
        self.has_teammates |= robot != self._robot

    def beacon(self) -> bytes | None:
        """The payload of its next beacon; None for a robot without teammates, or with too long a name.

        A robot that has lost all others on the wire continues: the radio matters then.
        """
        if not self.has_teammates or len(self._robot.encode()) > MAX_NAME_BYTES:
            return None
        self._sequence = (self._sequence + 1) % SEQUENCES
        return BeaconPayload(self._sequence, self._robot).pack()

    def receive(self, payload: bytes, stamp_ns: int) -> None:
        """Handle a received beacon.

        Raises:
            BadPacket: it is none, its name is no robot's, or it is one robot too many.

        """
        beacon = BeaconPayload.unpack(payload)
        link = self._links.get(beacon.robot)
        if link is None:
            if not is_name(beacon.robot) or beacon.robot == self._robot or len(self._links) >= MAX_ROBOTS:
                raise BadPacket(f"expected one of at most {MAX_ROBOTS} other robots, got {beacon.robot!r}")
            link = self._links[beacon.robot] = _Link()
        elif 0 < (gap := sequences_after(beacon.sequence, link.sequence)) < SEQUENCES // 4:  # else it was restarted
            link.missed += gap - 1
        link.sequence, link.stamp_ns, link.rssi_dbm = beacon.sequence, stamp_ns, float(beacon.rssi_dbm)
        link.packets += 1
        link.sum_dbm += beacon.rssi_dbm

    def received(self) -> list[ReceivedRobot]:
        """The received robots, by name."""
        return [
            ReceivedRobot(
                robot=name,
                rssi_dbm=link.rssi_dbm,
                mean_rssi_dbm=link.sum_dbm / link.packets,
                stamp_ns=link.stamp_ns,
                packets=link.packets,
                missed=link.missed,
            )
            for name, link in sorted(self._links.items())
        ]

    def message(self, now_ns: int, fresh_ns: int, motes: Iterable[MoteRecord]) -> RobotLinks | None:
        """The received motes and robots, for the team; None if there were none since the last one.

        Args:
            now_ns: by the robot's clock.
            fresh_ns: longest time since a reception that counts; for a mote also three of its periods.
            motes: those that are known.

        """
        links = [
            RadioLink(peer=name, is_robot=True, rssi_dbm=link.rssi_dbm, last_seen_ns=link.stamp_ns)
            for name, link in sorted(self._links.items())
            if now_ns - link.stamp_ns <= fresh_ns
        ]
        for mote in motes:
            received = mote.latest
            if received is None:
                continue
            age_ns = now_ns - mote.stamp_ns
            if age_ns <= fresh_ns or age_ns <= 3 * received.period_ds * (NS_PER_S // DECI):
                links.append(RadioLink(peer=mote.name, rssi_dbm=float(received.rssi_dbm), last_seen_ns=mote.stamp_ns))
        if not links and not self._has_reported:
            return None
        self._has_reported = bool(links)
        return RobotLinks(robot=self._robot, links=links)


IN_REACH_NS = to_ns(15.0)
"""Time after a reception for which a mote is only addressed directly."""
PREFIX = "m"
"""A mote's name on the wire is this and its number."""
QUANTITIES = {int(quantity): quantity.wire_name for quantity in Quantity}


class SnwCounters(msgspec.Struct):
    """Counters of the packets received."""

    readings: int
    """Readings put on the wire."""
    repeated: int
    """Readings that had arrived before, from the mote or by another robot."""
    unreadable: int
    """Invalid packets of the types of readings or beacons."""
    requests: int
    acknowledgements: int
    duties: int
    """Duty commands sent."""
    duties_given_up: int
    over_hops: int
    """Requests, acknowledgements and duties that other motes were given to pass on."""
    refused: int
    """Impossible requests and readings on the wire, and motes beyond the limit."""


class SNwExploration(Unit):
    """Collects readings from motes in range, publishes each once, and sends motes requests and duties.

    A mote listens only for a moment after it has sent: packets to it are sent at its reception. Once another robot has
    been there, it also sends a beacon at intervals, so that base stations measure their links. Its received motes and
    robots are published as `robot/R/links`.
    """

    class Parameters(AskingParameters, frozen=True, forbid_unknown_fields=True):
        """Rates of requests to motes."""

        collect: bool = True
        max_motes: PositiveInt = 4096
        window: Annotated[int, Meta(ge=1, le=1 << 15)] = 4096
        acknowledge_every: PositiveInt = 8
        duty_tries: PositiveInt = 20
        beacon_s: Positive = 1.0
        """Time between two beacons. With every second beacon, the robot publishes its received motes and robots."""
        link_fresh_s: Positive = 5.0
        """Time of silence, or three periods of a mote, after which a link is no longer published."""
        store_readings: NotNegativeInt = 0
        """Number of readings to store while there is no coordinator, for later; 0: readings are published at once."""

    interface = SnwInterface
    period_s = 0.05
    measured = Event[RssiMeasurement]()
    parameters: Parameters

    def init(self) -> None:
        self._records: dict[int, MoteRecord] = {}
        self._counts = SnwCounters(*[0] * len(SnwCounters.__struct_fields__))
        self._asking = Asking(self.parameters, self._send)
        self._over_hops = OverHops(self._send, self.parameters.acknowledge_every)
        self._links = BaseLinks(self.env.robot)
        self._next_beacon_ns = 0
        self._publishes_links = True

    def activate(self) -> None:
        self._inbox = Inbox()
        self._base = self.env.use("mote_base", MoteBaseInterface)
        self.env.observe(self._base.received, self._handle)
        self.env.wire.subscribe(self._inbox, MOTE_READING)
        self.env.wire.subscribe(self._inbox, MOTE_DUTY)
        self._alive = self.env.wire.watch(ROBOT_ALIVE)
        capacity = self.parameters.store_readings
        self._store = ReadingStore(self.env.wire, capacity, self._put) if capacity else None
        self._links_out = self.env.wire.publisher(ROBOT_LINKS, robot=self.env.robot)

    def step(self) -> None:
        self._receive_team()
        now_ns = self.env.clock.now_ns()
        if self._store is not None:
            self._store.step(now_ns)
        self._asking.step(now_ns)
        if now_ns >= self._next_beacon_ns:
            self._next_beacon_ns = now_ns + to_ns(self.parameters.beacon_s)
            self._speak_to_robots(now_ns)

    def deactivate(self) -> None:
        for record in self._records.values():
            record.publisher = None  # it ends with the plugin's place on the wire

    @external
    def motes(self) -> list[ReceivedMote]:
        """The motes that this robot has received, by number."""
        rows = (self._records[number].as_received() for number in sorted(self._records))
        return [row for row in rows if row is not None]

    @external
    def robots(self) -> list[ReceivedRobot]:
        """The robots whose base stations this robot has received, by name."""
        return self._links.received()

    @external
    def request_stored(self, mote: str) -> None:
        """Request missing readings from a mote at its next reception.

        Raises:
            ValueError: that is no mote's name.

        """
        self._wanted(mote).is_asked_for = True

    @external
    def set_duty(self, mote: str, period_s: float) -> None:
        """Set a mote's period of measuring at its next reception.

        Raises:
            ValueError: that is no mote's name, or no period that a mote can have.

        """
        period_ds = DutyPayload.of_seconds(period_s).period_ds
        self._wanted(mote).want_period(period_ds, self.env.clock.now_ns())

    @external
    def counters(self) -> SnwCounters:
        """Counters of the packets received."""
        return msgspec.structs.replace(self._counts, requests=self._asking.requests, over_hops=self._over_hops.sent)

    def _handle(self, packet: ReceivedPacket) -> None:
        message = packet.message
        try:
            if message.type == BEACON_TYPE:
                self._links.receive(message.payload, packet.stamp_ns)
            if message.type == FORWARDED_TYPE:
                self._handle_forwarded(ForwardedPayload.unpack(message.payload), packet.stamp_ns)
            if message.type not in (READING_TYPE, STORED_TYPE):
                return
            reading = ReadingPayload.unpack(message.payload)
        except BadPacket:
            self._counts.unreadable += 1
            return
        record = self._record(reading.mote)
        if record is None:
            return
        record.record_packet(reading, packet.stamp_ns, self._place())
        self._add(record, reading, packet.stamp_ns, is_live=message.type == READING_TYPE)
        if message.type == READING_TYPE:  # a stored reading reports an earlier state
            record.window.mote_holds_from(reading.oldest)
        self.measured.notify(
            RssiMeasurement(
                mote=record.name, place=place_of(reading), rssi_dbm=reading.rssi_dbm, stamp_ns=packet.stamp_ns
            )
        )
        if message.type == STORED_TYPE:
            record.record_answer(reading.sequence)
        self._answer(record, reading, packet.stamp_ns)
        self._over_hops.record(record.number, packet.stamp_ns)

    def _handle_forwarded(self, forwarded: ForwardedPayload, stamp_ns: int) -> None:
        """Handle a reading that came over other motes; its mote is reachable by the same route."""
        record = self._record(forwarded.reading.mote)
        if record is None:
            return
        self._add(record, forwarded.reading, stamp_ns, is_live=False, route=forwarded)
        is_in_reach = record.latest is not None and stamp_ns - record.stamp_ns <= IN_REACH_NS
        if self.parameters.collect and not is_in_reach:
            self._over_hops.received_forwarded(record, forwarded.reading, forwarded.forwarder, stamp_ns)

    def _add(
        self,
        record: MoteRecord,
        reading: ReadingPayload,
        stamp_ns: int,
        *,
        is_live: bool,
        route: ForwardedPayload | None = None,
    ) -> None:
        """Publish a reading, unless it has arrived before."""
        self._receive_team()  # another robot may have put it on the wire a moment ago
        if not record.window.add(reading.sequence, is_live=is_live):
            self._counts.repeated += 1
            return
        record.readings += 1
        self._counts.readings += 1
        if record.publisher is None:
            record.publisher = self.env.wire.publisher(MOTE_READING, mote=record.name)
        message = wire_reading(reading, self.env.robot, stamp_ns, route)
        if self._store is None:
            record.publisher.put(message)
        else:
            self._store.publish(message)

    def _put(self, reading: MoteReading) -> None:
        """Put a reading that was stored on the wire."""
        publisher = self._wanted(reading.mote).publisher
        assert publisher is not None  # made before the reading was given to the store
        publisher.put(reading)

    def _answer(self, record: MoteRecord, reading: ReadingPayload, now_ns: int) -> None:
        """Send the waiting packets while the mote listens."""
        window = record.window
        self._counts.duties_given_up += record.forget_duty(reading.period_ds, self.parameters.duty_tries)
        if record.wanted_period_ds is not None:
            record.duty_tries += 1
            self._counts.duties += 1
            self._base.send(record.number, DUTY_TYPE, DutyPayload(record.wanted_period_ds).pack())
        if record.asked is not None and (now_ns >= record.asked_until_ns or not window.lacks(record.asked)):
            record.asked = None
        if record.asked is not None:  # it is still answering
            return
        if self.parameters.collect or record.is_asked_for:
            is_owing = self._asking.ask(record, now_ns)
            record.is_asked_for = record.is_asked_for and is_owing
        complete = window.complete()
        if complete is not None and complete[1] >= self.parameters.acknowledge_every:
            self._counts.acknowledgements += 1
            self._base.send(record.number, ACKNOWLEDGE_TYPE, complete[0].pack())

    def _send(self, mote: int, kind: int, payload: bytes) -> None:
        self._base.send(mote, kind, payload)

    def _speak_to_robots(self, now_ns: int) -> None:
        if not self._links.has_teammates:
            for change in self._alive.changes():
                self._links.record_robot(change.names["robot"])
        beacon = self._links.beacon()
        if beacon is not None:
            self._base.send(BROADCAST, BEACON_TYPE, beacon)
        self._publishes_links = not self._publishes_links
        if self._publishes_links:
            return
        message = self._links.message(now_ns, to_ns(self.parameters.link_fresh_s), self._records.values())
        if message is not None:
            self._links_out.put(message)

    def _receive_team(self) -> None:
        if not self._inbox.has_some:
            return
        for received in self._inbox.drain():
            message = received.message
            if isinstance(message, MoteReading) and (message.via == self.env.robot or message.sequence is None):
                continue
            try:
                record = self._record(number_of(message.mote))
                if record is None:
                    continue
                if isinstance(message, MoteReading):
                    # A reading from another robot shows nothing about order: it may be a stored one.
                    record.window.add((message.sequence or 0) & 0xFFFF, is_live=False)
                elif isinstance(message, MoteDuty):
                    # A stamp in the future, from a wrong clock, would override all later requests until then.
                    stamp_ns = min(message.stamp_ns, self.env.clock.now_ns())
                    record.want_period(DutyPayload.of_seconds(message.period_s).period_ds, stamp_ns)
            except ValueError:
                self._counts.refused += 1

    def _wanted(self, mote: str) -> MoteRecord:
        record = self._record(number_of(mote))
        if record is None:
            raise ValueError(f"expected one of the {self.parameters.max_motes} known motes, got {mote!r}")
        return record

    def _record(self, number: int) -> MoteRecord | None:
        """Record of a mote; None if it exceeds the limit."""
        record = self._records.get(number)
        if record is None:
            if len(self._records) >= self.parameters.max_motes:
                self._counts.refused += 1
                return None
            record = self._records[number] = MoteRecord(f"{PREFIX}{number}", number, self.parameters.window)
        return record

    def _place(self) -> Point2D | None:
        pose = self.env.board.pose
        return Point2D(pose.x_m, pose.y_m) if pose is not None else None


def wire_reading(
    reading: ReadingPayload, via: str, stamp_ns: int, route: ForwardedPayload | None = None
) -> MoteReading:
    """The message that publishes a reading to the team.

    Args:
        reading: payload that the base station received.
        via: name of the base station's robot or gateway.
        stamp_ns: time of the reception.
        route: hops and forwarder, if other motes forwarded the reading.

    """
    return MoteReading(
        mote=f"{PREFIX}{reading.mote}",
        place=place_of(reading),
        quantity=QUANTITIES.get(reading.quantity, f"quantity_{reading.quantity}"),
        value=reading.value_centi / CENTI,
        voltage_v=reading.voltage_mv / 1000,
        rssi_dbm=reading.rssi_dbm,
        via=via,
        sequence=reading.sequence,
        measured_ns=stamp_ns - reading.age_ds * (NS_PER_S // DECI),
        period_s=reading.period_ds / DECI,
        stored=max(0, sequences_after(reading.sequence, reading.oldest)),
        hops=UNSET if route is None else route.hops,
        forwarder=UNSET if route is None else f"{PREFIX}{route.forwarder}",
    )


def number_of(mote: str) -> int:
    """A mote's number by its name on the wire.

    Raises:
        ValueError: that is no mote's name.

    """
    digits = mote.removeprefix(PREFIX)
    if not (mote.startswith(PREFIX) and digits.isascii() and digits.isdigit() and int(digits) < BROADCAST):
        raise ValueError(f"expected a mote's name, {PREFIX} and its number, got {mote!r}")
    return int(digits)
