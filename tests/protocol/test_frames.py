import can
import cantools
import pytest
from crccheck.crc import Crc8SaeJ1850
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.can.frames import BadFrame, FrameCodec, codec, database

FRAMES = [message.name for message in database().messages]
each = pytest.mark.parametrize("name", FRAMES)
EXAMPLE = {"wheel_1_rad_s": 1.0, "wheel_2_rad_s": -2.5, "wheel_3_rad_s": 0.001}


def signals_of(name):
    return [signal for signal in database().get_message_by_name(name).signals if signal.name not in OWN]


OWN = ("counter", "checksum")


@st.composite
def filled_frames(draw, name=None):
    name = name or draw(st.sampled_from(FRAMES))
    values = {}
    for signal in signals_of(name):
        raw = draw(st.integers(round(signal.minimum / signal.scale), round(signal.maximum / signal.scale)))
        values[signal.name] = raw * signal.scale
    return name, draw(st.integers(0, 255)), values


@given(filled_frames())
def test_what_is_packed_comes_out_again(drawn):
    name, counter, values = drawn
    unpacked = codec(name).unpack(codec(name).pack(counter, **values))
    assert unpacked.pop("counter") == counter
    del unpacked["checksum"]
    assert unpacked == pytest.approx(values)


@given(filled_frames())
def test_our_frames_read_the_same_in_any_tool_that_has_the_dbc_file(drawn):
    name, counter, values = drawn
    frame = codec(name).pack(counter, **values)
    read = database().decode_message(frame.arbitration_id, frame.data)
    assert read["counter"] == counter
    assert {signal: read[signal] for signal in values} == pytest.approx(values)
    assert not frame.is_extended_id
    assert frame.dlc == database().get_message_by_name(name).length


@given(filled_frames())
def test_the_checksum_is_crc_8_sae_j1850_over_identifier_and_data(drawn):
    name, counter, values = drawn
    frame = codec(name).pack(counter, **values)
    assert frame.data[-1] == Crc8SaeJ1850.calc(frame.arbitration_id.to_bytes(2, "big") + frame.data[:-1])


@st.composite
def any_values(draw):
    name = draw(st.sampled_from(FRAMES))
    values = {}
    for signal in signals_of(name):
        number = st.floats(signal.minimum, signal.maximum) | st.integers(int(signal.minimum), int(signal.maximum))
        values[signal.name] = draw(number)
    return name, draw(st.integers(0, 255)), values


@pytest.mark.slow
@given(any_values())
def test_the_bytes_and_the_values_are_those_that_cantools_makes(drawn):
    name, counter, values = drawn
    frame = codec(name).pack(counter, **values)
    checksum = frame.data[-1]
    message = database().get_message_by_name(name)
    assert frame.data == message.encode({**values, "counter": counter, "checksum": checksum}, strict=False)
    unpacked, expected = codec(name).unpack(frame), message.decode(bytes(frame.data), decode_choices=False)
    assert unpacked == expected
    assert {signal: type(value) for signal, value in unpacked.items()} == {
        signal: type(value) for signal, value in expected.items()
    }


@pytest.mark.slow
@given(any_values())
def test_bytes_and_values_in_their_order_are_those_of_whole_frames(drawn):
    name, counter, values = drawn
    frame = codec(name).pack(counter, **values)
    data = codec(name).encode(counter, *[values[signal] for signal in codec(name).signals])
    assert data == bytes(frame.data)
    assert Crc8SaeJ1850.calc(frame.arbitration_id.to_bytes(2, "big") + data[:-1]) == data[-1]
    decoded, unpacked = codec(name).decode(data), codec(name).unpack(frame)
    assert decoded == codec(name).decode(frame.data) == tuple(unpacked.values())[:-1]
    assert list(unpacked) == [*codec(name).signals, *OWN]
    expected = database().get_message_by_name(name).decode(data, decode_choices=False)
    assert decoded == (*[expected[signal] for signal in codec(name).signals], counter)


@given(filled_frames(), st.data())
def test_no_bytes_with_a_single_wrong_bit_are_decoded(drawn, data):
    name, counter, values = drawn
    sent = bytearray(codec(name).encode(counter, *values.values()))
    bit = data.draw(st.integers(0, 8 * len(sent) - 1))
    sent[bit // 8] ^= 1 << bit % 8
    with pytest.raises(BadFrame, match=f"{name}: wrong checksum"):
        codec(name).decode(bytes(sent))
    with pytest.raises(BadFrame, match=f"{name}: expected {len(sent)} bytes, got {len(sent) - 1}"):
        codec(name).decode(bytes(sent[:-1]))


@pytest.mark.parametrize("values", [(1.0, 2.0), (1.0, 2.0, 3.0, 4.0)])
def test_a_frame_is_encoded_of_all_its_values_and_no_more(values):
    with pytest.raises(TypeError, match=f"WheelCommand: expected 3 values, got {len(values)}"):
        codec("WheelCommand").encode(0, *values)


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


@given(st.floats(-32, 32))
def test_a_speed_is_rounded_to_the_nearest_step(speed):
    frame = codec("WheelCommand").pack(0, wheel_1_rad_s=speed, wheel_2_rad_s=0, wheel_3_rad_s=0)
    assert codec("WheelCommand").unpack(frame)["wheel_1_rad_s"] == pytest.approx(speed, abs=0.000501)


@given(filled_frames(), st.data())
def test_no_single_wrong_bit_is_believed(drawn, data):
    name, counter, values = drawn
    frame = codec(name).pack(counter, **values)
    bit = data.draw(st.integers(0, 8 * len(frame.data) - 1))
    frame.data[bit // 8] ^= 1 << bit % 8
    with pytest.raises(BadFrame, match=f"{name}: wrong checksum"):
        codec(name).unpack(frame)


@pytest.mark.parametrize("length", [0, 1, 7])
def test_a_frame_of_another_length_is_refused(length):
    frame = codec("WheelCommand").pack(0, **EXAMPLE)
    short = can.Message(arbitration_id=frame.arbitration_id, data=frame.data[:length], is_extended_id=False)
    with pytest.raises(BadFrame, match=f"WheelCommand: expected 8 bytes, got {length}"):
        codec("WheelCommand").unpack(short)


def test_a_frame_under_another_identifier_is_refused():
    frame = codec("WheelEncoders").pack(1, wheel_1_ticks=1, wheel_2_ticks=2, wheel_3_ticks=3)
    with pytest.raises(BadFrame, match="BatteryStatus: wrong checksum"):
        codec("BatteryStatus").unpack(frame)


def test_the_counter_wraps_at_a_byte():
    frame = codec("Stop").pack(259, latched=1)
    assert codec("Stop").unpack(frame)["counter"] == 3


@pytest.mark.parametrize("speed", [33.0, -33.0, 1e9, float("nan"), float("inf")])
def test_a_speed_that_its_field_cannot_hold_is_never_sent_as_another(speed):
    with pytest.raises((OverflowError, ValueError)):
        codec("WheelCommand").pack(0, wheel_1_rad_s=speed, wheel_2_rad_s=0, wheel_3_rad_s=0)


def test_a_missing_signal_is_not_packed():
    with pytest.raises(Exception, match="wheel_3_rad_s"):
        codec("WheelCommand").pack(0, wheel_1_rad_s=1, wheel_2_rad_s=2)


def test_there_is_no_codec_for_a_frame_that_the_file_does_not_have():
    with pytest.raises(KeyError):
        codec("Horn")


@each
def test_every_frame_ends_with_its_counter_and_checksum(name):
    message = database().get_message_by_name(name)
    assert [signal.name for signal in message.signals[-2:]] == list(OWN)
    assert [signal.length for signal in message.signals[-2:]] == [8, 8]
    assert message.signals[-1].start == 8 * (message.length - 1)
    assert not message.is_extended_frame
