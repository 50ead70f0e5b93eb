"""Frames of the serial line. The golden ones were sent by other people's motes and tools."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.tinyos.serial_line import MAX_BODY_BYTES, Deframer, frame

# A Mica2 running BaseStation, heard on its serial port (tinyos-help mailing list, message 23523).
MICA2 = bytes.fromhex("7E 45 00 00 02 00 08 13 00 36 00 01 00 16 00 08 04 80 0A 01 01 AA AA 02 BB BB 03 CC CC 41 DE 7E")
# What a PC wrote to a telosb (message 42298), and a frame whose sequence number had to be escaped, with the protocol
# numbers of an older TinyOS (message 38733).
FROM_A_PC = bytes.fromhex("7E 44 00 00 FF FF 00 00 02 06 00 00 64 7B 7E")
ESCAPED = bytes.fromhex("7e 42 7d 5e 00 00 7d 5d 04 01 00 96 00 1c 32 7e")

BODIES = st.binary(min_size=2, max_size=MAX_BODY_BYTES)


@pytest.mark.parametrize("golden", [MICA2, FROM_A_PC, ESCAPED], ids=["mica2", "pc", "escaped"])
def test_frames_of_real_motes_and_tools_are_understood_and_made_alike(golden):
    deframer = Deframer()
    (body,) = deframer.feed(golden)
    assert deframer.counters.frames == 1
    assert frame(body) == golden


def test_the_example_that_tep_113_prints_is_framed_as_it_is_printed_there():
    # TEP 113, Serial Communication, section 3.6 (doc/html/tep113.html of tinyos-main): type 6, group 0x7d, to 0xbeef,
    # payload 1 2 3 4 5; protocol byte 0x40, sequence number 9. The CRC is not printed, nor a source.
    printed = bytes.fromhex("7e 40 09 00 be ef 05 7d 5d 06 01 02 03 04 05 7e")
    body = bytes.fromhex("40 09 00 be ef 05 7d 06 01 02 03 04 05")
    written = frame(body)
    assert written[: len(printed) - 1] + written[-1:] == printed
    assert Deframer().feed(written) == [body]


@pytest.mark.slow
@given(st.lists(BODIES, max_size=6), st.data())
def test_bodies_come_whole_in_whatever_pieces_the_line_brings_them(bodies, data):
    line = b"".join(map(frame, bodies))
    deframer = Deframer()
    got = []
    while line:
        length = data.draw(st.integers(1, len(line)))
        got += deframer.feed(line[:length])
        line = line[length:]
    assert got == bodies


@given(st.binary(max_size=600), st.lists(BODIES, min_size=2, max_size=4))
def test_after_any_garbage_at_most_one_frame_is_lost(garbage, bodies):
    deframer = Deframer()
    deframer.feed(garbage)
    got = deframer.feed(b"".join(map(frame, bodies)))
    assert got[-(len(bodies) - 1) :] == bodies[1:]


@given(st.lists(BODIES, min_size=3, max_size=3), st.integers(0), st.integers(1, 255))
def test_a_byte_that_is_changed_costs_two_frames_at_the_most(bodies, place, flip):
    frames = [frame(body) for body in bodies]
    middle = bytearray(frames[1])
    middle[place % len(middle)] ^= flip
    got = Deframer().feed(frames[0] + bytes(middle) + frames[2] + frame(b"end"))
    assert got[0] == bodies[0]
    assert got[-1] == b"end"


@pytest.mark.parametrize(
    ("line", "counter"),
    [
        (MICA2[:5] + b"\xff" + MICA2[6:], "bad_crc"),  # a byte changed
        (MICA2[:5] + MICA2[6:], "bad_crc"),  # a byte lost
        (b"\x7e\x43\x7e", "bad_length"),  # nothing but a protocol byte
        (b"\x7e" + bytes(300) + b"\x7e", "bad_length"),  # longer than the MTU
        (b"\x7e" + bytes(2000) + b"\x7e", "bad_length"),  # much longer
        (b"\x7e\x45\x00\x7d\x7e", "bad_escape"),  # torn within an escape
    ],
)
def test_what_is_wrong_with_a_frame_is_counted(line, counter):
    deframer = Deframer()
    assert deframer.feed(line) == []
    assert getattr(deframer.counters, counter) == 1
    assert deframer.feed(MICA2) == [MICA2[1:-3]]


@pytest.mark.parametrize("body", [b"", b"a", bytes(MAX_BODY_BYTES + 1)])
def test_a_body_that_no_frame_holds_is_refused(body):
    with pytest.raises(ValueError, match="expected a body"):
        frame(body)


def test_a_line_that_never_ends_a_frame_is_not_kept():
    deframer = Deframer()
    deframer.feed(b"\x7e")
    for _ in range(1000):
        deframer.feed(bytes(1000))
    assert len(deframer._waiting) < 1000
