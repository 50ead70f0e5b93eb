"""Packets that name the motes on their way."""

import pytest

from robrain.protocol.tinyos.packet import MAX_PAYLOAD_BYTES, BadPacket
from robrain.protocol.tinyos.payloads import REQUEST_TYPE, ROUTE_MAX, RequestPayload, RoutedPayload

REQUEST = RequestPayload(3, 5).pack()


def test_a_routed_packet_is_read_as_it_was_written_and_its_bytes_stay_as_they_are():
    packet = RoutedPayload(REQUEST_TYPE, 7, (2, 258), REQUEST)
    assert packet.pack().hex() == "540702" + "00020102" + "000300000005"
    assert RoutedPayload.unpack(packet.pack()) == packet


def test_the_longest_route_with_a_request_fits_a_tinyos_packet():
    assert ROUTE_MAX == 9
    longest = RoutedPayload(REQUEST_TYPE, 255, (0xFFFE,) * ROUTE_MAX, REQUEST)
    assert len(longest.pack()) == 27 <= MAX_PAYLOAD_BYTES


@pytest.mark.parametrize(
    "wrong",
    [
        RoutedPayload(REQUEST_TYPE, 7, (), REQUEST),
        RoutedPayload(REQUEST_TYPE, 7, (1,) * (ROUTE_MAX + 1), REQUEST),
        RoutedPayload(REQUEST_TYPE, 7, (1,), b""),
        RoutedPayload(REQUEST_TYPE, 7, (1,), b"1234567"),
        RoutedPayload(REQUEST_TYPE, 256, (1,), REQUEST),
        RoutedPayload(REQUEST_TYPE, 7, (70000,), REQUEST),
    ],
)
def test_a_packet_that_does_not_fit_is_not_written(wrong):
    with pytest.raises(BadPacket, match="expected"):
        wrong.pack()


@pytest.mark.parametrize("payload", [b"", b"\x54\x07", b"\x54\x07\x00abc", b"\x54\x07\x01\x00\x02",
                                     b"\x54\x07\x02\x00\x02\x00", b"\x54\x07\x0a" + b"\x00" * 25,
                                     b"\x54\x07\x01\x00\x02" + b"\x00" * 7])  # fmt: skip
def test_bytes_that_are_no_routed_packet_are_refused(payload):
    with pytest.raises(BadPacket, match="expected"):
        RoutedPayload.unpack(payload)
