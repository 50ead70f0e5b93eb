"""JSON Schemas of structs, with the unit and the meaning of each field.

Types and ranges come from the types themselves, units from the names of fields. Meanings come from the docstrings below
fields in the source, the only place where they are written.
"""

import ast
import inspect
import textwrap
from collections.abc import Iterable
from functools import cache
from types import NoneType
from typing import Any

import msgspec

from robrain.protocol.errors import ErrorReply
from robrain.protocol.table.topics import all_rows
from robrain.protocol.topic import Query, Topic, WireKey

DIALECT = "https://json-schema.org/draft/2020-12/schema"
REFERENCE = "#/$defs/{name}"
UNITS = {
    "_m_s": "m/s",
    "_rad_s": "rad/s",
    "_m2": "m²",
    "_rad2": "rad²",
    "_m": "m",
    "_mm": "mm",
    "_rad": "rad",
    "_s": "s",
    "_ms": "ms",
    "_ns": "ns",
    "_j": "J",
    "_w": "W",
    "_v": "V",
    "_a": "A",
    "_c": "°C",
    "_hz": "Hz",
    "_dbm": "dBm",
}
"""Units by the ends of names, the longer ones first where one ends like another."""
PARTS, PART_LISTS = ("type", "key_type", "value_type", "item_type"), ("types", "item_types")
"""Where the types in `msgspec.inspect` keep the types that they are made of."""
NAMED = ("properties", "$defs")
"""Keywords whose keys are names of fields or types."""
EXPLAINS = ("title", "description", "default", "$comment")
COMMON = {
    "code": "Which error.",
    "detail": "The reason alone, or more of it; empty if there is no more to say.",
    "message": "A sentence for people.",
    "accepted": "Whether it was accepted.",
    "because": "The reason behind it.",
    "behavior": "Name of the behavior that is active; empty if none is.",
    "by": "Name of the requester; empty if unknown.",
    "doc": "Its documentation.",
    "count": "How many.",
    "duration_s": "How long.",
    "energy_j": "Energy that it takes.",
    "error": "The text of the error.",
    "epoch": "Fencing token: of two offers of a task the one with the greater epoch counts.",
    "event": "Name of the event.",
    "frontiers": "Borders of the known floor that are left.",
    "halted": "Whether there is an emergency halt.",
    "functions": "External functions.",
    "holder": "Who has exclusive use of it; empty if nobody has.",
    "id": "Id of the task.",
    "kind": "Kind of the task.",
    "mote": "Name of the mote.",
    "name": "Its name.",
    "objective": "What plans are good for.",
    "period_s": "Time from one to the next.",
    "place": "Where, arena frame unless the message says otherwise.",
    "plugin": "Name of the plugin.",
    "plugins": "Names of plugins.",
    "pose": "Place and heading, arena frame unless the message says otherwise.",
    "quantity": "Name of what is measured.",
    "reason": "Why, in the words of who asked for it.",
    "robot": "Name of the robot; empty if there is none.",
    "robots": "Robots, one entry each; of a task, the number of robots that it needs.",
    "seq": "Number of the message, counted by its publisher.",
    "silent_s": "Time since its last message.",
    "sim_time_s": "Simulated time since the start.",
    "stamp_ns": "When it was sent: nanoseconds since 1970 in live, since the start of the run in lockstep.",
    "state": "The state it is in.",
    "task": "The task, or its id.",
    "time_s": "Time that it takes.",
    "voltage_v": "Voltage of the battery.",
    "why": "Why, for people; empty if there is nothing to say.",
    "x_m": "Along the x axis of its frame: forward in a robot's frame.",
    "y_m": "Along the y axis of its frame: left in a robot's frame.",
    "yaw_rad": "Heading, counter-clockwise from the x axis.",
}
"""Meanings of fields that several messages share."""
Schema = dict[str, Any]


def unit_of(name: str) -> str:
    """The unit that a field's name ends in; empty if there is none.

    >>> unit_of("speed_m_s"), unit_of("deadline_s"), unit_of("soc")
    ('m/s', 's', '')
    """
    return next((unit for end, unit in UNITS.items() if name.endswith(end)), "")


def schema_of(kind: Any) -> Schema:
    """The whole schema of one type, which refers to nothing outside of it."""
    (schema,), used = definitions_of([kind])
    return {"$schema": DIALECT, **schema, "$defs": used}


def parameters_schema(type_: type[msgspec.Struct]) -> Schema:
    """The JSON Schema of a type of parameters: of an object, with the meaning of each field.

    Rules that no field can state are in the type's `SCHEMA_RULES`, as keywords of the object.
    """
    _, used = definitions_of([type_])
    body = used.pop(type_.__name__)
    body |= getattr(type_, "SCHEMA_RULES", {})
    return {**body, "$defs": used} if used else body


def bare(schema: Any) -> Any:
    """The validating part of a schema, without explanations."""
    if isinstance(schema, list):
        return [bare(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    named = {name: {key: bare(one) for key, one in schema[name].items()} for name in NAMED if name in schema}
    return {key: bare(one) for key, one in schema.items() if key not in (*EXPLAINS, *NAMED)} | named


def definitions_of(kinds: list[Any]) -> tuple[list[Schema], dict[str, Schema]]:
    """The schema of each type, and by name those of the structs that they refer to."""
    found, components = msgspec.json.schema_components(kinds, ref_template=REFERENCE)
    structs = {struct.__name__: struct for struct in structs_in(kinds)}
    for name, schema in components.items():
        if name in structs:
            _annotate(schema, structs[name])
        _drop_discriminators(schema)
    _drop_discriminators(list(found))
    return list(found), components


def _drop_discriminators(schema: Any) -> None:
    """Remove OpenAPI's keyword, which JSON Schema does not have: the tag of an alternative is an enum in its schema."""
    if isinstance(schema, dict):
        if "anyOf" in schema:
            schema.pop("discriminator", None)
        schema = list(schema.values())
    if isinstance(schema, list):
        for one in schema:
            _drop_discriminators(one)


def _annotate(schema: Schema, struct: type) -> None:
    meanings = field_meanings(struct)
    for name, field in schema.get("properties", {}).items():
        if unit_of(name):
            field["$comment"] = f"unit: {unit_of(name)}"
        if name in meanings:
            field["description"] = meanings[name]


@cache
def field_meanings(struct: type[msgspec.Struct]) -> dict[str, str]:
    """The docstrings below the fields of a struct and its bases, by the field's name on the wire."""
    meanings = {name: COMMON[name] for name in struct.__struct_fields__ if name in COMMON}
    for one in reversed(struct.__mro__):
        if issubclass(one, msgspec.Struct) and one is not msgspec.Struct:
            meanings |= _meanings_in(one)
    return {name: meanings[name] for name in struct.__struct_fields__ if name in meanings}


def _meanings_in(struct: type) -> dict[str, str]:
    try:
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(struct))).body
    except (OSError, SyntaxError):  # installed without its sources
        return {}
    assert isinstance(body, ast.ClassDef)
    found = {}
    for field, after in zip(body.body, body.body[1:], strict=False):
        if not (isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)):
            continue
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str):
            found[field.target.id] = " ".join(after.value.value.split())
    return found


def structs_in(kinds: Iterable[Any]) -> list[type]:
    """All structs that some types are made of."""
    found: dict[type, None] = {}
    waiting = list(msgspec.inspect.multi_type_info(list(kinds)))
    while waiting:
        one = waiting.pop()
        if isinstance(one, msgspec.inspect.StructType):
            if one.cls not in found:
                found[one.cls] = None
                waiting += [field.type for field in one.fields]
        else:
            waiting += [part for name in PARTS if (part := getattr(one, name, None)) is not None]
            waiting += [part for name in PART_LISTS for part in getattr(one, name, ())]
    return list(found)


def types_of(row: WireKey) -> list[Any]:
    """The types under a key: message, or request and reply; bytes and nothing are skipped."""
    kinds: list[Any] = []
    if isinstance(row, Topic):
        kinds = [row.message]
    elif isinstance(row, Query):
        kinds = [row.request, row.reply]
    return [kind for kind in kinds if kind not in (None, bytes, NoneType)]


@cache
def definitions() -> dict[str, Schema]:
    """The schemas of all structs of the wire by name, that of error replies among them."""
    return definitions_of([ErrorReply, *(kind for row in all_rows() for kind in types_of(row))])[1]


def reference_to(kind: Any) -> Schema:
    """The schema of one type, which refers to `definitions()`."""
    return definitions_of([kind])[0][0]
