"""Tables of the keys that a file may have, from the structs that it is decoded into."""

import ast
import enum
import inspect
import re
import sys
from itertools import pairwise
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from tests.reference_pages.markdown import table

Struct = type[msgspec.Struct]
PLAIN = {float: "number", int: "integer", str: "text", bool: "true or false"}
COUNTS = {2: "two", 3: "three", 4: "four"}


def struct_table(struct: Struct, links: dict[str, str] | None = None) -> str:
    """The fields of a struct: key, type, default and meaning; then the values of its enums, each with its meaning.

    Args:
        struct: whose fields are the keys.
        links: by key, a link to the table that it holds.

    """
    hints = get_type_hints(struct, include_extras=True)
    meanings = attribute_docs(struct)
    rows = [
        (
            f"`{field.encode_name}`",
            type_words(hints[field.name], (links or {}).get(field.encode_name, "")),
            _default(field),
            meanings.get(field.name, ""),
        )
        for field in msgspec.structs.fields(struct)
    ]
    return "\n".join([table(("key", "type", "default", "meaning"), rows), *_enum_lists(hints)])


def attribute_docs(owner: type) -> dict[str, str]:
    """The docstrings below attributes of a class and its bases, by attribute."""
    found: dict[str, str] = {}
    for base in reversed(owner.__mro__):
        node = _class_node(base) if base.__module__.startswith("robrain.") else None
        body = node.body if node is not None else []
        for before, after in pairwise(body):
            if (
                isinstance(after, ast.Expr)
                and isinstance(after.value, ast.Constant)
                and isinstance(after.value.value, str)
            ):
                targets = [before.target] if isinstance(before, ast.AnnAssign) else getattr(before, "targets", [])
                found |= {
                    target.id: inspect.cleandoc(after.value.value) for target in targets if isinstance(target, ast.Name)
                }
    return found


def summary(owner: type) -> str:
    """A class's docstring without what it raises."""
    text = re.sub(r"\s*Raises (?:ValueError|MapError)\b.*", "", inspect.getdoc(owner) or "", flags=re.DOTALL)
    about = re.sub(r"^`\[+[\w.]+\]+`[.:;]? *", "", text).strip()  # the heading names the table
    return about[:1].upper() + about[1:]


def type_words(hint: Any, link: str = "") -> str:
    """A type in the words of TOML, with its range; `link` stands for a struct in it."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return type_words(inner[0], link) + _range(inner[1:])
    if hint in PLAIN:
        return PLAIN[hint]
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(type_words(one, link) for one in inner if one is not NoneType))
    if origin is Literal:
        return _choices(inner)
    if origin is tuple and inner[-1] is not Ellipsis:
        kinds = {type_words(one, link) for one in inner}
        return f"{COUNTS[len(inner)]} {_plural(kinds.pop())}" if len(kinds) == 1 else "list"
    if origin in (list, tuple):
        return f"list of {_plural(type_words(inner[0], link))}"
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return _choices([one.value for one in hint])
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return link or "table of " + ", ".join(f"`{field}`" for field in hint.__struct_fields__)
    return "table" if origin is dict else "any"


def _plural(words: str) -> str:
    if words.startswith(("`", "table", "list", "[", *COUNTS.values())):
        return words
    noun, space, limits = words.partition(" ")
    return f"{noun}s{space}{limits}"


def _choices(values: Any) -> str:
    return " or ".join(f'`"{value}"`' if isinstance(value, str) else f"`{value}`" for value in values)


def _range(notes: tuple[Any, ...]) -> str:
    words = [
        f"{sign} {getattr(note, name):g}"
        for note in notes
        for name, sign in (("gt", ">"), ("ge", "≥"), ("lt", "<"), ("le", "≤"))
        if isinstance(note, msgspec.Meta) and getattr(note, name) is not None
    ]
    return f" {', '.join(words)}" if words else ""


def _default(field: msgspec.structs.FieldInfo) -> str:
    if field.required:
        return "required"
    value = field.default if field.default is not msgspec.NODEFAULT else field.default_factory()
    is_table = isinstance(value, msgspec.Struct) and not any(one.required for one in msgspec.structs.fields(value))
    if value is None or is_table or value in ((), [], {}):
        return "–"
    return f"`{toml_value(value)}`"


def toml_value(value: Any) -> str:
    """A value as TOML writes it on one line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, enum.Enum):
        return toml_value(value.value)
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, float):
        return f"{value:.6g}".replace("e+0", "e")
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(toml_value(one) for one in value)}]"
    if isinstance(value, msgspec.Struct):
        return toml_value(msgspec.structs.asdict(value))
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {toml_value(one)}' for key, one in value.items())} }}"
    return str(value)


def _enum_lists(hints: dict[str, Any]) -> list[str]:
    lists = []
    for key, hint in hints.items():
        if isinstance(hint, type) and issubclass(hint, enum.Enum):
            meanings = attribute_docs(hint)
            lines = [
                f"- `{one.value}`: {' '.join(meanings[one.name].split())}\n" for one in hint if one.name in meanings
            ]
            lists.append(f"Values of `{key}`:\n\n{''.join(lines)}")
    return lists


def _class_node(owner: type) -> ast.ClassDef | None:
    body = ast.parse(inspect.getsource(sys.modules[owner.__module__])).body
    found = None
    for name in owner.__qualname__.split("."):
        found = next((node for node in body if isinstance(node, ast.ClassDef) and node.name == name), None)
        body = found.body if found is not None else []
    return found
