import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.tinyos.packet import ActiveMessage, BadPacket
from robrain.protocol.tinyos.payloads import (
    READING_TYPE,
    REQUEST_TYPE,
    SEQUENCES,
    DutyPayload,
    Quantity,
    ReadingPayload,
    RequestPayload,
    SequenceRange,
    sequences_after,
    with_rssi,
)

U8, U16, I16 = st.integers(0, 0xFF), st.integers(0, 0xFFFF), st.integers(-0x8000, 0x7FFF)

READING = ReadingPayload(
    mote=3, sequence=258, oldest=250, age_ds=15, period_ds=40, voltage_mv=2900, quantity=Quantity.TEMPERATURE,
    value_centi=2150, x_dm=50, y_dm=-20, rssi_dbm=-75,
)  # fmt: skip
GOLDEN = bytes.fromhex("00 ffff 0003 18 22 52  0003 0102 00fa 0000000f 0028 0b54 01 00000866 0032 ffec b5")

# What a mote of TinyOS 2 sent, as printed in "TinyOS 2.x serial packet structure" (renesto.blogspot.com, June 2008).
FOREIGN = bytes.fromhex("00 FF FF 00 00 08 00 09 19 77 02 07 00 13 00 00")


def test_a_reading_has_the_bytes_that_are_written_here():
    message = ActiveMessage(type=READING_TYPE, payload=READING.pack(), source=3)
    assert message.pack() == GOLDEN


def test_a_packet_that_somebody_else_s_mote_sent_is_understood():
    message = ActiveMessage.unpack(FOREIGN)
    assert (message.destination, message.source, message.group, message.type) == (0xFFFF, 0, 0, 9)
    assert message.payload == bytes.fromhex("19 77 02 07 00 13 00 00")
    assert message.pack() == FOREIGN


@pytest.mark.parametrize(
    ("kind", "payload", "written"),
    [
        (REQUEST_TYPE, RequestPayload(250, 0b1011), "00 0003 0000 06 22 54  00fa 0000000b"),
        (0x55, SequenceRange(65530, 2), "00 0003 0000 04 22 55  fffa 0002"),
        (0x56, DutyPayload.of_seconds(30.0), "00 0003 0000 02 22 56  012c"),
    ],
)
def test_what_a_robot_says_to_a_mote_has_the_bytes_that_are_written_here(kind, payload, written):
    message = ActiveMessage(type=kind, payload=payload.pack(), source=0, destination=3)
    assert message.pack() == bytes.fromhex(written)
    assert type(payload).unpack(message.payload) == payload


readings = st.builds(
    ReadingPayload,
    mote=U16,
    sequence=U16,
    oldest=U16,
    age_ds=st.integers(0, 0xFFFFFFFF),
    period_ds=U16,
    voltage_mv=U16,
    quantity=U8,
    value_centi=st.integers(-(1 << 31), (1 << 31) - 1),
    x_dm=I16,
    y_dm=I16,
    rssi_dbm=st.integers(-128, 127),
)


@given(readings)
def test_every_reading_survives_the_way_there_and_back(reading):
    assert ReadingPayload.unpack(reading.pack()) == reading


@given(readings, st.floats(-500.0, 500.0))
def test_a_base_station_writes_the_strength_and_nothing_else(reading, rssi_dbm):
    heard = ReadingPayload.unpack(with_rssi(reading.pack(), rssi_dbm))
    assert heard.rssi_dbm == max(-128, min(127, round(rssi_dbm)))
    assert with_rssi(heard.pack(), reading.rssi_dbm) == reading.pack()


@given(st.binary(max_size=48))
def test_bytes_are_a_packet_or_refused_and_nothing_else(data):
    try:
        message = ActiveMessage.unpack(data)
    except BadPacket:
        return
    assert message.pack() == data


@pytest.mark.parametrize(
    ("packet", "sentence"),
    [
        (GOLDEN[:7], "at least 8 bytes, got 7"),  # cut within the header
        (GOLDEN[:-1], "expected the 24 bytes of payload in the header, got 23"),  # cut within the payload
        (GOLDEN + b"\x00", "got 25"),  # a byte too many
        (b"\x01" + GOLDEN[1:], "dispatch byte 0x00"),  # a CC1000 packet of the serial line
        (GOLDEN[:5] + b"\x1d" + GOLDEN[6:8] + bytes(29), "at most 28 bytes, got length 29"),  # longer than TinyOS sends
    ],
)
def test_a_broken_packet_is_refused_in_words(packet, sentence):
    with pytest.raises(BadPacket, match=sentence):
        ActiveMessage.unpack(packet)


@pytest.mark.parametrize(
    ("kind", "payload", "sentence"),
    [
        (ReadingPayload, READING.pack()[:-1], "expected a reading of 24 bytes, got 23"),
        (SequenceRange, b"\x00" * 5, "expected a range of sequence numbers of 4 bytes, got 5"),
        (RequestPayload, b"\x00" * 4, "expected a request of 6 bytes, got 4"),
        (DutyPayload, b"\x00", "expected a duty of 2 bytes, got 1"),
        (DutyPayload, b"\x00\x00", "expected a period above 0, got 0"),
    ],
)
def test_a_payload_of_another_length_is_none(kind, payload, sentence):
    with pytest.raises(BadPacket, match=sentence):
        kind.unpack(payload)


@pytest.mark.parametrize("payload", [SequenceRange(0, 1 << 16), RequestPayload(0, 1 << 32), DutyPayload(1 << 16)])
def test_a_number_that_does_not_fit_its_field_is_not_packed(payload):
    with pytest.raises(BadPacket, match=r"16 .*bits"):
        payload.pack()


@given(U16, st.integers(-0x8000, 0x7FFF))
def test_the_later_of_two_sequence_numbers_is_known_across_the_wrap(sequence, ahead):
    assert sequences_after((sequence + ahead) % SEQUENCES, sequence) == ahead


@given(U16, st.integers(0, 0x7FFF), U16)
def test_a_range_holds_what_lies_between_its_ends_across_the_wrap(first, length, sequence):
    wanted = SequenceRange(first, (first + length) % SEQUENCES)
    assert wanted.holds(sequence) == (sequence in {(first + step) % SEQUENCES for step in range(length + 1)})


@pytest.mark.parametrize(
    "message",
    [
        ActiveMessage(type=1, payload=bytes(29), source=1),  # payload too long
        ActiveMessage(type=256, payload=b"", source=1),  # type of more than 8 bits
        ActiveMessage(type=1, payload=b"", source=-1),  # address below 0
    ],
)
def test_what_no_packet_holds_is_not_packed(message):
    with pytest.raises(BadPacket):
        message.pack()


@pytest.mark.parametrize("period_s", [0.0, -1.0, 6554.0, float("nan")])
def test_a_period_that_no_mote_can_have_is_no_duty(period_s):
    with pytest.raises(ValueError, match="expected a period"):
        DutyPayload.of_seconds(period_s)
