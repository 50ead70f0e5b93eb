"""What a robot makes of the packets that its base station hears, and what it says to the motes."""

import pytest

from robrain.plugins.unit.snw_exploration.asking import FRESH_NS, WAIT_NS, OverHops
from robrain.plugins.unit.snw_exploration.mote_record import FORWARD_NS, MoteRecord, ReadingStore, place_of
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError
from robrain.protocol.messages.motes.mote_messages import MOTE_DUTY, MOTE_READING, MoteDuty, MoteReading
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_TX
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.tinyos.packet import ActiveMessage
from robrain.protocol.tinyos.payloads import (
    ACKNOWLEDGE_TYPE,
    DUTY_TYPE,
    FORWARDED_TYPE,
    NO_PLACE,
    READING_TYPE,
    REQUEST_TYPE,
    ROUTE_MAX,
    ROUTED_TYPE,
    STORED_TYPE,
    DutyPayload,
    ForwardedPayload,
    Quantity,
    ReadingPayload,
    RequestPayload,
    RoutedPayload,
    SequenceRange,
)
from robrain.protocol.wire.endpoint import Drive, Endpoint

# TinyOS 2 serial packets, written out by hand: dispatch, destination, source, length, group, AM type; then the mote's
# number, sequence, oldest, age and period in 0.1 s, mV, quantity, hundredths, x and y in 0.1 m, dBm.
WARM = bytes.fromhex("00 ffff 0003 18 22 52  0003 0102 0102 00000000 0028 0b54 01 00000866 0032 ffec b5")
DARK = bytes.fromhex("00 ffff 0007 18 22 53  0007 ffff fff0 000004b0 0bb8 0834 02 fffffe0c 0000 0141 a6")
SHORT_READING = bytes.fromhex("00 ffff 0003 04 22 52  0003 0102")
MALFORMED = [b"", b"\x00\xff", WARM[:-1], WARM + b"\x00", b"\x45" + WARM[1:]]


def packet(sequence, *, mote=3, kind=READING_TYPE, oldest=None, rssi_dbm=-70, **changes):
    reading = ReadingPayload(
        mote=mote,
        sequence=sequence,
        oldest=sequence if oldest is None else oldest,
        rssi_dbm=rssi_dbm,
        **{"period_ds": 40, "voltage_mv": 2900, "quantity": Quantity.TEMPERATURE, "value_centi": 2150}
        | {"x_dm": 50, "y_dm": -20}
        | changes,
    )
    return ActiveMessage(type=kind, payload=reading.pack(), source=mote).pack()


class Talk:
    """A robot without a body, whose radio the test is."""

    def __init__(self, one, **parameters):
        self.one = one
        one.host("snw_exploration", snw_exploration=parameters)
        self._readings = one.inbox(MOTE_READING)
        self._sent = one.inbox(ARENA_RADIO_TX)

    def hear(self, *packets):
        """The robot hears packets; what it says to motes thereupon."""
        self.one.run(0.1)
        self._sent.drain()
        for each in packets:
            self.one.radio(each)
            self.one.run(0.06)
        return [ActiveMessage.unpack(received.message) for received in self._sent.drain()]

    def readings(self):
        return [received.message for received in self._readings.drain()]

    def row(self, mote="m3"):
        return next(row for row in self.one.call("snw_exploration", "motes") if row["mote"] == mote)

    def counters(self):
        return self.one.call("snw_exploration", "counters")


@pytest.fixture
def talk(stage):
    return lambda **parameters: Talk(stage(), **parameters)


def asked(said):
    return [RequestPayload.unpack(each.payload).sequences() for each in said if each.type == REQUEST_TYPE]


def acknowledged(said):
    return [SequenceRange.unpack(each.payload) for each in said if each.type == ACKNOWLEDGE_TYPE]


def duties(said):
    return [DutyPayload.unpack(each.payload).period_ds for each in said if each.type == DUTY_TYPE]


# -- to the team ----------------------------------------------------------------------------------------------


def test_packets_of_motes_are_readings_for_the_team(talk):
    one = talk(collect=False)
    one.hear(WARM, DARK)
    warm, dark = one.readings()
    assert (warm.mote, warm.place, warm.via, warm.sequence) == ("m3", Point2D(5.0, -2.0), "r1", 258)
    assert (warm.quantity, warm.value, warm.voltage_v, warm.rssi_dbm) == ("temperature_c", 21.5, 2.9, -75)
    assert (warm.period_s, warm.stored) == (4.0, 0)
    assert (dark.mote, dark.place, dark.quantity, dark.value) == ("m7", Point2D(0.0, 32.1), "light_lx", -5.0)
    assert (dark.voltage_v, dark.rssi_dbm, dark.period_s, dark.stored) == (2.1, -90, 300.0, 15)


def test_a_reading_goes_on_the_wire_once_however_often_it_is_heard(talk):
    one = talk()
    one.hear(packet(5), packet(5), packet(6), packet(5, kind=STORED_TYPE))
    assert [reading.sequence for reading in one.readings()] == [5, 6]
    assert one.counters()["repeated"] == 2


# -- the table ------------------------------------------------------------------------------------------------


def test_a_packet_that_says_to_be_a_reading_and_is_none_is_counted(talk):
    one = talk()
    one.hear(SHORT_READING)
    assert one.counters()["unreadable"] == 1
    assert one.one.infos()["snw_exploration"].state == "active"
    assert one.readings() == []


@pytest.mark.parametrize("bytes_", MALFORMED, ids=range(len(MALFORMED)))
def test_bytes_that_are_no_packet_are_counted_and_dropped(talk, bytes_):
    one = talk()
    one.hear(bytes_, WARM)
    counters = one.one.call("mote_base", "counters")
    assert (counters["packets"], counters["malformed"], counters["dropped"]) == (1, 1, 0)
    assert len(one.readings()) == 1


def test_motes_beyond_the_most_are_not_taken_in(talk):
    one = talk(max_motes=2)
    one.hear(*(packet(1, mote=mote) for mote in (1, 2, 3)))
    assert [row["mote"] for row in one.one.call("snw_exploration", "motes")] == ["m1", "m2"]
    assert one.counters()["refused"] == 1


# -- asking for what is stored --------------------------------------------------------------------------------


def test_what_a_mote_has_kept_is_asked_for_in_its_own_words(talk):
    said = talk().hear(packet(20, oldest=15))
    assert [each.pack() for each in said] == [bytes.fromhex("00 0003 0000 06 22 54  000f 0000001f")]


def test_a_visit_collects_everything_that_was_missed_and_then_lets_the_mote_forget_it(talk):
    one = talk(request_span=16)
    said = one.hear(packet(40, oldest=0))
    assert asked(said) == [list(range(16))]
    said = one.hear(*(packet(number, kind=STORED_TYPE, oldest=0) for number in range(16)))
    assert asked(said) == [list(range(16, 32))]
    said += one.hear(*(packet(number, kind=STORED_TYPE, oldest=0) for number in range(16, 40)))
    assert asked(said)[-1] == list(range(32, 40))
    said += one.hear(packet(41, oldest=0))
    assert acknowledged(said)[-1] == SequenceRange(0, 41)
    assert sorted(reading.sequence for reading in one.readings()) == list(range(42))
    assert one.row()["missing"] == 0


def test_no_more_than_three_motes_are_asked_unheard(talk):
    one = talk(weak_copies=1)
    one.hear(*(packet(20, mote=mote, oldest=15, rssi_dbm=-88) for mote in range(1, 9)))
    one.one.run(2.0)
    one._sent.drain()
    one.one.run(3.0)
    sought = {ActiveMessage.unpack(received.message).destination for received in one._sent.drain()}
    assert len(sought) == 3


# -- duty -----------------------------------------------------------------------------------------------------


def test_a_duty_on_the_wire_reaches_the_mote_when_it_is_heard_and_until_it_has_it(talk):
    one = talk()
    one.one.publisher(MOTE_DUTY, mote="m3").put(MoteDuty(mote="m3", period_s=30.0))
    assert duties(one.hear(packet(1), packet(2))) == [300, 300]
    assert duties(one.hear(packet(3, period_ds=300), packet(4, period_ds=300))) == []


@pytest.mark.parametrize(
    ("mote", "period_s", "sentence"),
    [
        ("m3", 0.0, "expected a period from 0.1 to 6553.5 s, got 0.0"),
        ("m3", 1e9, "expected a period"),
        ("3", 4.0, "expected a mote's name, m and its number, got '3'"),
        ("m65535", 4.0, "expected a mote's name"),
        ("m²", 4.0, "expected a mote's name"),
    ],
)
def test_a_wish_without_sense_is_refused_in_words(talk, mote, period_s, sentence):
    with pytest.raises(CallError, match=sentence):
        talk().one.call("snw_exploration", "set_duty", mote, period_s)


def test_wishes_without_sense_on_the_wire_are_counted(talk):
    one = talk()
    one.one.publisher(MOTE_DUTY, mote="m3").put(MoteDuty(mote="m3", period_s=0.0))
    one.one.publisher(MOTE_DUTY, mote="bob").put(MoteDuty(mote="bob", period_s=5.0))
    one.hear(packet(1))
    assert one.counters()["refused"] == 2


def passed_on(sequence: int, *, hops: int = 2) -> bytes:
    reading = ReadingPayload(
        mote=9, sequence=sequence, oldest=sequence, age_ds=12, period_ds=40, voltage_mv=2900,
        quantity=Quantity.TEMPERATURE, value_centi=2150, x_dm=50, y_dm=-20, rssi_dbm=-70,
    )  # fmt: skip
    payload = ForwardedPayload(reading, 4, hops).pack()
    return ActiveMessage(type=FORWARDED_TYPE, payload=payload, source=3).pack()


def test_a_reading_that_motes_have_passed_on_is_told_with_its_way_and_its_mote_is_not_spoken_to(stage) -> None:
    one = Talk(stage())
    said = one.hear(passed_on(5), passed_on(7), passed_on(7))
    first, second = one.readings()
    assert (first.mote, first.hops, first.forwarder, first.sequence, first.via) == ("m9", 2, "m4", 5, "r1")
    assert first.stamp_ns - first.measured_ns == pytest.approx(1.2e9, abs=1e8)
    assert second.sequence == 7
    assert (asked(said), one.counters()["repeated"]) == ([], 1)
    assert one.one.call("snw_exploration", "motes") == []


def test_a_robot_that_is_no_gateway_tells_readings_at_once_and_one_that_is_waits_for_a_coordinator(stage) -> None:
    one = Talk(stage(), collect=False, store_readings=100)
    one.hear(packet(5), packet(6))
    assert one.readings() == []


class Net:
    """A store, and a coordinator that comes and goes."""

    def __init__(self, wire: Endpoint, capacity: int) -> None:
        self.told: list[MoteReading] = []
        self.store = ReadingStore(wire, capacity, self.told.append)
        self._wire = wire
        self._coordinator: Endpoint | None = None
        self.now_ns = 0

    def there(self, is_there: bool) -> None:
        if self._coordinator is not None:
            self._coordinator.close()
            self._coordinator = None
        if is_there:
            self._coordinator = Endpoint(self._wire.session, "test", self._wire.clock, Drive.LOCKSTEP)
            self._coordinator.token(COORDINATOR_ALIVE)
        self.step()

    def step(self, times: int = 1) -> None:
        for _ in range(times):
            self.now_ns += FORWARD_NS
            self.store.step(self.now_ns)

    def hear(self, mote: str, *sequences: int) -> None:
        for sequence in sequences:
            self.store.publish(
                MoteReading(mote=mote, place=None, quantity="temperature_c", value=20.0, voltage_v=2.9, rssi_dbm=-70.0,
                            via="m1", sequence=sequence)
            )  # fmt: skip

    def numbers(self, mote: str) -> list[int | None]:
        return [reading.sequence for reading in self.told if reading.mote == mote]


def test_stored_readings_follow_in_order_before_new_ones_one_of_each_mote_at_a_time(wire) -> None:
    net = Net(wire, 10)
    net.hear("m2", 1, 2, 3)
    net.hear("m3", 7)
    net.step(20)
    assert net.told == []
    net.there(True)
    assert [(one.mote, one.sequence, one.waiting) for one in net.told] == [("m2", 1, 3), ("m3", 7, 2)]
    net.hear("m2", 4)
    net.hear("m3", 8)  # nothing of m3 waits
    assert net.numbers("m3") == [7, 8]
    net.step(5)
    assert net.numbers("m2") == [1, 2, 3, 4]
    assert net.store.waiting == 0


def test_the_oldest_readings_of_the_mote_with_the_most_are_dropped_and_counted(wire) -> None:
    net = Net(wire, 4)
    net.hear("m2", 1, 2, 3)
    net.hear("m3", 7, 8, 9)
    assert (net.store.waiting, net.store.dropped) == (4, 2)
    net.there(True)
    net.step(10)
    assert (net.numbers("m2"), net.numbers("m3")) == ([2, 3], [8, 9])
    assert {reading.dropped for reading in net.told} == {2}


SECOND_NS = to_ns(1.0)


class Base:
    """A base station that hears mote 1, over which mote 2 is heard, over which mote 3 is heard."""

    def __init__(self):
        self.packets = []
        self.over = OverHops(lambda *packet: self.packets.append(packet), acknowledge_every=8)
        self.record = MoteRecord("m3", 3, 64)
        self.now_ns = 0

    def hears(self, sequence, period_ds=40, oldest=0, parent=2, after_ns=SECOND_NS):
        """A reading of mote 3 comes, then mote 1 is heard; returns what is said then."""
        self.now_ns += after_ns
        self.packets.clear()
        self.record.window.add(sequence, is_live=False)
        reading = ReadingPayload(
            mote=3, sequence=sequence, oldest=oldest, period_ds=period_ds, voltage_mv=3000, quantity=1, value_centi=0,
            x_dm=0, y_dm=0,
        )  # fmt: skip
        self.over.received_forwarded(MoteRecord("m2", 2, 64), reading, 1, self.now_ns)
        self.over.received_forwarded(self.record, reading, parent, self.now_ns)
        self.over.record(1, self.now_ns)
        routed = [RoutedPayload.unpack(payload) for to, kind, payload in self.packets if (to, kind) == (1, ROUTED_TYPE)]
        return [one for one in routed if one.route == (2, 3)]


def kinds(packets):
    return [packet.kind for packet in packets]


def test_a_duty_is_said_again_after_a_while_and_no_more_once_it_is_confirmed():
    base = Base()
    base.hears(0)
    base.record.want_period(90, base.now_ns)
    assert kinds(base.hears(1)) == [DUTY_TYPE]
    assert base.hears(2) == []
    assert kinds(base.hears(3, after_ns=WAIT_NS)) == [DUTY_TYPE]
    assert base.hears(4, period_ds=90, after_ns=WAIT_NS) == []
    assert base.hears(5, period_ds=40, after_ns=WAIT_NS) == []


def test_only_what_has_come_without_a_gap_is_acknowledged():
    base = Base()
    said = [packet for number in (0, 1, 2, 3, 4, 5, 6, 8) for packet in base.hears(number)]
    assert ACKNOWLEDGE_TYPE not in kinds(said)
    said = base.hears(7)
    assert [(packet.kind, packet.inner.hex()) for packet in said] == [(ACKNOWLEDGE_TYPE, "00000008")]


def reading(**changes):
    values = {
        "mote": 3, "sequence": 7, "oldest": 7, "period_ds": 40, "voltage_mv": 2900, "quantity": Quantity.TEMPERATURE,
        "value_centi": 2150, "x_dm": 50, "y_dm": -20, "rssi_dbm": -70,
    }  # fmt: skip
    return ReadingPayload(**values | changes)


def test_only_a_mote_with_neither_coordinate_has_no_place():
    assert place_of(reading(x_dm=NO_PLACE, y_dm=NO_PLACE)) is None
    assert place_of(reading(x_dm=NO_PLACE, y_dm=10)) == Point2D(NO_PLACE / 10, 1.0)


def test_a_way_that_is_old_too_long_or_a_circle_is_none():
    base = Base()
    base.hears(0)
    assert base.over.route(3, base.now_ns) == (1, 2, 3)
    assert base.over.route(9, base.now_ns) is None
    assert base.over.route(3, base.now_ns + FRESH_NS + 1) is None
    base.hears(1, parent=3)
    assert base.over.route(3, base.now_ns) is None
    reading = ReadingPayload(
        mote=3, sequence=0, oldest=0, period_ds=40, voltage_mv=3000, quantity=1, value_centi=0, x_dm=0, y_dm=0
    )
    for number in range(2, 20):
        base.over.received_forwarded(MoteRecord(f"m{number}", number, 64), reading, number - 1, base.now_ns)
    assert base.over.route(ROUTE_MAX + 1, base.now_ns) == tuple(range(1, ROUTE_MAX + 2))
    assert base.over.route(ROUTE_MAX + 2, base.now_ns) is None
