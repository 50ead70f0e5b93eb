"""Forms from JSON Schema: the fields of a function's arguments, and the arguments from the typed values.

The schemas are those that msgspec makes of type hints: one object with a property for each parameter.
"""

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any

import msgspec
import viser

from robrain.dashboard.panels.gui_values import set_value

Schema = Mapping[str, Any]
UNITS = {"m": "m", "s": "s", "rad": "rad", "j": "J", "w": "W", "v": "V", "dbm": "dBm", "ns": "ns"}
DEEPEST = 8
"""Maximum number of references that are followed one after another."""


class FieldKind(StrEnum):
    """The type of a field's value."""

    NUMBER = "number"
    INTEGER = "integer"
    BOOLEAN = "boolean"
    TEXT = "string"
    CHOICE = "choice"
    JSON = "json"
    """Any other value, as JSON."""


JSON_TYPES = (FieldKind.NUMBER, FieldKind.INTEGER, FieldKind.BOOLEAN, FieldKind.TEXT)
"""Kinds that are named as in JSON Schema."""


class FormField(msgspec.Struct, frozen=True, kw_only=True):
    """One field of a form."""

    path: tuple[str, ...]
    """The parameter's name, and for an object that of the property."""
    kind: FieldKind
    required: bool
    choices: tuple[str, ...] = ()
    default: str = ""
    """Initial value; an empty field that is not required is left out."""
    hint: str = ""

    @property
    def label(self) -> str:
        """Its name in errors, and the key of its typed value."""
        return ".".join(self.path)

    @property
    def title(self) -> str:
        """The text beside it.

        >>> FormField(path=("place", "x_m"), kind=FieldKind.NUMBER, required=True).title
        'x (m)'
        """
        words = [part for part in self.path if part != "place"] or list(self.path)
        last, _, unit = words[-1].rpartition("_")
        if last and unit in UNITS:
            words[-1] = f"{last} ({UNITS[unit]})"
        return " ".join(words).replace("_", " ")


def fields_of(schema: Schema) -> list[FormField]:
    """The fields of a form for an object of this schema; objects in it are expanded, one level deep."""
    definitions = _mapping(schema.get("$defs"))
    schema = _resolved(schema, definitions)
    fields: list[FormField] = []
    required = _names(schema.get("required"))
    for name, given in _mapping(schema.get("properties")).items():
        inner = _resolved(given, definitions)
        is_required = name in required
        properties = inner.get("properties")
        if isinstance(properties, Mapping) and properties and is_required:
            inner_required = _names(inner.get("required"))
            fields += [
                _field((name, part), _resolved(shape, definitions), part in inner_required)
                for part, shape in properties.items()
            ]
        else:
            fields.append(_field((name,), inner, is_required))
    return fields


def arguments_of(fields: Sequence[FormField], typed: Mapping[str, str | bool]) -> dict[str, Any]:
    """The arguments by name, from the typed values by label.

    Raises:
        ValueError: naming the field that is empty or cannot be read.

    """
    arguments: dict[str, Any] = {}
    for field in fields:
        given = typed.get(field.label, "")
        if isinstance(given, str) and field.kind not in (FieldKind.TEXT, FieldKind.CHOICE):
            given = given.strip()
        if given == "":
            if not field.required:
                continue
            if field.kind is not FieldKind.TEXT:
                raise ValueError(f"{field.label}: expected a {_expected(field)}, got nothing")
        value = _value(field, given)
        if len(field.path) == 1:
            arguments[field.path[0]] = value
        else:
            arguments.setdefault(field.path[0], {})[field.path[1]] = value
    return arguments


def _field(path: tuple[str, ...], shape: Schema, required: bool) -> FormField:
    kind, choices = _kind_of(shape)
    default = shape.get("default")
    shown = "" if default is None else default if isinstance(default, str) else msgspec.json.encode(default).decode()
    hint = str(shape.get("description", ""))
    if not hint and kind is FieldKind.JSON:
        hint = "a list in JSON, such as [1, 2]" if shape.get("type") == "array" else "in JSON"
    return FormField(path=path, kind=kind, required=required, choices=choices, default=shown, hint=hint)


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _names(value: Any) -> set[str]:
    return {name for name in value if isinstance(name, str)} if isinstance(value, list | tuple) else set()


def _kind_of(shape: Schema) -> tuple[FieldKind, tuple[str, ...]]:
    choices = shape.get("enum")
    if isinstance(choices, Sequence) and choices and all(isinstance(choice, str) for choice in choices):
        return FieldKind.CHOICE, tuple(choices)
    return next((kind for kind in JSON_TYPES if kind == shape.get("type")), FieldKind.JSON), ()


def _resolved(shape: Any, definitions: Mapping[str, Any]) -> Schema:
    """The schema with its references followed; of a choice between null and one other schema, the other."""
    found: dict[str, Any] = dict(shape) if isinstance(shape, Mapping) else {}
    for _ in range(DEEPEST):
        reference = found.get("$ref")
        options = found.get("anyOf")
        if isinstance(reference, str):
            rest = {key: value for key, value in found.items() if key != "$ref"}
            target = definitions.get(reference.rpartition("/")[2])
            found = {**(target if isinstance(target, Mapping) else {}), **rest}
        elif isinstance(options, Sequence) and len(others := [one for one in options if one != {"type": "null"}]) == 1:
            rest = {key: value for key, value in found.items() if key != "anyOf"}
            found = {**(others[0] if isinstance(others[0], Mapping) else {}), **rest}
        else:
            break
    return found


def _value(field: FormField, given: str | bool) -> Any:
    if field.kind is FieldKind.BOOLEAN:
        return given is True or given == "true"
    typed = str(given)
    try:
        if field.kind is FieldKind.NUMBER:
            number = float(typed)
            if math.isfinite(number):
                return number
        elif field.kind is FieldKind.INTEGER:
            return int(typed)
        elif field.kind is FieldKind.JSON:
            return msgspec.json.decode(typed)
        elif field.kind is FieldKind.TEXT or typed in field.choices:
            return typed
    except (ValueError, RecursionError):  # reported below; msgspec's errors are ValueErrors
        pass
    raise ValueError(f"{field.label}: expected a {_expected(field)}, got {typed[:40]!r}")


def _expected(field: FormField) -> str:
    if field.kind is FieldKind.CHOICE:
        return f"choice of {', '.join(field.choices)}"
    return {"integer": "whole number", "json": "value in JSON"}.get(field.kind.value, field.kind.value)


NOT_GIVEN = "(not given)"


class FormPanel:
    """The inputs of one form, in a folder inside `slot`."""

    def __init__(self, gui: viser.GuiApi, slot: viser.GuiFolderHandle) -> None:
        self._gui = gui
        self._slot = slot
        self._folder: viser.GuiFolderHandle | None = None
        self._fields: list[FormField] = []
        self._inputs: dict[str, viser.GuiInputHandle[Any]] = {}

    def show(self, fields: Sequence[FormField]) -> None:
        """Show inputs for these fields and no others."""
        if list(fields) == self._fields:
            return
        if self._folder is not None:
            self._folder.remove()
            self._folder = None
        self._fields = list(fields)
        self._inputs = {}
        if self._fields:
            with self._slot:
                self._folder = self._gui.add_form(None)
            with self._folder:
                self._inputs = {field.label: self._add(field) for field in self._fields}

    def arguments(self) -> dict[str, Any]:
        """The typed values, as arguments by name.

        Raises:
            ValueError: naming the field that is empty or cannot be read.

        """
        typed = {label: "" if handle.value == NOT_GIVEN else handle.value for label, handle in self._inputs.items()}
        return arguments_of(self._fields, typed)

    def set(self, label: str, value: str) -> None:
        """Set the value of a field, if there is one of that label."""
        if label in self._inputs:
            set_value(self._inputs[label], value)

    def _add(self, field: FormField) -> viser.GuiInputHandle[Any]:
        hint = field.hint or None
        if field.kind is FieldKind.BOOLEAN:
            return self._gui.add_checkbox(field.title, field.default == "true", hint=hint)
        if field.kind is FieldKind.CHOICE:
            options = field.choices if field.required else (NOT_GIVEN, *field.choices)
            initial = field.default if field.default in options else options[0]
            return self._gui.add_dropdown(field.title, options, initial_value=initial, hint=hint)
        return self._gui.add_text(field.title, field.default, hint=hint)
