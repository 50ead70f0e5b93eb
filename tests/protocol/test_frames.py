import cantools
import pytest
from crccheck.crc import Crc8SaeJ1850
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.protocol.can.frames import BadFrame, FrameCodec, codec, database

FRAMES = [message.name for message in database().messages]


def signals_of(name):
    return [signal for signal in database().get_message_by_name(name).signals if signal.name not in OWN]


OWN = ("counter", "checksum")


@st.composite
def any_values(draw):
    name = draw(st.sampled_from(FRAMES))
    values = {}
    for signal in signals_of(name):
        number = st.floats(signal.minimum, signal.maximum) | st.integers(int(signal.minimum), int(signal.maximum))
        values[signal.name] = draw(number)
    return name, draw(st.integers(0, 255)), values


@settings(max_examples=40)
@given(any_values())
def test_bytes_and_values_are_those_that_cantools_makes_behind_the_checksum_of_sae_j1850(drawn):
    name, counter, values = drawn
    frame = codec(name).pack(counter, **values)
    data = codec(name).encode(counter, *[values[signal] for signal in codec(name).signals])
    assert data == bytes(frame.data)
    assert data[-1] == Crc8SaeJ1850.calc(frame.arbitration_id.to_bytes(2, "big") + data[:-1])
    message = database().get_message_by_name(name)
    assert data == message.encode({**values, "counter": counter, "checksum": data[-1]}, strict=False)
    expected, unpacked = message.decode(data, decode_choices=False), codec(name).unpack(frame)
    assert unpacked == expected
    assert [(signal, type(value)) for signal, value in unpacked.items()] == [
        (signal, type(expected[signal])) for signal in (*codec(name).signals, *OWN)
    ]
    assert codec(name).decode(data) == tuple(unpacked.values())[:-1]


@given(any_values(), st.data())
def test_no_bytes_with_a_single_wrong_bit_are_decoded(drawn, data):
    name, counter, values = drawn
    sent = bytearray(codec(name).encode(counter, *values.values()))
    bit = data.draw(st.integers(0, 8 * len(sent) - 1))
    sent[bit // 8] ^= 1 << bit % 8
    with pytest.raises(BadFrame, match=f"{name}: wrong checksum"):
        codec(name).decode(bytes(sent))
    with pytest.raises(BadFrame, match=f"{name}: expected {len(sent)} bytes, got {len(sent) - 1}"):
        codec(name).decode(bytes(sent[:-1]))


@pytest.mark.parametrize("speed", [33.0, -33.0, 1e9, float("nan"), float("inf")])
def test_a_speed_that_its_field_cannot_hold_is_not_encoded_as_another(speed):
    with pytest.raises((OverflowError, ValueError)):
        codec("WheelCommand").encode(0, 0.0, speed, 0.0)


ODD = """
BU_: A
BO_ 1 Odd: 2 A
 SG_ {first} "" A
 SG_ counter : 8|8@1+ (1,0) [0|255] "" A
"""


@pytest.mark.parametrize(
    "first",
    [
        "x : 0|4@1+ (1,0) [0|15]",  # half a byte
        "x : 7|8@0+ (1,0) [0|255]",  # the highest byte first
        "x : 0|8@1+ (1,1) [0|255]",  # an offset
    ],
)
def test_a_frame_whose_signals_are_not_whole_bytes_has_no_codec(first):
    message = cantools.database.load_string(ODD.format(first=first), "dbc").get_message_by_name("Odd")
    with pytest.raises(ValueError, match="Odd: expected x to fill whole bytes after the signal before it"):
        FrameCodec(message)


def test_a_frame_with_bytes_that_no_signal_fills_has_no_codec():
    text = ODD.format(first="x : 0|8@1+ (1,0) [0|255]").replace("Odd: 2", "Odd: 3")
    message = cantools.database.load_string(text, "dbc").get_message_by_name("Odd")
    with pytest.raises(ValueError, match="Odd: expected signals for 3 bytes, got 2"):
        FrameCodec(message)


def test_a_frame_under_another_identifier_is_refused():
    frame = codec("WheelEncoders").pack(1, wheel_1_ticks=1, wheel_2_ticks=2, wheel_3_ticks=3)
    with pytest.raises(BadFrame, match="BatteryStatus: wrong checksum"):
        codec("BatteryStatus").unpack(frame)
