"""Against real ROS 2 Jazzy: rclpy reads what robrain writes, and robrain what rclpy writes."""

import json
from typing import Any

import pytest

from robrain.protocol.ros2.message_types import MessageType
from tests.protocol.ros2.real_ros import (
    ELSEWHERE,
    GOLDEN,
    HAS_RCLPY,
    NEEDED,
    SEEDS,
    golden_bytes,
    hashes_of,
    serialized,
)
from tests.protocol.ros2.sample_messages import NOT_IN_RCLPY, SERVICES, TYPES, sample, to_plain

pytestmark = [
    pytest.mark.skipif(not HAS_RCLPY, reason=NEEDED),
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),  # of rosidl's parser
]

IN_RCLPY: list[MessageType[Any]] = [kind for kind in TYPES if not kind.name.startswith(NOT_IN_RCLPY)]
MESSAGES = 25


@pytest.mark.parametrize("kind", IN_RCLPY, ids=lambda kind: kind.name)
def test_robrain_reads_what_rclpy_writes(kind):
    for seed in range(MESSAGES):
        message = sample(kind, seed)
        assert to_plain(kind.decode(serialized(kind.name, message))) == to_plain(message)


@pytest.mark.parametrize("kind", IN_RCLPY, ids=lambda kind: kind.name)
def test_both_write_the_same_bytes(kind):
    for seed in range(MESSAGES):
        message = sample(kind, seed)
        assert kind.encode(message) == golden_bytes(kind, message)


@pytest.mark.parametrize("package", ELSEWHERE)
def test_a_type_of_another_package_has_the_hash_that_rosidl_computes(package, tmp_path):
    computed = hashes_of(package, ELSEWHERE[package], tmp_path)
    kinds = [kind for kind in (*TYPES, *SERVICES) if kind.name.startswith(package)]
    assert kinds
    assert {kind.name: kind.type_hash for kind in kinds} == {kind.name: computed[kind.name] for kind in kinds}


def test_the_golden_file_is_what_this_ros_writes():
    pinned = json.loads(GOLDEN.read_text(encoding="utf-8"))["cdr"]
    assert pinned == {kind.name: [golden_bytes(kind, sample(kind, seed)).hex() for seed in SEEDS] for kind in IN_RCLPY}
