"""What a base station says to motes out of its reach, and when it says it again."""

from robrain.plugins.unit.snw_exploration.asking import DUTY_TRIES, FRESH_NS, WAIT_NS, OverHops
from robrain.plugins.unit.snw_exploration.mote_record import MoteRecord
from robrain.protocol.clock import to_ns
from robrain.protocol.tinyos.payloads import (
    ACKNOWLEDGE_TYPE,
    DUTY_TYPE,
    REQUEST_TYPE,
    ROUTE_MAX,
    ROUTED_TYPE,
    ReadingPayload,
    RequestPayload,
    RoutedPayload,
)

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


def test_a_duty_that_is_never_confirmed_is_given_up():
    base = Base()
    base.record.want_period(90, 0)
    said = sum(DUTY_TYPE in kinds(base.hears(0, after_ns=WAIT_NS)) for _ in range(DUTY_TRIES + 5))
    assert said == DUTY_TRIES
    assert base.over.given_up == 1


def test_what_is_missing_for_longer_than_readings_take_is_asked_for_until_it_comes():
    base = Base()
    base.hears(0)
    assert base.hears(3) == []
    (request,) = base.hears(4, after_ns=WAIT_NS)
    assert request.kind == REQUEST_TYPE
    assert RequestPayload.unpack(request.inner).sequences() == [1, 2]
    base.hears(1)
    (request,) = base.hears(5, after_ns=WAIT_NS)
    assert RequestPayload.unpack(request.inner).sequences() == [2]
    base.hears(2)
    assert base.hears(6, after_ns=WAIT_NS) == []


def test_only_what_has_come_without_a_gap_is_acknowledged():
    base = Base()
    said = [packet for number in (0, 1, 2, 3, 4, 5, 6, 8) for packet in base.hears(number)]
    assert ACKNOWLEDGE_TYPE not in kinds(said)
    said = base.hears(7)
    assert [(packet.kind, packet.inner.hex()) for packet in said] == [(ACKNOWLEDGE_TYPE, "00000008")]


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
