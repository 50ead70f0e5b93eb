"""Parameters are checked against schemas that come from strangers: in bounded time, and in words."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import STOCK_KINDS, check_parameters
from robrain.protocol.model.tasks.task import BadParameters, Task
from robrain.protocol.schema.announced_parameters import PARTS_MAX, check_announced, schema_refusal
from robrain.protocol.schema.struct_schema import parameters_schema

SCHEMAS = {kind: parameters_schema(type_) for kind, type_ in STOCK_KINDS.items()}
SIDE = {"type": "object", "properties": {"side_m": {"type": "number", "exclusiveMinimum": 0}}, "required": ["side_m"]}


def why(kind, parameters, *schemas) -> str:
    try:
        check_announced(kind, parameters, schemas)
    except BadParameters as error:
        return str(error)
    return ""


@pytest.mark.parametrize("kind", SCHEMAS)
def test_the_schemas_of_the_stock_kinds_can_be_used(kind: str) -> None:
    assert schema_refusal(SCHEMAS[kind]) == ""
    assert SCHEMAS[kind]["type"] == "object"
    for name, field in SCHEMAS[kind]["properties"].items():
        assert field.get("description"), name


@pytest.mark.parametrize(
    ("kind", "parameters", "said"),
    [
        ("relay", {"mote": "m1"}, "a task to relay needs duration_s"),
        ("relay", {"duration_s": 1.0}, "expected a mote or a robot to be the link to, got neither"),
        ("relay", {"duration_s": 1.0, "mote": ""}, "expected a mote or a robot to be the link to, got neither"),
        ("visit", {"colour": "red"}, "colour: a task to visit has no such parameter, but none"),
        ("sense", {"color": 1}, "color: a task to sense has no such parameter, but mote, quantity, timeout_s"),
        ("monitor", {"duration_s": 0}, "duration_s: 0 is less than or equal to the minimum of 0.0"),
        ("monitor", {"duration_s": "long"}, "duration_s: 'long' is not of type 'number'"),
        ("inspect", {"look_at": {"x_m": 1.0}}, "look_at: {'x_m': 1.0} is not valid under any of the given schemas"),
    ],
)
def test_a_mistake_is_told_with_its_parameter(kind: str, parameters: dict, said: str) -> None:
    assert why(kind, parameters, SCHEMAS[kind]) == said


@given(
    st.sampled_from(sorted(SCHEMAS)),
    st.dictionaries(
        st.sampled_from(["mote", "robot", "duration_s", "interval_s", "views", "quantity", "until_soc", "odd"]),
        st.sampled_from([0, 1, 0.5, -1.0, 1e9, "", "m1", None, [], {}, True]),
        max_size=4,
    ),
)
def test_the_announced_schema_allows_what_the_type_allows(kind: str, parameters: dict) -> None:
    task = Task(id="t", kind=kind, place=Point2D(0.0, 0.0), parameters=parameters)
    try:
        check_parameters(task)
        fits = True
    except BadParameters:
        fits = False
    assert (why(kind, parameters, SCHEMAS[kind]) == "") == fits


def test_parameters_that_fit_one_of_two_robots_are_accepted() -> None:
    other = {"type": "object", "properties": {"radius_m": {"type": "number"}}, "required": ["radius_m"]}
    assert why("sweep", {"side_m": 1.0}, other, SIDE) == ""
    assert why("sweep", {}, SIDE, other) == "a task to sweep needs side_m"


def doubling(depth: int) -> dict:
    """Each definition twice refers to the next: 2**depth parts when unfolded."""
    names = {f"d{number}": {"anyOf": [{"$ref": f"#/$defs/d{number + 1}"}] * 2} for number in range(depth)}
    return {"$ref": "#/$defs/d0", "$defs": {**names, f"d{depth}": {"type": "number"}}}


def nested(depth: int) -> dict:
    schema: dict = {"type": "number"}
    for _ in range(depth):
        schema = {"items": schema}
    return schema


@pytest.mark.parametrize(
    ("schema", "said"),
    [
        ({"$ref": "#"}, "refers to #, which is not in its $defs"),
        ({"$ref": "https://example.org/s.json"}, "refers to https://example.org/s.json, which is not in its $defs"),
        ({"$ref": "#/$defs/a", "$defs": {"a": {"anyOf": [{"$ref": "#/$defs/a"}]}}}, "refers to #/$defs/a in a circle"),
        (doubling(14), f"has more than {PARTS_MAX} parts when unfolded"),
        (nested(40), "is nested deeper than 32 levels"),
        ({"properties": {"a": {"type": "nonsense"}}}, "is no JSON Schema: 'nonsense' is not valid"),
        ({"properties": {"a": 1}}, "has a part that is neither an object nor true or false"),
        ({"dependentSchemas": {}}, "uses dependentSchemas, which is not supported"),
        ({"$id": "https://example.org/", "type": "object"}, "uses $id, which is not supported"),
        ({"type": "object", "description": "x" * 40_000}, "is longer than 32768 bytes"),
    ],
)
def test_a_schema_that_could_do_harm_is_not_used_and_everything_passes(schema: dict, said: str) -> None:
    assert schema_refusal(schema).startswith(said)
    assert why("sweep", {"anything": 1}, schema) == ""


def test_a_regular_expression_that_takes_for_ever_is_not_run() -> None:
    schema = {"type": "object", "properties": {"a": {"type": "string", "pattern": "^(a+)+$"}}}
    begun = time.process_time()
    assert why("sweep", {"a": "a" * 40 + "!"}, schema) == ""
    assert time.process_time() - begun < 5.0


words = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 5) | st.sampled_from(["object", "#/$defs/a", "number", ""]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                ["type", "properties", "anyOf", "$ref", "$defs", "items", "a", "required", "enum", "minimum"]
            ),
            inner,
            max_size=4,
        )
    ),
    max_leaves=15,
)


@pytest.mark.slow
@given(st.dictionaries(st.sampled_from(["type", "properties", "anyOf", "$defs", "$ref", "required"]), words), words)
def test_no_schema_of_a_stranger_ends_anything(schema: dict, value: object) -> None:
    assert isinstance(why("sweep", {"a": value}, schema), str)
