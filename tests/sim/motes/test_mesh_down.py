"""Packets that motes pass on to motes: each once, bounded in number, and only if they can be read."""

from robrain.protocol.tinyos.payloads import DUTY_TYPE, DutyPayload, RoutedPayload
from robrain.sim.motes.mesh import RoutedDown
from robrain.sim.motes.mote import MeshSpec

SPEC = MeshSpec(hops=4, tries=3, queue=2)
WAKE_TICKS = 5


class Motes:
    """Motes 10, 11 and 12 with indices 0 to 2; a test says what is lost."""

    def __init__(self):
        self.delivered = []
        self.lose_acks = self.lose_packets = 0
        self.down = RoutedDown(
            SPEC, {10: 0, 11: 1, 12: 2}, self.hand, lambda index, message: self.delivered.append((index, message)),
            WAKE_TICKS,
        )  # fmt: skip
        self.tick = 0

    def hand(self, sender, receiver, take):
        if self.lose_packets:
            self.lose_packets -= 1
            return False
        if not take():
            return False
        if self.lose_acks:
            self.lose_acks -= 1
            return False
        return True

    def give(self, *route, serial=1):
        self.down.from_station(0, RoutedPayload(DUTY_TYPE, serial, route, DutyPayload(50).pack()).pack(), self.tick)

    def run(self, ticks):
        for _ in range(ticks):
            self.tick += 1
            self.down.step(self.tick)


def test_a_packet_waits_for_the_next_mote_to_wake_on_each_hop():
    motes = Motes()
    motes.give(11, 12)
    motes.run(2 * WAKE_TICKS - 1)
    assert motes.delivered == []
    motes.run(1)
    ((index, message),) = motes.delivered
    assert (index, message.type, message.destination, message.payload) == (2, DUTY_TYPE, 12, DutyPayload(50).pack())


def test_a_packet_whose_acknowledgements_are_lost_is_passed_on_and_delivered_once():
    motes = Motes()
    motes.lose_acks = 2
    motes.give(11)
    motes.run(100)
    assert len(motes.delivered) == 1
    motes.lose_acks = 2
    motes.give(11, 12, serial=2)
    motes.run(100)
    assert len(motes.delivered) == 2
    assert motes.down.counters.delivered == 2
    assert motes.down.counters.passed_on == 3


def test_a_packet_is_dropped_after_its_tries_and_counted_and_leaves_room():
    motes = Motes()
    motes.lose_packets = SPEC.tries
    motes.give(11)
    motes.run(100)
    assert (motes.delivered, motes.down.counters.undelivered) == ([], 1)
    motes.give(99)
    motes.run(100)
    assert motes.down.counters.undelivered == 2
    for serial in (2, 3):
        motes.give(11, serial=serial)
    motes.run(100)
    assert motes.down.counters.delivered == 2


def test_a_mote_holds_no_more_packets_than_it_has_room_for():
    motes = Motes()
    for serial in range(5):
        motes.give(11, serial=serial)
    assert motes.down.counters.accepted == SPEC.queue
    assert motes.down.counters.refused == 5 - SPEC.queue


def test_bytes_that_are_no_routed_packet_are_left_alone():
    motes = Motes()
    motes.down.from_station(0, b"\x56\x01\x00", 0)
    motes.run(100)
    assert motes.down.counters.accepted == 0
