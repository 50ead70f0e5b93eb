"""The JSON Schemas of the wire say of each field what it is, and hold for what is said."""

import json
from pathlib import Path

import jsonschema
import msgspec
import pytest

from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.schema.struct_schema import (
    DIALECT,
    bare,
    definitions,
    field_meanings,
    schema_of,
    structs_in,
    types_of,
)
from robrain.protocol.table.topics import all_rows

GOLDEN = sorted((Path(__file__).parents[1] / "golden").glob("*.json"))
STRUCTS = {struct.__name__: struct for struct in structs_in(kind for row in all_rows() for kind in types_of(row))}


@pytest.mark.slow
@pytest.mark.parametrize("struct", STRUCTS.values(), ids=STRUCTS)
def test_every_field_has_a_meaning(struct):
    assert set(struct.__struct_fields__) == set(field_meanings(struct))
    assert definitions()[struct.__name__]["description"]


def test_a_field_has_type_range_unit_and_meaning():
    pose = schema_of(Pose2D)
    assert pose["$schema"] == DIALECT
    assert pose["$defs"]["Pose2D"]["properties"]["yaw_rad"] == {
        "type": "number",
        "minimum": -1e6,
        "maximum": 1e6,
        "$comment": "unit: rad",
        "description": "Heading, counter-clockwise from the x axis.",
    }


@pytest.mark.slow
@pytest.mark.parametrize("path", [path for path in GOLDEN if path.stem in STRUCTS], ids=lambda path: path.stem)
def test_a_message_as_it_is_sent_is_valid_and_a_broken_one_is_not(path):
    validator = jsonschema.Draft202012Validator(bare(schema_of(STRUCTS[path.stem])))
    said = json.loads(path.read_bytes())
    validator.validate(said)
    assert not validator.is_valid([said])


def test_null_is_valid_where_the_type_allows_it_and_only_there():
    validator = jsonschema.Draft202012Validator(schema_of(RobotState))
    state = json.loads(msgspec.json.encode(RobotState(robot="r1")))
    assert state["pose"] is None
    validator.validate(state)
    assert not validator.is_valid(state | {"robot": None})
    assert not validator.is_valid(state | {"radius_m": -1.0})
    assert jsonschema.Draft202012Validator(schema_of(TeamState)).is_valid({"robots": []})


def unbounded(schema, where):
    """Places in a schema where a number, text, list or object may be of any size."""
    if isinstance(schema, list):
        return [found for one in schema for found in unbounded(one, where)]
    if not isinstance(schema, dict):
        return []
    bounds = {
        "array": ({"maxItems"}, {"prefixItems"}),
        "string": ({"maxLength"}, {"enum"}, {"const"}, {"contentEncoding"}),
        "object": ({"properties"}, {"maxProperties"}),
        "integer": ({"minimum", "maximum"}, {"minimum", "exclusiveMaximum"}, {"enum"}),
        "number": ({"minimum", "maximum"}, {"exclusiveMinimum", "maximum"}),
    }
    kinds = bounds.get(schema.get("type"), ())
    found = [where] if kinds and not any(kind <= set(schema) for kind in kinds) else []
    for key, one in schema.items():
        if key == "properties":
            found += [place for name, field in one.items() for place in unbounded(field, f"{where}.{name}")]
        else:
            found += unbounded(one, f"{where}.{key}")
    return found


def test_every_number_text_and_list_of_the_wire_is_bounded():
    found = [place for name, schema in definitions().items() for place in unbounded(schema, name)]
    assert found == []
