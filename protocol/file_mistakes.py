"""Mistakes in a file, each with its key and what is expected.

Among them are names that its types do not have: unknown keys, and values that are none of an enumeration.
"""

import difflib
from collections.abc import Iterable, Iterator, Sequence
from enum import Enum
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from robrain.protocol.errors import BadToml
from robrain.protocol.model.checked import convert
from robrain.protocol.toml_text import SMALL, TomlLimits, read_toml

TablesT = TypeVar("TablesT", bound=msgspec.Struct)
Struct = type[msgspec.Struct]


def read_tables(path: Path, kind: type[TablesT], limits: TomlLimits = SMALL) -> TablesT:
    """Read a TOML file as a struct of its tables (BadToml: it cannot be read, or a key is wrong)."""
    return tables_of(read_toml(path, limits), kind)


def tables_of(document: dict[str, Any], kind: type[TablesT]) -> TablesT:
    """A document as a struct of its tables (BadToml, which names the wrong key and the expected value)."""
    try:
        return convert(document, kind)
    except msgspec.ValidationError as error:
        where, what = key_and_problem(error, document, kind)
        raise BadToml(what if where == FILE else f"{where}: {what}") from error


FILE = "file"
"""Key of a mistake that is none of a key."""


def key_and_problem(
    error: msgspec.ValidationError, document: dict[str, Any], struct: Struct, path: str = ""
) -> tuple[str, str]:
    """A validation error as its key and the expected value; an unknown name with the nearest one.

    >>> key_and_problem(msgspec.ValidationError("Expected `int`, got `str` - at `$.tag.shared`"), {}, msgspec.Struct)
    ('tag.shared', 'Expected `int`, got `str`')
    """
    if mistake := unknown_name(document, struct, path):
        where, _, what = mistake.rpartition(": unknown ")
        return (where, f"unknown {what}") if where else (FILE, mistake)
    what, _, where = str(error).replace(" | null`", "`").partition(" - at `$")  # TOML has no null: it leaves keys out
    return where.rstrip("`").lstrip(".") or FILE, what


def unknown_name(document: dict[str, Any], struct: Struct, path: str = "") -> str:
    """The first unknown key or value of a document, with its table, the nearest known name and all known ones.

    Empty if there is none. Nothing else is checked: types, ranges and missing keys are the decoder's affair. `path` is
    where the document stands in its file, if it is a part of one.

    >>> class Radio(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    ...     range_m: float = 10.0
    >>> class Tables(msgspec.Struct, forbid_unknown_fields=True):
    ...     radio: Radio = Radio()
    >>> unknown_name({"radoi": {}}, Tables)
    'unknown table `radoi` (did you mean `radio`?); there is radio'
    >>> unknown_name({"range_m": 5.0}, Tables)
    'unknown key `range_m`: it belongs into [radio]'
    """
    return next(_unknown(document, struct, path, struct), "")


def nearest(word: str, known: Iterable[str]) -> str:
    """` (did you mean X?)` for the known name that is spelled most alike; empty if none is like it."""
    found = difflib.get_close_matches(word.lower(), list(known), n=1)
    return f" (did you mean `{found[0]}`?)" if found else ""


def _unknown(value: Any, hint: Any, path: str, root: Struct) -> Iterator[str]:
    if isinstance(value, dict) and _is_struct(hint):
        yield from _unknown_in_table(value, hint, path, root)
    elif isinstance(value, dict) and get_origin(hint) is dict:
        for key, item in value.items():
            yield from _unknown(item, get_args(hint)[1], f"{path}.{key}", root)
    elif isinstance(value, list) and get_origin(hint) in (list, tuple):
        for index, item in enumerate(value):
            yield from _unknown(item, get_args(hint)[0], f"{path}[{index}]", root)
    elif get_origin(hint) in (Union, UnionType):
        yield from _unknown_in_union(value, get_args(hint), path, root)
    elif isinstance(value, str) and (names := _values(hint)) and value not in names:
        yield f"{path}: unknown value '{value}'{nearest(value, names)}; it may be {listed(names, 'or')}"


def _unknown_in_table(table: dict[str, Any], struct: Struct, path: str, root: Struct) -> Iterator[str]:
    hints = get_type_hints(struct)
    fields = {field.encode_name: hints[field.name] for field in msgspec.structs.fields(struct)}
    is_strict = struct.__struct_config__.forbid_unknown_fields
    for key, value in table.items():
        if key in fields:
            yield from _unknown(value, fields[key], f"{path}.{key}" if path else key, root)
        elif is_strict and key != struct.__struct_config__.tag_field:
            what = f"{path}: unknown key" if path else f"unknown {'table' if isinstance(value, dict) else 'key'}"
            if homes := _tables_with(key, root):
                yield f"{what} `{key}`: it belongs into {listed(homes, 'or')}"
                continue
            tag = struct.__struct_config__.tag_field
            known = [*fields, *([tag] if tag else [])]
            yield f"{what} `{key}`{nearest(key, known)}; there {'are' if len(known) > 1 else 'is'} {listed(known)}"


def _tables_with(key: str, root: Struct) -> list[str]:
    """The tables of a file that have a key."""
    hints = get_type_hints(root)
    tables = {field.encode_name: hints[field.name] for field in msgspec.structs.fields(root)}
    known = {name: msgspec.structs.fields(hint) for name, hint in tables.items() if _is_struct(hint)}
    return [f"[{name}]" for name, fields in known.items() if key in [field.encode_name for field in fields]]


def _unknown_in_union(value: Any, members: Sequence[Any], path: str, root: Struct) -> Iterator[str]:
    """A value of a union is unknown if no member has it; the report is that of the first."""
    tags = {member.__struct_config__.tag: member for member in members if _is_struct(member)}
    key = next((member.__struct_config__.tag_field for member in members if _is_struct(member)), None)
    if isinstance(value, dict) and key is not None and isinstance(tag := value.get(key), str):
        if tag in tags:
            yield from _unknown(value, tags[tag], path, root)
        else:
            known = [str(one) for one in tags]
            yield f"{path}.{key}: unknown value '{tag}'{nearest(tag, known)}; it may be {listed(known, 'or')}"
        return
    mistakes = [next(_unknown(value, member, path, root), "") for member in members if _may_be(value, member)]
    if mistakes and all(mistakes):
        yield mistakes[0]


def _may_be(value: Any, hint: Any) -> bool:
    if isinstance(value, dict):
        return _is_struct(hint) or get_origin(hint) is dict
    if isinstance(value, list):
        return get_origin(hint) in (list, tuple)
    return hint is str or bool(_values(hint))


def _is_struct(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, msgspec.Struct)


def _values(hint: Any) -> list[str]:
    """The texts that a type with a fixed set of them has; none for any other type."""
    if get_origin(hint) is Literal:
        return [value for value in get_args(hint) if isinstance(value, str)]
    if isinstance(hint, type) and issubclass(hint, Enum):
        return [member.value for member in hint if isinstance(member.value, str)]
    return []


def listed(names: Iterable[str], last: str = "and") -> str:
    """`a, b and c`, in order of the alphabet; `none` if there are none."""
    *others, end = sorted(names) or ["none"]
    return f"{', '.join(others)} {last} {end}" if others else end
