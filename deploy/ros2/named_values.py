"""A task as named values, which is how a service of `rcl_interfaces` carries one; that package is in every ROS 2."""

from collections.abc import Mapping, Sequence
from typing import Any

from robrain.protocol.ros2.message_classes import Parameter

VALUES_MAX = 64
TEXT_MAX = 1024
ENTRIES_MAX = 256
FIELDS = ("bool_value", "integer_value", "double_value", "string_value", "byte_array_value",
          "bool_array_value", "integer_array_value", "double_array_value", "string_array_value")  # fmt: skip
"""By `type` from 1 (rcl_interfaces/msg/ParameterType)."""
BYTES = 5
NUMBERS = ("priority", "earliest_s", "deadline_s", "service_s")
"""Arguments of `Team.submit` that are numbers; `robots` is a whole one."""


class BadValues(ValueError):
    """Values that are no task; the text names the one that is wrong."""


def values_of(parameters: Sequence[Parameter]) -> dict[str, Any]:
    """The values by their names.

    Raises:
        BadValues: there are too many, a name is there twice, or a value is too long or of an unknown type.

    """
    if len(parameters) > VALUES_MAX:
        raise BadValues(f"expected at most {VALUES_MAX} values, got {len(parameters)}")
    found: dict[str, Any] = {}
    for parameter in parameters:
        name, value = parameter.name[:TEXT_MAX], parameter.value
        if not 1 <= value.type <= len(FIELDS) or value.type == BYTES:
            raise BadValues(f"{name}: expected a bool, number, text, or an array of them, got type {value.type}")
        if name in found:
            raise BadValues(f"{name}: is there twice")
        given: Any = getattr(value, FIELDS[value.type - 1])
        if isinstance(given, str):
            if len(given) > TEXT_MAX:
                raise BadValues(f"{name}: expected at most {TEXT_MAX} characters, got {len(given)}")
        elif not isinstance(given, bool | int | float):
            given = list(given) if isinstance(given, list) else given.tolist()
            if len(given) > ENTRIES_MAX or any(isinstance(each, str) and len(each) > TEXT_MAX for each in given):
                raise BadValues(f"{name}: expected at most {ENTRIES_MAX} entries of {TEXT_MAX} characters")
        found[name] = given
    return found


def task_arguments(values: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Kind of a task, and the arguments of `Team.submit`.

    Args:
        values: `kind`; `x` and `y` in metres, arena frame; perhaps `id`, `priority`, `earliest_s`, `deadline_s`,
            `service_s` and `robots`; all others are parameters of the kind.

    Raises:
        BadValues: one is missing or of another type.

    >>> task_arguments({"kind": "visit", "x": 1.0, "y": 2, "priority": 3})
    ('visit', {'place': (1.0, 2.0), 'priority': 3.0, 'parameters': {}})
    """
    left = dict(values)
    kind = left.pop("kind", None)
    if not isinstance(kind, str) or not kind:
        raise BadValues(f"kind: expected the kind of task as text, got {kind!r}")
    arguments: dict[str, Any] = {"place": (_number(left, "x"), _number(left, "y"))}
    if "id" in left:
        arguments["id"] = left.pop("id")
        if not isinstance(arguments["id"], str):
            raise BadValues(f"id: expected text, got {arguments['id']!r}")
    arguments |= {name: _number(left, name) for name in NUMBERS if name in left}
    if "robots" in left:
        robots = _number(left, "robots")
        if not robots.is_integer():
            raise BadValues(f"robots: expected a whole number, got {robots}")
        arguments["robots"] = int(robots)
    return kind, {**arguments, "parameters": left}


def _number(values: dict[str, Any], name: str) -> float:
    value = values.pop(name, None)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadValues(f"{name}: expected a number, got {value!r}")
    return float(value)
