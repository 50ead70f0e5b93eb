"""Lidar protocols: specified bytes, and any noise between them."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.protocol.serial.ld19 import PACKET_BYTES, Ld19Decoder, crc8, encode_ld19
from robrain.protocol.serial.points import Piece
from robrain.protocol.serial.rplidar import DESCRIPTOR, MOTOR, SCAN, STOP, RplidarDecoder, encode_rplidar

# A packet of LDROBOT's LD19 development manual, section "Communication protocol".
MANUAL = bytes.fromhex(
    "54 2C 68 08 AB 7E E0 00 E4 DC 00 E2 D9 00 E5 D5 00 E3 D3 00 E4 D0 00 E9 CD 00 E4 CA 00 E2 C7 00 E9 C5 00 E5 C2"
    " 00 E5 C0 00 E5 BE 82 3A 1A 50"
)


def ld19_turn(range_m: float = 1.5) -> bytes:
    """A turn of 360 points."""
    return b"".join(encode_ld19(packet * 12.0, 1.0, [range_m] * 12, 3600, packet) for packet in range(30))


def points_in(pieces: list[Piece]) -> list[tuple[float, float]]:
    return [(point.angle_rad, point.range_m) for piece in pieces for point in piece.points]


def test_packet_of_the_manual_has_its_angles_and_distances() -> None:
    decoder = Ld19Decoder()
    (piece,) = decoder.feed(MANUAL)
    assert len(MANUAL) == PACKET_BYTES
    assert len(piece.points) == 12
    assert math.degrees(piece.points[0].angle_rad) == pytest.approx(-324.27)
    assert math.degrees(piece.points[-1].angle_rad) == pytest.approx(-334.7)
    assert [point.range_m for point in piece.points[:3]] == [0.224, 0.220, 0.217]
    assert decoder.counts.packets == 1


@pytest.mark.slow
@settings(max_examples=66)
@given(st.lists(st.integers(1, 60), min_size=1, max_size=40), st.data())
def test_points_are_the_same_in_whatever_parts_the_bytes_come(parts: list[int], data: st.DataObject) -> None:
    for encoded, decoder, other in (
        (ld19_turn(), Ld19Decoder(), Ld19Decoder()),
        (DESCRIPTOR + encode_rplidar(range(0, 360, 2), [2.0] * 180), RplidarDecoder(), RplidarDecoder()),
    ):
        whole, found, at = points_in(decoder.feed(encoded)), [], 0
        for part in parts:
            found += points_in(other.feed(encoded[at : at + part]))
            at += part
        found += points_in(other.feed(encoded[at:]))
        assert found == whole
        assert other.counts.bad_checksums == other.counts.stray_bytes == 0


@pytest.mark.slow
@settings(max_examples=100)
@given(st.binary(max_size=200), st.integers(0, 37), st.binary(min_size=1, max_size=30))
def test_noise_costs_no_more_than_the_packets_that_it_hits(before: bytes, where: int, noise: bytes) -> None:
    packets = [encode_ld19(packet * 9.6, 0.8, [1.0] * 12, 3600, packet) for packet in range(38)]
    data = before + b"".join(packets[:where]) + noise + b"".join(packets[where:])
    decoder = Ld19Decoder()
    points = points_in(decoder.feed(data))
    decoder.feed(b"\0" * PACKET_BYTES)
    assert decoder.counts.packets >= 36  # a header in the noise may take the packet behind it
    assert len(points) >= 36 * 12
    assert decoder.counts.stray_bytes >= len(before) + len(noise) - 2 * PACKET_BYTES


@pytest.mark.parametrize("cut", range(2, PACKET_BYTES))
def test_a_packet_of_which_the_end_is_lost_costs_none_of_those_behind_it(cut: int) -> None:
    lost, *rest = [encode_ld19(9.6 * number, 0.8, [1.0] * 12, 3600, number) for number in range(4)]
    decoder = Ld19Decoder()
    points = points_in(decoder.feed(lost[:cut] + b"".join(rest)))
    assert len(points) == 3 * 12
    counts = decoder.counts
    assert (counts.packets, counts.bad_checksums, counts.stray_bytes) == (3, 1, cut)


def test_angles_beyond_a_turn_or_a_wide_packet_are_no_points_although_the_checksum_is_right() -> None:
    decoder = Ld19Decoder()
    for first, last in ((40_000, 100), (100, 20_000)):
        body = bytearray(encode_ld19(0.0, 0.8, [1.0] * 12, 3600, 0)[:-1])
        body[4:6], body[42:44] = first.to_bytes(2, "little"), last.to_bytes(2, "little")
        assert decoder.feed(bytes(body) + bytes((crc8(bytes(body)),))) == []


def test_rplidar_is_asked_for_a_scan_once_and_again_when_it_is_silent() -> None:
    decoder = RplidarDecoder()
    assert decoder.to_write() == STOP + MOTOR + SCAN
    assert decoder.to_write() == b""
    decoder.ask_again()
    assert decoder.to_write() == STOP + MOTOR + SCAN


def test_rplidar_nodes_are_clockwise_degrees_and_quarters_of_a_millimetre() -> None:
    decoder = RplidarDecoder()
    # From the notes: quality 0x2F, S, then 90° and 1.5 m: 90 × 64 = 5760, 1500 × 4 = 6000.
    node = bytes((0x2F << 2 | 1, (5760 << 1 | 1) & 0xFF, 5760 << 1 >> 8, 6000 & 0xFF, 6000 >> 8))
    ends, rest = decoder.feed(b"\x01\x02" + DESCRIPTOR + node)
    assert ends.ends_turn
    assert rest.points[0].angle_rad == pytest.approx(-math.pi / 2)
    assert rest.points[0].range_m == 1.5
    assert decoder.counts.stray_bytes == 2


@pytest.mark.slow
@settings(max_examples=66)
@given(st.integers(5, 170), st.binary(min_size=1, max_size=14))
def test_rplidar_finds_its_nodes_again_after_noise(where: int, noise: bytes) -> None:
    nodes = encode_rplidar(range(0, 360, 2), [2.0] * 180)
    decoder = RplidarDecoder()
    first = points_in(decoder.feed(DESCRIPTOR + nodes[: 5 * where] + noise + nodes[5 * where :]))
    after = points_in(decoder.feed(nodes))
    assert len(first) + len(after) >= 360 - 12
    assert [one for one in after[-170:] if one[1] != 2.0] == []


@pytest.mark.parametrize("cut", range(8))
def test_rplidar_that_scans_already_is_heard_without_its_descriptor(cut: int) -> None:
    decoder = RplidarDecoder()
    nodes = encode_rplidar(range(0, 360, 2), [2.0] * 180)
    points = [*points_in(decoder.feed(nodes[cut:50])), *points_in(decoder.feed(nodes[50:]))]
    assert len(points) >= 178
    assert {range_m for _, range_m in points} == {2.0}


@pytest.mark.slow
@settings(max_examples=100)
@given(st.lists(st.binary(max_size=300), max_size=20))
def test_no_bytes_at_all_break_a_decoder_or_fill_its_memory(chunks: list[bytes]) -> None:
    for decoder in (Ld19Decoder(), RplidarDecoder()):
        for chunk in chunks:
            decoder.feed(chunk)
        assert len(decoder._left) < 100
