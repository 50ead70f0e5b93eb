"""Arguments from a language model: bounded, checked, refused in words."""

import math
from typing import Any

import pytest

from robrain.deploy.assistant.arguments import (
    BYTES_MAX,
    Arguments,
    CallPlugin,
    CancelTask,
    HaltRobots,
    ListTasks,
    OfRobot,
    SubmitTask,
    arguments_of,
    order_text,
)
from robrain.deploy.assistant.policy import Ban, CallRefused

VISIT = {"kind": "visit", "x_m": 1.0, "y_m": 2}
CALL = {"robot": "r1", "plugin": "lamp", "function": "switch"}


def nested(depth: int) -> Any:
    return {"a": nested(depth - 1)} if depth else 1


@pytest.mark.parametrize(
    ("given", "type_", "named"),
    [
        ({"robot": "r1", "extra": 1}, OfRobot, "extra"),  # an unknown argument
        ({}, OfRobot, "robot"),  # a missing one
        ({"robot": "r1/host"}, OfRobot, "robot"),  # a name that is part of another key
        ({"robot": "*"}, OfRobot, "robot"),
        ({"robot": ""}, OfRobot, "robot"),
        ({"robot": 7}, OfRobot, "robot"),
        ({"robot": "r1", "reason": "x" * 201}, HaltRobots, "reason"),
        ({"reason": "a\nline"}, HaltRobots, "control"),
        ({"reason": "hid\u200bden"}, HaltRobots, "control"),
        ({"task": "t1", "reason": ["a"]}, CancelTask, "reason"),
        ({"limit": 101}, ListTasks, "limit"),
        ({"states": ["asleep"]}, ListTasks, "states"),
        ({**VISIT, "x_m": math.nan}, SubmitTask, "x_m"),
        ({**VISIT, "y_m": math.inf}, SubmitTask, "y_m"),
        ({**VISIT, "x_m": 1e9}, SubmitTask, "x_m"),
        ({**VISIT, "x_m": "1"}, SubmitTask, "x_m"),
        ({**VISIT, "priority": 1.01}, SubmitTask, "priority"),
        ({**VISIT, "priority": 0.0}, SubmitTask, "priority"),
        ({**VISIT, "robots": 17}, SubmitTask, "robots"),
        ({**VISIT, "service_s": 3601.0}, SubmitTask, "service_s"),
        ({**VISIT, "after": ["t"] * 17}, SubmitTask, "after"),
        ({**VISIT, "parameters": {str(n): n for n in range(17)}}, SubmitTask, "parameters"),
        ({**VISIT, "parameters": {"a": "x" * BYTES_MAX}}, SubmitTask, "bytes"),
        ({**VISIT, "parameters": {"a": math.nan}}, SubmitTask, "finite"),
        ({**VISIT, "confirm": "x" * 65}, SubmitTask, "confirm"),
        ({**CALL, "arguments": [1]}, CallPlugin, "arguments"),
        ({**CALL, "arguments": nested(9)}, CallPlugin, "deeper"),
        ({**CALL, "function": "a b"}, CallPlugin, "function"),
        ([], Arguments, "object"),
        (None, Arguments, "object"),
    ],
)
def test_arguments_out_of_bounds_are_refused_and_named(given: Any, type_: type[Arguments], named: str) -> None:
    with pytest.raises(CallRefused) as caught:
        arguments_of(given, type_)
    assert caught.value.ban is Ban.BAD_ARGUMENTS
    assert named in str(caught.value)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("name", ["id", "kind", "priority", "robots", "deadline_ns", "deadline_in_s", "after", "place"])
def test_a_field_of_every_task_cannot_be_given_among_the_parameters(name: str) -> None:
    asked = arguments_of({**VISIT, "parameters": {name: 5}}, SubmitTask)
    with pytest.raises(CallRefused, match=f"{name} is a field of every task") as caught:
        _ = asked.fields
    assert caught.value.ban is Ban.BAD_ARGUMENTS


def test_an_order_is_the_same_with_and_without_its_token_and_another_with_any_other_argument() -> None:
    def text(tool: str, **more: Any) -> bytes:
        return order_text(tool, arguments_of({**VISIT, **more}, SubmitTask))

    order = text("submit_task")
    assert text("submit_task", confirm="abc") == order
    assert text("submit_task", y_m=2.0) == order
    others = [text("submit_task", x_m=1.1), text("submit_task", robots=2), text("submit_task", parameters={"a": 1})]
    assert order not in [*others, text("dry_run")]
    assert text("submit_task", parameters={"a": 1, "b": 2}) == text("submit_task", parameters={"b": 2, "a": 1})
