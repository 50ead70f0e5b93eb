"""Structs that check the ranges of their fields, also when they are built in Python.

The ranges are those in `msgspec.Meta` of the fields' types; msgspec itself checks them when it decodes or converts.
"""

import math
import operator
import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, Protocol, TypeVar

import msgspec
from msgspec import inspect

from robrain.protocol.model.ranges import INFINITE

T = TypeVar("T")
Check = Callable[[str, Any], None]
"""Raises ValueError if the value of the field with this name is out of range."""

BOUNDS = {"ge": (">=", operator.ge), "gt": (">", operator.gt), "le": ("<=", operator.le), "lt": ("<", operator.lt)}
_OUT_OF_RANGE = re.compile(r"Expected `(?:int|float)` ([<>]=?) (\S+) - at `(\$\S*)\.(\w+)`")
_STEP = re.compile(r"\.(\w+)|\[(\d+)\]")


class Checked(msgspec.Struct, frozen=True):
    """Base of structs whose fields must be in their ranges: ValueError names the field that is not.

    Floats must be finite, unless their annotation has `INFINITE`. Frequent messages are not of this base: the border
    checks them when they are received.
    """

    def __post_init__(self) -> None:
        for name, check in _checks(type(self)):
            check(name, getattr(self, name))


def convert(document: Any, kind: type[T]) -> T:
    """Convert as msgspec does; the error for a number that is out of range names the number, as `Checked` does.

    Raises:
        msgspec.ValidationError: the document does not fit.

    """
    try:
        return msgspec.convert(document, kind)
    except msgspec.ValidationError as error:
        found = _OUT_OF_RANGE.fullmatch(str(error))
        if found is None or "[...]" in found[3]:  # msgspec does not name the keys of a dict
            raise
        sign, bound, path, name = found.groups()
        value: Any = document
        for key, index in _STEP.findall(f"{path}.{name}"):
            value = value[key] if key else value[int(index)]
        where = f" - at `{path}`" if path != "$" else ""
        raise msgspec.ValidationError(f"{_out_of_range(name, sign, float(bound), value)}{where}") from error


@cache
def _checks(kind: type[msgspec.Struct]) -> tuple[tuple[str, Check], ...]:
    found = inspect.type_info(kind)
    checks = (
        ((field.name, _check_of(field.type)) for field in found.fields) if isinstance(found, inspect.StructType) else ()
    )
    return tuple((name, check) for name, check in checks if check is not None)


def _check_of(kind: inspect.Type) -> Check | None:
    """The check of a type; None if its values need none."""
    match kind:
        case inspect.Metadata():
            may_be_infinite = (kind.extra or {}).get(INFINITE, False)
            return _number_check(kind.type, is_finite=False) if may_be_infinite else _check_of(kind.type)
        case inspect.FloatType():
            return _number_check(kind, is_finite=True)
        case inspect.IntType():
            return _number_check(kind, is_finite=False)
        case inspect.UnionType():
            return _optional_check([one for one in kind.types if not isinstance(one, inspect.NoneType)])
        case inspect.StrType():
            return _text_check(kind)
        case inspect.ListType() | inspect.VarTupleType() | inspect.SetType() | inspect.FrozenSetType():
            return _items_check(kind, _check_of(kind.item_type))
        case inspect.DictType():
            return _items_check(kind, _check_of(kind.value_type))
        case inspect.TupleType(item_types=(first, *others)) if all(one == first for one in others):
            return _items_check(kind, _check_of(first))
    return None


def _number_check(kind: Any, *, is_finite: bool) -> Check | None:
    bounds = [(*BOUNDS[name], bound) for name in BOUNDS if (bound := getattr(kind, name)) is not None]

    def check(name: str, value: float) -> None:
        for sign, holds, bound in bounds:
            if not holds(value, bound):
                raise ValueError(_out_of_range(name, sign, bound, value))
        if is_finite and not math.isfinite(value):
            raise ValueError(f"expected a finite {name}, got {value}")

    return check if bounds or is_finite else None


def _text_check(kind: inspect.StrType) -> Check | None:
    if kind.pattern is None:
        return _items_check(kind, None)
    pattern = re.compile(kind.pattern)

    def check(name: str, value: str) -> None:
        if pattern.search(value) is None:
            raise ValueError(f"expected {name} to match {pattern.pattern}, got {value!r}")

    return check


def _items_check(kind: Any, check_item: Check | None) -> Check | None:
    least, most = getattr(kind, "min_length", None) or 0, getattr(kind, "max_length", None) or math.inf

    def check(name: str, value: Any) -> None:
        if not least <= len(value) <= most:
            limit = f"at least {least}" if len(value) < least else f"at most {most}"
            raise ValueError(f"expected {name} of length {limit}, got {len(value)}")
        if check_item is not None:
            for item in value.values() if isinstance(value, dict) else value:
                check_item(name, item)

    return check if least or most < math.inf or check_item is not None else None


def _optional_check(kinds: list[inspect.Type]) -> Check | None:
    """Of `X | None`; other unions are not checked."""
    check_value = _check_of(kinds[0]) if len(kinds) == 1 else None
    if check_value is None:
        return None

    def check(name: str, value: Any) -> None:
        if value is not None:
            check_value(name, value)

    return check


def _out_of_range(name: str, sign: str, bound: float, value: object) -> str:
    return f"expected {name} {sign} {bound:g}, got {value}"


class Named(Protocol):
    """A row of a table."""

    @property
    def name(self) -> str:
        """No other row has it."""


def check_names(what: str, limit: int, rows: Sequence[Named]) -> None:
    """Check that there are not too many rows of a table, and none with the name of another (ValueError)."""
    names = [row.name for row in rows]
    if len(names) > limit:
        raise ValueError(f"expected at most {limit} {what}s, got {len(names)}")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"expected each {what} to have a name of its own, got {', '.join(twice)} twice")
