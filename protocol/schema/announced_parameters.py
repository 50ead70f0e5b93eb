"""Checks task parameters against the JSON Schemas that robots announce for a kind.

A schema from a robot is not trusted. It may use the keywords in `KEYWORDS` and refer to its own `$defs`, without
cycles. Unfolded, it may have at most `PARTS_MAX` parts, so that a check takes bounded time. Regular expressions are
ignored, because one can take unbounded time; the robot checks its parameters again when the task is offered.
"""

from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

import msgspec
from jsonschema import Draft202012Validator
from jsonschema.exceptions import SchemaError, ValidationError

from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.task import BadParameters
from robrain.protocol.schema.struct_schema import Schema

SCHEMA_BYTES_MAX = 32_768
PARTS_MAX = 2_000
DEPTH_MAX = 32
WORDS_MAX = 200
"""Longest error text about one parameter, which quotes the input."""
EXPLAINS = frozenset({"title", "description", "default", "examples", "$comment", "$schema", "format", "pattern"})
"""Keywords that are ignored here."""
VALUES = frozenset(
    {
        "type", "enum", "const", "required", "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum",
        "multipleOf", "minLength", "maxLength", "minItems", "maxItems", "minProperties", "maxProperties",
    }
)  # fmt: skip
ONE, LISTS, NAMED = ("items", "additionalProperties"), ("anyOf", "oneOf", "allOf", "prefixItems"), ("properties",)
"""Keywords with one schema, with a list of schemas, and with named schemas."""
KEYWORDS = VALUES | EXPLAINS | {*ONE, *LISTS, *NAMED, "$ref", "$defs"}
REFERENCE = "#/$defs/"


def schema_refusal(schema: Mapping[str, Any]) -> str:
    """Why an announced schema cannot be used; empty if it can."""
    written = msgspec.json.encode(schema, order="deterministic")
    return _schema_refusal(written) if len(written) <= SCHEMA_BYTES_MAX else f"is longer than {SCHEMA_BYTES_MAX} bytes"


@lru_cache(maxsize=256)
def _schema_refusal(written: bytes) -> str:
    schema = msgspec.json.decode(written)
    try:
        _count_parts(schema, schema, (), PARTS_MAX)
        Draft202012Validator.check_schema(schema)
    except _Unusable as error:
        return str(error)
    except SchemaError as error:
        return cut(f"is no JSON Schema: {error.message}", WORDS_MAX)
    return ""


class _Unusable(ValueError):
    """A schema that cannot be used; the text gives the reason."""


def _count_parts(part: Any, whole: Schema, path: tuple[str, ...], left: int) -> int:
    """Number of parts left for the rest of a schema after this part and everything that it refers to."""
    if isinstance(part, bool):
        return left - 1
    if not isinstance(part, dict):
        raise _Unusable("has a part that is neither an object nor true or false")
    if left <= 0:
        raise _Unusable(f"has more than {PARTS_MAX} parts when unfolded")
    if len(path) > DEPTH_MAX:
        raise _Unusable(f"is nested deeper than {DEPTH_MAX} levels")
    left -= 1
    if unknown := sorted(part.keys() - KEYWORDS):
        raise _Unusable(cut(f"uses {unknown[0]}, which is not supported", WORDS_MAX))
    if "$defs" in part and part is not whole:
        raise _Unusable("has $defs that are not at its top")
    inner: list[tuple[str, Any]] = [("", part[name]) for name in ONE if name in part]
    for name in (*LISTS, *NAMED):
        held = part.get(name, {} if name in NAMED else [])
        if not isinstance(held, dict if name in NAMED else list):
            raise _Unusable(f"has no {'object' if name in NAMED else 'array'} as {name}")
        inner += [("", one) for one in (held.values() if isinstance(held, dict) else held)]
    reference = part.get("$ref")
    if reference is not None:
        inner.append((str(reference), _referred(str(reference), whole, path)))
    for name, one in inner:
        left = _count_parts(one, whole, (*path, name), left)
    return left


def _referred(reference: str, whole: Schema, path: tuple[str, ...]) -> Any:
    name = reference.removeprefix(REFERENCE)
    definitions = whole.get("$defs", {})
    if name == reference or not isinstance(definitions, dict) or name not in definitions:
        raise _Unusable(cut(f"refers to {reference}, which is not in its $defs", WORDS_MAX))
    if reference in path:
        raise _Unusable(cut(f"refers to {reference} in a circle", WORDS_MAX))
    return definitions[name]


def check_announced(kind: str, parameters: Mapping[str, Any], schemas: Iterable[Mapping[str, Any]]) -> None:
    """Raise BadParameters if the parameters fit none of the schemas that robots have announced for the kind.

    Args:
        kind: of the task.
        parameters: the submitted ones.
        schemas: the distinct announced ones; an unusable schema accepts everything.

    """
    errors = []
    for schema in schemas:
        error = None if schema_refusal(schema) else _mistake(parameters, schema)
        if error is None:
            return
        errors.append((error, schema))
    if errors:
        raise _bad(kind, *errors[0])


def _mistake(parameters: Mapping[str, Any], schema: Mapping[str, Any]) -> ValidationError | None:
    errors = _validator(msgspec.json.encode(schema, order="deterministic")).iter_errors(parameters)
    return min(errors, key=lambda error: (error.validator == "anyOf", error.json_path, error.message), default=None)


@lru_cache(maxsize=256)
def _validator(written: bytes) -> Draft202012Validator:
    return Draft202012Validator(_without_patterns(msgspec.json.decode(written)))


def _without_patterns(part: Any) -> Any:
    """The schema without the keyword `pattern`; a parameter with that name stays."""
    if not isinstance(part, dict):
        return part
    kept: Schema = {}
    for name, value in part.items():
        if name in (*NAMED, "$defs"):
            kept[name] = {key: _without_patterns(one) for key, one in value.items()}
        elif name in LISTS:
            kept[name] = [_without_patterns(one) for one in value]
        elif name != "pattern":
            kept[name] = _without_patterns(value) if name in ONE else value
    return kept


def _bad(kind: str, error: ValidationError, schema: Mapping[str, Any]) -> BadParameters:
    path = ".".join(str(part) for part in error.absolute_path)
    given: Any = error.instance
    rule: Any = error.validator_value
    if error.validator == "required":
        missing = next((name for name in rule if name not in given), "")
        return BadParameters(kind, f"{path}.{missing}".lstrip("."), "")
    if error.validator == "additionalProperties" and not path:
        known = schema.get("properties", {})
        unknown = next((name for name in given if name not in known), "")
        names = ", ".join(sorted(known)) or "none"
        return BadParameters(kind, cut(unknown, WORDS_MAX), f"a task to {kind} has no such parameter, but {names}")
    if error.validator == "anyOf" and not path and "$comment" in schema:
        return BadParameters(kind, "", cut(str(schema["$comment"]), WORDS_MAX))
    return BadParameters(kind, path, cut(error.message, WORDS_MAX))
