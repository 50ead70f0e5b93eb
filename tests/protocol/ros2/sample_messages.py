"""Messages of every type with values drawn from a seed, the same in rosbags' and in rclpy's classes."""

import importlib
import random
import struct
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc

from robrain.protocol.ros2 import message_types
from robrain.protocol.ros2.message_types import MessageType, ServiceType, typestore

SERVICES = sorted(
    (kind for kind in vars(message_types).values() if isinstance(kind, ServiceType)), key=lambda kind: kind.name
)
TYPES: list[MessageType[Any]] = sorted(
    [
        *(kind for kind in vars(message_types).values() if isinstance(kind, MessageType)),
        *(part for service in SERVICES for part in (service.request, service.response)),
    ],
    key=lambda kind: kind.name,
)
NOT_IN_RCLPY = ("tf2_msgs/", "robrain_msgs/")
"""Packages that are not to be had without a ROS installation."""

INTEGERS = {
    "int8": (-(2**7), 2**7 - 1),
    "uint8": (0, 2**8 - 1),
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "int64": (-(2**63), 2**63 - 1),
    "uint64": (0, 2**64 - 1),
}
FILLER = "structure_needs_at_least_one_member"
"""The byte of a message without fields, which rclpy does not let anybody set."""
SIZES = {"bool": 1, "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "float32": 4, "float64": 8} | {
    f"{sign}int{bits}": bits // 8 for sign in ("", "u") for bits in (32, 64)
}
LONGEST = 4
WORDS = ("", "a", "map", "base_link", "Größe 5 m²", "四")


def sample(kind: MessageType[Any], seed: int) -> Any:
    """A message; its sequences have 0 to `LONGEST` entries."""
    return _sample_of(kind.name, random.Random(f"{kind.name} {seed}"))


def _sample_of(name: str, rng: random.Random) -> Any:
    store = typestore()
    fields = store.fielddefs[name][1]
    return store.types[name](*(0 if field == FILLER else _value(desc, rng) for field, desc in fields))


def _value(desc: FieldDesc, rng: random.Random) -> Any:
    if desc[0] == Nodetype.NAME:
        return _sample_of(desc[1], rng)
    if desc[0] == Nodetype.BASE:
        return _scalar(desc[1][0], rng)
    inner, length = desc[1]
    count = length if desc[0] == Nodetype.ARRAY else rng.randint(0, LONGEST)
    values = [_value(inner, rng) for _ in range(count)]
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        return np.array(values, inner[1][0])
    return values


def _scalar(base: str, rng: random.Random) -> Any:
    if base == "string":
        return rng.choice(WORDS)
    if base == "bool":
        return rng.random() < 0.5
    if base == "float64":
        return rng.uniform(-1e6, 1e6)
    if base == "float32":
        return struct.unpack("<f", struct.pack("<f", rng.uniform(-1e6, 1e6)))[0]
    return rng.randint(*INTEGERS[base])


def to_plain(message: Any) -> Any:
    """A message as dictionaries and lists, to compare."""
    if is_dataclass(message):
        return {each.name: to_plain(getattr(message, each.name)) for each in fields(message)}
    if isinstance(message, np.ndarray):
        return message.tolist()
    if isinstance(message, list):
        return [to_plain(each) for each in message]
    return message


def rclpy_class(name: str) -> Any:
    """The class of a message, or of a part of a service, in rclpy."""
    package, kind, message = name.split("/")
    module = importlib.import_module(f"{package}.{kind}")
    service, _, part = message.rpartition("_")
    return getattr(getattr(module, service), part) if kind == "srv" else getattr(module, message)


def to_rclpy(message: Any, name: str) -> Any:
    """The same message in rclpy's class."""
    found = rclpy_class(name)()
    for field, desc in typestore().fielddefs[name][1]:
        if field != FILLER:
            setattr(found, field, _to_rclpy_value(getattr(message, field), desc))
    return found


def _to_rclpy_value(value: Any, desc: FieldDesc) -> Any:
    if desc[0] == Nodetype.NAME:
        return to_rclpy(value, desc[1])
    if desc[0] == Nodetype.BASE:
        return value
    inner, _ = desc[1]
    if inner[0] == Nodetype.NAME:
        return [to_rclpy(each, inner[1]) for each in value]
    return value if desc[0] == Nodetype.ARRAY else list(value.tolist() if isinstance(value, np.ndarray) else value)


def without_padding(payload: bytes, kind: MessageType[Any], message: Any) -> bytes:
    """CDR with zeros between fields and nothing behind them, where rclpy leaves whatever was in its buffer.

    Where the fields are follows from the rules of CDR alone (DDSI-RTPS 10.2.1.2): each value is aligned to its size.
    """
    kept = bytearray(payload[:4])
    _end(kind.name, message, 0, kept, payload[4:])
    return bytes(kept)


def _end(name: str, message: Any, at: int, kept: bytearray, body: bytes) -> int:
    for field, desc in typestore().fielddefs[name][1]:
        at = _end_of(desc, getattr(message, field), at, kept, body)
    return at


def _end_of(desc: FieldDesc, value: Any, at: int, kept: bytearray, body: bytes) -> int:
    def keep(size: int, alignment: int) -> int:
        start = at + -at % alignment
        kept.extend(bytes(start - at) + body[start : start + size])
        return start + size

    if desc[0] == Nodetype.NAME:
        return _end(desc[1], value, at, kept, body)
    if desc[0] == Nodetype.BASE:
        is_text = desc[1][0] == "string"
        return keep(4 + len(value.encode()) + 1, 4) if is_text else keep(SIZES[desc[1][0]], SIZES[desc[1][0]])
    if desc[0] == Nodetype.SEQUENCE:
        at = keep(4, 4)
    for each in value:
        at = _end_of(desc[1][0], each, at, kept, body)
    return at
