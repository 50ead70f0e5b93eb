"""JSON Schemas in the plain form that Foxglove and Lichtblick accept: they refuse a channel that has any other.

There each schema is an object whose properties have one `type` each; references, alternatives and lists in lists make
the whole channel unreadable.
"""

from collections.abc import Mapping, Sequence
from typing import Any

Schema = dict[str, Any]

SCALARS = frozenset({"boolean", "integer", "number", "string"})
KEPT = ("title", "description", "enum", "contentEncoding")
DEPTH_MAX = 16
"""A type that holds itself would never end."""


def plain_schema(schema: Schema) -> Schema:
    """The same schema without references and alternatives.

    A nullable value is described by its other type. Of several objects the properties of all are included. A value
    without a plain form, such as free JSON, becomes an object with no known properties: viewers show it unchanged.

    Args:
        schema: a JSON Schema whose root is an object, or refers to one in its `$defs`.
    """
    return _plain(schema, schema.get("$defs", {}), DEPTH_MAX)


def _plain(schema: Any, definitions: Mapping[str, Schema], depth: int) -> Schema:
    if not isinstance(schema, Mapping) or not depth:
        return _unknown()
    if "$ref" in schema:
        return _plain(definitions.get(schema["$ref"].rpartition("/")[2]), definitions, depth - 1)
    if "anyOf" in schema:
        return _joined(
            [_plain(option, definitions, depth - 1) for option in schema["anyOf"] if option.get("type") != "null"]
        )
    kept = {name: schema[name] for name in KEPT if name in schema}
    kind = schema.get("type") or _type_of(schema)
    if kind in SCALARS:
        return {"type": kind, **kept}
    if kind == "array":
        return {"type": kind, "items": _items(schema, definitions, depth), **kept}
    if kind == "object":
        reported = schema.get("properties", {})
        properties = {name: _plain(value, definitions, depth - 1) for name, value in reported.items()}
        return {"type": kind, "properties": properties, "required": schema.get("required", []), **kept}
    return _unknown()


def _unknown() -> Schema:
    return {"type": "object", "properties": {}, "required": []}


def _type_of(schema: Mapping[str, Any]) -> str:
    """Of an enumeration or a constant, the type of its values; empty if they are of several."""
    values = schema.get("enum", [schema["const"]] if "const" in schema else [])
    kinds = {bool: "boolean", int: "integer", float: "number", str: "string"}
    found = {kinds.get(type(value), "") for value in values}
    return found.pop() if len(found) == 1 else ""


def _items(schema: Mapping[str, Any], definitions: Mapping[str, Schema], depth: int) -> Schema:
    """The schema of the items of a list; of a tuple, the common schema of its places."""
    reported = schema.get("prefixItems") or [schema.get("items")]
    items = _joined([_plain(item, definitions, depth - 1) for item in reported])
    return _unknown() if items["type"] == "array" else items


def _joined(options: Sequence[Schema]) -> Schema:
    """One schema for several: an integer is a number, too, and of objects the properties of all."""
    if not options:
        return _unknown()
    if all(option == options[0] for option in options):
        return options[0]
    kinds = {option["type"] for option in options}
    if kinds == {"integer", "number"}:
        return {"type": "number"}
    if kinds == {"array"}:
        return {"type": "array", "items": _joined([option["items"] for option in options])}
    if kinds == {"object"}:
        names = dict.fromkeys(name for option in options for name in option["properties"])
        properties = {
            name: _joined([option["properties"][name] for option in options if name in option["properties"]])
            for name in names
        }
        required = [name for name in names if all(name in option["required"] for option in options)]
        return {"type": "object", "properties": properties, "required": required}
    return {"type": kinds.pop()} if len(kinds) == 1 else _unknown()
