"""A task as the values of a service of rcl_interfaces."""

import numpy as np
import pytest

from robrain.deploy.ros2.named_values import ENTRIES_MAX, TEXT_MAX, VALUES_MAX, BadValues, task_arguments, values_of
from robrain.protocol.ros2.message_classes import Parameter, ParameterValue
from robrain.protocol.ros2.message_types import MessageType

VALUE = MessageType("rcl_interfaces/msg/ParameterValue", ParameterValue)


def value(name, **fields):
    return Parameter(name, VALUE.blank(**fields))


def test_values_are_found_by_their_types():
    assert values_of(
        [
            value("a", type=1, bool_value=True),
            value("b", type=2, integer_value=3),
            value("c", type=3, double_value=0.5),
            value("d", type=4, string_value="x"),
            value("e", type=6, bool_array_value=np.array([True])),
            value("f", type=7, integer_array_value=np.array([1, 2])),
            value("g", type=8, double_array_value=np.array([1.5])),
            value("h", type=9, string_array_value=["y"]),
        ]
    ) == {"a": True, "b": 3, "c": 0.5, "d": "x", "e": [True], "f": [1, 2], "g": [1.5], "h": ["y"]}


@pytest.mark.parametrize(
    ("parameters", "why"),
    [
        ([value("a", type=0)], "a: expected a bool"),
        ([value("a", type=5)], "a: expected a bool"),  # bytes
        ([value("a", type=10)], "a: expected a bool"),
        ([value("a", type=1), value("a", type=1)], "a: is there twice"),
        ([value("a", type=4, string_value="x" * (TEXT_MAX + 1))], "a: expected at most"),
        ([value("a", type=7, integer_array_value=np.zeros(ENTRIES_MAX + 1, np.int64))], "a: expected at most"),
        ([value("a", type=9, string_array_value=["x" * (TEXT_MAX + 1)])], "a: expected at most"),
        ([value(f"a{number}", type=1) for number in range(VALUES_MAX + 1)], "expected at most"),
    ],
)
def test_other_values_are_refused_by_name(parameters, why):
    with pytest.raises(BadValues, match=why):
        values_of(parameters)


def test_what_no_argument_is_named_after_is_a_parameter_of_the_kind():
    values = {"kind": "inspect", "x": 1, "y": 2.0, "id": "i", "robots": 2, "deadline_s": 60, "look_at": [5.0, 1.0]}
    assert task_arguments(values) == (
        "inspect",
        {"place": (1.0, 2.0), "id": "i", "robots": 2, "deadline_s": 60.0, "parameters": {"look_at": [5.0, 1.0]}},
    )


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"x": 1.0, "y": 2.0}, "kind: expected"),
        ({"kind": "", "x": 1.0, "y": 2.0}, "kind: expected"),
        ({"kind": "visit", "y": 2.0}, "x: expected a number, got None"),
        ({"kind": "visit", "x": "1", "y": 2.0}, "x: expected a number, got '1'"),
        ({"kind": "visit", "x": True, "y": 2.0}, "x: expected a number, got True"),
        ({"kind": "visit", "x": 1.0, "y": 2.0, "priority": "high"}, "priority: expected a number"),
        ({"kind": "visit", "x": 1.0, "y": 2.0, "id": 3}, "id: expected text, got 3"),
        ({"kind": "visit", "x": 1.0, "y": 2.0, "robots": float("inf")}, "robots: expected a whole number"),
    ],
)
def test_what_is_no_task_is_refused_by_name(values, why):
    with pytest.raises(BadValues, match=why):
        task_arguments(values)
