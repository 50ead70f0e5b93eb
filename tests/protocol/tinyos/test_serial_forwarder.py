import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.tinyos.serial_forwarder import GREETING, BadGreeting, PacketDecoder, encode

PACKET = bytes.fromhex("00 FF FF 00 00 08 00 09 19 77 02 07 00 13 00 00")
GOLDEN = bytes.fromhex("55 20  10 00 FF FF 00 00 08 00 09 19 77 02 07 00 13 00 00")
"""What a forwarder sends first: `U `, then length and packet."""

PACKETS = st.lists(st.binary(min_size=1, max_size=255), max_size=8)


def test_greeting_and_packet_have_the_bytes_that_are_written_here():
    assert GREETING + encode(PACKET) == GOLDEN
    decoder = PacketDecoder()
    assert decoder.feed(GOLDEN) == [PACKET]
    assert decoder.has_greeted


@pytest.mark.slow
@given(PACKETS, st.data())
def test_packets_come_whole_in_whatever_pieces_tcp_brings_them(packets, data):
    stream = GREETING + b"".join(map(encode, packets))
    decoder = PacketDecoder()
    got = []
    while stream:
        length = data.draw(st.integers(1, len(stream)))
        got += decoder.feed(stream[:length])
        stream = stream[length:]
    assert got == packets
    assert decoder.has_greeted


def test_a_newer_forwarder_is_spoken_to_in_our_version():
    assert PacketDecoder().feed(b"U!" + encode(PACKET)) == [PACKET]


@pytest.mark.parametrize(
    "stream",
    [
        b"HTTP/1.1 400 Bad Request\r\n",  # another server
        b"T ",  # a forwarder of TinyOS 1
        b"U\x01",  # a version before the first
        GOLDEN[2:],  # no greeting at all
    ],
)
def test_who_greets_otherwise_is_no_forwarder(stream):
    with pytest.raises(BadGreeting, match="expected a Serial Forwarder"):
        PacketDecoder().feed(stream)


@pytest.mark.parametrize("packet", [b"", bytes(256)])
def test_a_packet_that_no_length_byte_holds_is_refused(packet):
    with pytest.raises(ValueError, match="expected a packet of 1 to 255 bytes"):
        encode(packet)
