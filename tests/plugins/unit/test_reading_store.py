"""Readings that have come over other motes, and readings that wait for the team's network."""

import pytest

from robrain.plugins.unit.snw_exploration.mote_record import FORWARD_NS, ReadingStore
from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.table.topics import COORDINATOR_ALIVE
from robrain.protocol.tinyos.packet import ActiveMessage
from robrain.protocol.tinyos.payloads import FORWARDED_TYPE, ForwardedPayload, Quantity, ReadingPayload
from robrain.protocol.wire.endpoint import Drive, Endpoint
from tests.plugins.unit.test_motes import Talk, asked, packet


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
    assert one.one.call("snw_exploration", "heard") == []


def test_a_reading_heard_from_its_own_mote_has_no_way(stage) -> None:
    one = Talk(stage(), collect=False)
    one.hear(packet(5))
    (reading,) = one.readings()
    assert not any((reading.hops, reading.forwarder, reading.waiting, reading.dropped))


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


def test_readings_are_told_at_once_while_there_is_a_coordinator(wire) -> None:
    net = Net(wire, 10)
    net.there(True)
    net.hear("m2", 1, 2)
    assert net.numbers("m2") == [1, 2]
    assert [(reading.waiting, reading.dropped) for reading in net.told] == [(0, 0), (0, 0)]


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


def test_a_second_cut_stops_forwarding(wire) -> None:
    net = Net(wire, 10)
    net.hear("m2", 1, 2, 3)
    net.there(True)
    net.there(False)
    net.step(10)
    assert net.numbers("m2") == [1]
    net.there(True)
    net.step(10)
    assert net.numbers("m2") == [1, 2, 3]


def test_the_oldest_readings_of_the_mote_with_the_most_are_dropped_and_counted(wire) -> None:
    net = Net(wire, 4)
    net.hear("m2", 1, 2, 3)
    net.hear("m3", 7, 8, 9)
    assert (net.store.waiting, net.store.dropped) == (4, 2)
    net.there(True)
    net.step(10)
    assert (net.numbers("m2"), net.numbers("m3")) == ([2, 3], [8, 9])
    assert {reading.dropped for reading in net.told} == {2}
