"""Schemas of channels in the one form that Foxglove and Lichtblick read: one type for each property, nothing else."""

from enum import Enum, StrEnum
from typing import Any, Literal

import msgspec
import pytest

from robrain.protocol.table.topics import all_topics
from robrain.protocol.topic import Topic
from robrain.recording.foxglove.plain_schema import SCALARS, plain_schema


class Colour(StrEnum):
    RED = "red"


class Level(Enum):
    LOW = 1


class Point(msgspec.Struct):
    x_m: float
    label: str = ""


class Left(msgspec.Struct, tag=True):
    a: int
    both: int


class Right(msgspec.Struct, tag=True):
    b: list[float]
    both: float


class Nest(msgspec.Struct):
    inner: "Nest | None" = None


class Everything(msgspec.Struct):
    maybe: float | None
    point: Point | None
    points: list[Point]
    colour: Colour
    level: Level
    word: Literal["a", "b"]
    pair: tuple[float, float]
    mixed: tuple[str, float]
    grid: list[list[int]]
    either: Left | Right
    number_or_word: int | str
    free: Any
    by_name: dict[str, int]
    nest: Nest


def assert_plain(schema: dict[str, Any]) -> None:
    """Raises AssertionError where a reader that knows no more than one type a property would give up."""
    assert schema["type"] == "object"
    assert set(schema["required"]) <= set(schema["properties"])
    for value in schema["properties"].values():
        inner = value["items"] if value["type"] == "array" else value
        if inner["type"] == "object":
            assert_plain(inner)
        else:
            assert inner["type"] in SCALARS


def test_each_type_has_a_plain_form() -> None:
    plain = plain_schema(msgspec.json.schema(Everything))
    assert_plain(plain)
    told = plain["properties"]
    assert list(told) == list(Everything.__struct_fields__)
    assert told["maybe"] == {"type": "number"}
    assert told["point"]["properties"]["x_m"] == {"type": "number"}
    assert told["point"]["required"] == ["x_m"]
    assert told["points"]["items"]["properties"]["label"] == {"type": "string"}
    assert (told["colour"]["type"], told["colour"]["enum"]) == ("string", ["red"])
    assert told["level"]["type"] == "integer"
    assert told["word"]["type"] == "string"
    assert told["pair"]["items"] == {"type": "number"}
    assert told["either"]["properties"]["both"] == {"type": "number"}
    assert set(told["either"]["properties"]) == {"type", "a", "b", "both"}
    for unknown in (told["mixed"]["items"], told["grid"]["items"], told["number_or_word"], told["free"]):
        assert unknown == {"type": "object", "properties": {}, "required": []}


@pytest.mark.parametrize(
    "topic",
    [topic for topic in all_topics() if topic.recorded and topic.message is not None],
    ids=lambda topic: topic.name,
)
def test_every_recorded_message_is_described_plainly(topic: Topic) -> None:
    assert topic.message is not None
    plain = plain_schema(topic.json_schema())
    assert_plain(plain)
    assert set(topic.message.__struct_fields__) <= set(plain["properties"])


def depth_of(plain: Any) -> int:
    inner = plain["properties"].get("inner")
    if inner is not None and inner["type"] == "array":
        return 2 + depth_of(inner["items"])
    return 0 if inner is None else 1 + depth_of(inner) if inner["type"] == "object" else 1
