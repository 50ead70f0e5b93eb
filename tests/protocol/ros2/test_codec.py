"""CDR and type hashes: bytes and hashes of real ROS 2 are pinned in `golden_ros2.json`."""

import json
import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.protocol.ros2.errors import BadCdr
from robrain.protocol.ros2.message_types import (
    LASER_SCAN,
    MARKER_ARRAY,
    OCCUPANCY_GRID,
    PATH,
    STRING,
    TF_MESSAGE,
    MessageType,
    String,
    typestore,
)
from tests.protocol.ros2.real_ros import GOLDEN, SEEDS
from tests.protocol.ros2.sample_messages import SERVICES, TYPES, sample, to_plain

PINNED = json.loads(GOLDEN.read_text(encoding="utf-8"))
BY_NAME = {kind.name: kind for kind in TYPES}
PINNED_TYPES = sorted(PINNED["cdr"])


@pytest.mark.parametrize("name", PINNED_TYPES)
def test_a_message_is_encoded_as_real_ros_does(name):
    kind = BY_NAME[name]
    assert [kind.encode(sample(kind, seed)).hex() for seed in SEEDS] == PINNED["cdr"][name]


@pytest.mark.parametrize("name", PINNED_TYPES)
def test_bytes_of_real_ros_are_read_as_the_message_they_were(name):
    kind = BY_NAME[name]
    read = [kind.decode(bytes.fromhex(text)) for text in PINNED["cdr"][name]]
    assert [to_plain(message) for message in read] == [to_plain(sample(kind, seed)) for seed in SEEDS]


@pytest.mark.parametrize("kind", [*TYPES, *SERVICES], ids=lambda kind: kind.name)
def test_a_type_has_the_hash_that_rosidl_gives_it(kind):
    assert kind.type_hash == PINNED["hashes"][kind.name]


def test_a_transform_is_encoded_by_the_rules_of_cdr():
    """`tf2_msgs` is not in the golden file, so these bytes are written by hand (DDSI-RTPS 10.2.1.2)."""
    message = TF_MESSAGE.blank()
    transform = typestore().types["geometry_msgs/msg/TransformStamped"]
    types = typestore().types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](5, 7), "map")
    place = types["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0)
    turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    message.transforms = [transform(header, "r1", types["geometry_msgs/msg/Transform"](place, turn))]
    expected = b"\0\1\0\0" + struct.pack("<IiIi4si3s", 1, 5, 7, 4, b"map\0", 3, b"r1\0") + bytes(5)
    expected += struct.pack("<7d", 1, 2, 3, 0, 0, 0, 1)
    assert TF_MESSAGE.encode(message) == expected
    assert to_plain(TF_MESSAGE.decode(expected)) == to_plain(message)


def test_big_endian_is_read_too():
    assert STRING.decode(b"\0\0\0\0" + struct.pack(">I", 3) + b"on\0") == String("on")


@pytest.mark.parametrize(
    ("payload", "why"),
    [
        (b"", "plain CDR"),
        (b"\0\1\0", "plain CDR"),
        (b"\0\3\0\0" + bytes(16), "plain CDR, got 0003"),  # a parameter list
        (b"\0\7\0\0" + bytes(16), "plain CDR, got 0007"),  # XCDR2
        (b"\0\1\0\0", "requires"),
        (b"\0\1\0\0" + struct.pack("<I", 2**32 - 1), "length"),
        (b"\0\1\0\0" + struct.pack("<I", 3) + b"onx", "terminator"),
        (b"\0\1\0\0" + struct.pack("<I", 3) + b"\xff\xff\0", "decode"),
        (b"\0\1\0\0" + struct.pack("<I", 0), "length"),
    ],
)
def test_bytes_that_are_no_string_are_refused_in_words(payload, why):
    with pytest.raises(BadCdr, match=why):
        STRING.decode(payload)


def test_a_message_beyond_its_bound_is_refused_before_it_is_read():
    small = MessageType(STRING.name, String, max_bytes=16)
    with pytest.raises(BadCdr, match="expected at most 16"):
        small.decode(STRING.encode(String("x" * 16)))


def test_a_grid_that_claims_more_cells_than_it_has_is_refused():
    payload = bytearray(OCCUPANCY_GRID.encode(OCCUPANCY_GRID.blank(data=np.zeros(100, np.int8))))
    payload[-104:-100] = struct.pack("<I", 2**31)
    with pytest.raises(BadCdr):
        OCCUPANCY_GRID.decode(bytes(payload))


@pytest.mark.parametrize("values", [{"ranges": np.ones(3)}, {"ranges": [1.0]}, {"angle_min": "x"}, {"header": None}])
def test_a_message_with_a_value_of_another_type_is_not_sent(values):
    with pytest.raises(BadCdr, match=r"sensor_msgs/msg/LaserScan cannot be encoded"):
        LASER_SCAN.encode(LASER_SCAN.blank(**values))


@pytest.mark.parametrize("kind", [LASER_SCAN, OCCUPANCY_GRID, PATH, TF_MESSAGE, MARKER_ARRAY, STRING])
@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 1000), at=st.integers(0), value=st.integers(0, 255), cut=st.integers(0, 40))
def test_whatever_the_bytes_they_are_read_or_refused(kind, seed, at, value, cut):
    payload = bytearray(kind.encode(sample(kind, seed)))
    payload[at % len(payload)] = value
    with suppress(BadCdr):
        kind.decode(bytes(payload[: len(payload) - cut]))
