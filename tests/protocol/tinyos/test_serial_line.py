"""Acknowledged packets on a serial line, byte by byte and over lines that lose, change and repeat."""

from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.tinyos.packet import ActiveMessage
from robrain.protocol.tinyos.serial_line import SerialLink, frame

PACKET = ActiveMessage(type=0x54, payload=bytes.fromhex("0001 0010"), source=0, destination=3).pack()
OTHER = ActiveMessage(type=0x56, payload=bytes.fromhex("012c"), source=0, destination=3).pack()
TIMEOUT_NS = 100

# Flag, SERIAL_PROTO_PACKET_ACK (68), sequence number 1, packet, CRC with its low byte first, flag.
WRITTEN = bytes.fromhex("7e 44 01 00 0003 0000 04 22 54 0001 0010 0de4 7e")
# Flag, SERIAL_PROTO_ACK (67), sequence number 1, CRC, flag. The CRCs here were worked out with another library.
ACKNOWLEDGED = bytes.fromhex("7e 43 01 be48 7e")


def link(**changes):
    return SerialLink(**({"ack_timeout_ns": TIMEOUT_NS, "resends": 2} | changes))


def test_a_packet_and_its_acknowledgement_have_the_bytes_that_are_written_here():
    host = link()
    host.send(PACKET)
    assert host.to_write(0) == WRITTEN
    assert host.receive(ACKNOWLEDGED) == []
    assert host.is_idle
    assert host.counters.sent == 1


def test_a_packet_that_needs_no_acknowledgement_gets_none():
    host = link()
    assert host.receive(frame(b"\x45" + PACKET)) == [PACKET]
    assert host.to_write(0) == b""


def test_the_next_packet_waits_for_the_acknowledgement_of_the_first():
    host, mote = link(), link()
    host.send(PACKET)
    host.send(OTHER)
    mote.receive(host.to_write(0))
    assert host.to_write(1) == b""
    host.receive(mote.to_write(1))
    assert mote.receive(host.to_write(2)) == [OTHER]


def test_a_packet_is_sent_again_when_its_acknowledgement_does_not_come_and_then_given_up():
    host = link()
    host.send(PACKET)
    sent_at = [now_ns for now_ns in range(0, 1000, 10) if host.to_write(now_ns)]
    assert sent_at == [0, 100, 200]
    assert (host.counters.resent, host.counters.unsent, host.is_idle) == (2, 1, True)


def test_a_packet_whose_acknowledgement_was_lost_is_taken_once():
    host, mote = link(), link()
    host.send(PACKET)
    assert mote.receive(host.to_write(0)) == [PACKET]
    mote.to_write(0)  # the line loses it
    assert mote.receive(host.to_write(TIMEOUT_NS)) == []
    host.receive(mote.to_write(TIMEOUT_NS))
    assert (mote.counters.duplicates, host.counters.sent) == (1, 1)


def test_good_frames_of_no_known_kind_are_counted():
    host = link()
    assert host.receive(frame(b"\x42\x01\x00") + frame(b"\x44\x01") + frame(b"\x43\x01\x02")) == []
    assert host.counters.unknown == 3


def test_more_packets_than_may_wait_are_refused_and_counted():
    host = link(capacity=2)
    assert [host.send(PACKET) for _ in range(4)] == [True, True, False, False]
    assert host.counters.unsent == 2


PACKETS = st.lists(st.binary(min_size=1, max_size=36), min_size=1, max_size=8)


@given(PACKETS, st.lists(st.sampled_from(["whole", "whole", "lost", "cut", "noise", "twice"]), max_size=40))
def test_over_a_line_that_loses_and_repeats_packets_arrive_in_order_and_once(packets, fates):
    packets = [bytes([index]) + packet for index, packet in enumerate(packets)]
    host, mote = link(resends=100), link()
    got = []
    waiting = list(packets)
    fate = iter(fates)

    def over_the_line(written):
        match next(fate, "whole") if written else "whole":
            case "lost":
                return b""
            case "cut":
                return written[: len(written) // 2]
            case "noise":
                return written[:3] + bytes([written[3] ^ 0x01]) + written[4:]
            case "twice":
                return written + written
        return written

    for now_ns in range(0, 20_000, 50):
        if waiting:
            host.send(waiting.pop(0))
        got += mote.receive(over_the_line(host.to_write(now_ns)))
        host.receive(over_the_line(mote.to_write(now_ns)))
    assert got == packets
    assert host.is_idle
    assert host.counters.sent == len(packets)
