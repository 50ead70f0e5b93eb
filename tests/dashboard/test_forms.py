"""Forms out of JSON Schema."""

from typing import Literal

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.client.submission import BadTask
from robrain.dashboard.panels.function_form import FieldKind, FormField, arguments_of, fields_of
from robrain.dashboard.panels.page import stock_kinds
from robrain.dashboard.panels.task_tab import form_submission, task_fields
from robrain.protocol.messages.tasks.task_messages import KnownKind
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import check_parameters


class Arguments(msgspec.Struct):
    """As the host makes it of a function's type hints."""

    distance_m: float
    place: Point2D
    times: int = 1
    mode: Literal["slow", "fast"] = "fast"
    name: str | None = None
    loud: bool = False
    points: list[Point2D] = []


KINDS = {known.kind: known for known in stock_kinds() if known.kind != "explore"}
FIELDS = fields_of(msgspec.json.schema(Arguments))


def test_each_parameter_has_a_field_of_its_kind() -> None:
    kinds = {field.label: (field.kind, field.required) for field in FIELDS}
    assert kinds == {
        "distance_m": (FieldKind.NUMBER, True),
        "place.x_m": (FieldKind.NUMBER, True),
        "place.y_m": (FieldKind.NUMBER, True),
        "times": (FieldKind.INTEGER, False),
        "mode": (FieldKind.CHOICE, False),
        "name": (FieldKind.TEXT, False),
        "loud": (FieldKind.BOOLEAN, False),
        "points": (FieldKind.JSON, False),
    }
    assert {field.label: field.default for field in FIELDS if field.default} == {
        "times": "1",
        "mode": "fast",
        "loud": "false",
        "points": "[]",
    }
    assert {field.label: field.choices for field in FIELDS if field.choices} == {"mode": ("fast", "slow")}


def test_what_is_typed_becomes_arguments_and_what_is_left_out_stays_out() -> None:
    typed: dict[str, str | bool] = {
        "distance_m": " 1.5 ",
        "place.x_m": "1",
        "place.y_m": "-2",
        "times": "",
        "loud": True,
        "points": '[{"x_m": 1.0, "y_m": 2.0}]',
    }
    arguments = arguments_of(FIELDS, typed)
    assert arguments == {
        "distance_m": 1.5,
        "place": {"x_m": 1.0, "y_m": -2.0},
        "loud": True,
        "points": [{"x_m": 1.0, "y_m": 2.0}],
    }
    assert msgspec.convert(arguments, Arguments).place == Point2D(1.0, -2.0)


@given(st.dictionaries(st.sampled_from([field.label for field in FIELDS]), st.text(max_size=12)))
def test_whatever_is_typed_becomes_arguments_or_a_mistake_that_names_a_field(typed: dict[str, str]) -> None:
    mistake = ""
    try:
        msgspec.json.encode(arguments_of(FIELDS, typed))
    except ValueError as error:
        mistake = str(error)
    assert not mistake or mistake.partition(":")[0] in {field.label for field in FIELDS}


SCHEMA_WORDS = ["properties", "type", "$ref", "$defs", "anyOf", "enum", "required", "default", "description", "a"]
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(SCHEMA_WORDS), inner, max_size=4),
    max_leaves=12,
)


AREA = '[{"x_m": 1.0, "y_m": 2.0}, {"x_m": 3.0, "y_m": 2.0}, {"x_m": 3.0, "y_m": 4.0}]'
OF_KIND = {
    "relay": {"mote": "m1"},
    "patrol": {"stops": '[{"x_m": 1.0, "y_m": 2.0}]'},
    "deliver": {"to": "1,2"},
    "sweep": {"area": AREA},
    "guard": {"area": AREA},
}
"""What is typed besides for some kinds."""


@pytest.mark.parametrize("kind", sorted(KINDS.values(), key=lambda known: known.kind), ids=lambda known: known.kind)
def test_every_kind_of_task_can_be_asked_for_by_form(kind: KnownKind) -> None:
    typed = {field.label: field.default or "2" for field in task_fields(kind) if field.required}
    typed |= {"deadline_in_s": "60"} | OF_KIND.get(kind.kind, {})
    submission = form_submission(kind, arguments_of(task_fields(kind), typed))
    assert submission.task.kind == kind.kind
    check_parameters(submission.task)
    assert submission.deadline_in_s == 60.0
    assert submission.by.startswith("operator")


def test_a_kind_that_only_a_robot_knows_has_a_form_made_of_its_schema() -> None:
    schema = {
        "type": "object",
        "properties": {"width_m": {"type": "number", "exclusiveMinimum": 0}, "gently": {"type": "boolean"}},
        "required": ["width_m"],
        "additionalProperties": False,
    }
    mow = KnownKind(kind="mow", parameters=schema, robots=["r1"])
    labels = [field.label for field in task_fields(mow)]
    assert labels[:3] == ["place.x_m", "place.y_m", "width_m"]
    assert "gently" in labels
    place = {"x_m": 1.0, "y_m": 2.0}
    submission = form_submission(mow, {"place": place, "width_m": 2.0, "gently": True, "priority": 3.0})
    assert submission.task.parameters == {"width_m": 2.0, "gently": True}
    assert submission.task.priority == 3.0
    with pytest.raises(ValueError, match=r"width_m: -2\.0 is less than or equal to the minimum of 0"):
        form_submission(mow, {"place": place, "width_m": -2.0})


@pytest.mark.slow
@settings(max_examples=30)
@given(json_values)
def test_a_kind_whose_schema_is_nonsense_has_the_fields_that_every_task_has(nonsense: object) -> None:
    schema = nonsense if isinstance(nonsense, dict) else {"properties": nonsense, "required": nonsense}
    labels = [field.label for field in task_fields(KnownKind(kind="odd", parameters=schema))]
    assert {"place.x_m", "place.y_m", "priority"} <= set(labels)


@pytest.mark.slow
@settings(max_examples=30)
@given(st.dictionaries(st.sampled_from(SCHEMA_WORDS), json_values, max_size=5))
def test_schema_of_a_stranger_makes_no_trouble(schema: dict[str, object]) -> None:
    for field in fields_of(schema):
        assert isinstance(field, FormField)
        assert isinstance(field.title, str)


@pytest.mark.parametrize(
    ("typed", "error"),
    [
        ({}, "distance_m: expected a number, got nothing"),
        ({"distance_m": "far"}, "distance_m: expected a number, got 'far'"),
        ({"distance_m": "inf"}, "distance_m: expected a number, got 'inf'"),
        ({"distance_m": "1"}, "place.x_m: expected a number, got nothing"),
        ({"distance_m": "1", "place.x_m": "1", "place.y_m": "1", "times": "1.5"}, "times: expected a whole number"),
        ({"distance_m": "1", "place.x_m": "1", "place.y_m": "1", "mode": "x"}, "mode: expected a choice of fast, slow"),
        ({"distance_m": "1", "place.x_m": "1", "place.y_m": "1", "points": "[["}, "points: expected a value in JSON"),
    ],
)
def test_mistake_names_the_field(typed: dict[str, str], error: str) -> None:
    with pytest.raises(ValueError, match="expected") as mistake:
        arguments_of(FIELDS, typed)
    assert str(mistake.value).startswith(error)


def test_a_form_refuses_names_of_places() -> None:
    arguments = {"place": {"x_m": 1.0, "y_m": 2.0}, "stops": ["kitchen"]}
    with pytest.raises(BadTask, match="expected x and y in metres, got the name kitchen"):
        form_submission(KINDS["patrol"], arguments)
