"""Every reason has a code and a sentence, passes the wire as a value, and none can hold another without end."""

import inspect
from typing import Any, get_args

import msgspec
import pytest

from robrain.protocol import reasons
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.reasons import Reason, TopicStale, plain, sentence_of
from tests.random_words import reason_types

KINDS = reason_types()
UNIONS = (
    reasons.IdleReason,
    reasons.OfferRefusal,
    reasons.Unavailable,
    reasons.RobotReason,
    reasons.PlanReason,
    reasons.TaskReason,
    TopicStale,
)
NESTED_MOST = 6
"""Reasons within reasons, at the most: of a task that waits for one that was left out for a robot that refused."""


def test_a_plain_reason_has_its_kind_its_sentence_and_its_values():
    reason = plain("no_way", "no way leads there", needed_m=0.44, robots=("r1", "r2"))
    assert (reason.code, str(reason)) == ("no_way", "no way leads there")
    wire = msgspec.json.encode(reason)
    values = {"needed_m": 0.44, "robots": ["r1", "r2"]}
    assert msgspec.json.decode(wire) == {
        "code": "said",
        "kind": "no_way",
        "text": "no way leads there",
        "values": values,
    }
    for union in UNIONS[:-1]:
        assert msgspec.json.decode(wire, type=union) == reason


def example(kind: Any) -> Any:
    """A value of a type; of a union the value that holds most."""
    if kind is type(None):
        return None
    if options := [option for option in get_args(kind) if inspect.isclass(option) and issubclass(option, Reason)]:
        return max((example(option) for option in options), key=depth)
    if isinstance(kind, type) and issubclass(kind, Reason):
        hints = msgspec.structs.fields(kind)
        return kind(**{field.name: example(field.type) for field in hints})
    kind = kind.__origin__ if hasattr(kind, "__metadata__") else kind
    if getattr(kind, "__origin__", None) is dict:
        return {"a": "b"}
    by_type = {str: "a", bool: True, int: 3, float: 0.5, Point2D: Point2D(1.0, 2.0), TaskState: TaskState.FAILED}
    return example(get_args(kind)[0]) if get_args(kind) else by_type[kind]


def depth(value: Any) -> int:
    if isinstance(value, tuple):
        return max((depth(part) for part in value), default=0)
    if not isinstance(value, Reason):
        return 0
    return 1 + max((depth(getattr(value, name)) for name in value.__struct_fields__), default=0)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__struct_config__.tag)
def test_each_reason_has_words_passes_the_wire_and_is_small(kind):
    reason = example(kind)
    assert sentence_of(reason) == str(reason) != ""
    for union in UNIONS:
        if kind in (get_args(union) or (union,)):
            assert msgspec.json.decode(msgspec.json.encode(reason), type=union) == reason
    assert depth(reason) <= NESTED_MOST
