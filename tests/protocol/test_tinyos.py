import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.model.tinyos import (
    MAX_PAYLOAD_BYTES,
    READING_TYPE,
    ActiveMessage,
    BadPacket,
    ReadingPayload,
)

U8, U16, I16 = st.integers(0, 0xFF), st.integers(0, 0xFFFF), st.integers(-0x8000, 0x7FFF)

READING = ReadingPayload(
    mote=3, sequence=258, voltage_mv=2900, reading_centi=2150, x_dm=50, y_dm=-20, rssi_dbm=-75
)  # fmt: skip
GOLDEN = bytes.fromhex("00 ffff 0003 0d 22 52  0003 0102 0b54 0866 0032 ffec b5")


def test_a_reading_has_the_bytes_that_are_written_here():
    message = ActiveMessage(type=READING_TYPE, payload=READING.pack(), source=3)
    assert message.pack() == GOLDEN


def test_the_bytes_that_are_written_here_are_that_reading():
    message = ActiveMessage.unpack(GOLDEN)
    assert (message.destination, message.source, message.group, message.type) == (0xFFFF, 3, 0x22, 0x52)
    assert ReadingPayload.unpack(message.payload) == READING


@given(
    st.builds(
        ActiveMessage,
        type=U8,
        payload=st.binary(max_size=MAX_PAYLOAD_BYTES),
        source=U16,
        destination=U16,
        group=U8,
    )
)
def test_every_packet_survives_the_way_there_and_back(message):
    assert ActiveMessage.unpack(message.pack()) == message


@given(
    st.builds(
        ReadingPayload,
        mote=U16,
        sequence=U16,
        voltage_mv=U16,
        reading_centi=I16,
        x_dm=I16,
        y_dm=I16,
        rssi_dbm=st.integers(-128, 127),
    )
)
def test_every_reading_survives_the_way_there_and_back(reading):
    assert ReadingPayload.unpack(reading.pack()) == reading


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
        (GOLDEN[:-1], "expected 13 bytes of payload as the header says, got 12"),  # cut within the payload
        (GOLDEN + b"\x00", "got 14"),  # a byte too many
        (b"\x01" + GOLDEN[1:], "dispatch byte 0x00"),  # another protocol of the serial line
        (GOLDEN[:5] + b"\x1d" + GOLDEN[6:8] + bytes(29), "at most 28 bytes, got length 29"),  # longer than TinyOS sends
    ],
)
def test_a_broken_packet_is_refused_in_words(packet, sentence):
    with pytest.raises(BadPacket, match=sentence):
        ActiveMessage.unpack(packet)


def test_a_payload_of_another_length_is_no_reading():
    with pytest.raises(BadPacket, match="expected a reading of 13 bytes, got 12"):
        ReadingPayload.unpack(READING.pack()[:-1])


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


def test_a_value_that_does_not_fit_its_field_is_not_packed():
    reading = ReadingPayload(mote=1, sequence=0, voltage_mv=2900, reading_centi=40000, x_dm=0, y_dm=0)
    with pytest.raises(BadPacket, match="does not fit"):
        reading.pack()
