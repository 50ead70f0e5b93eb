"""The text form of values and types: how arguments and results are written, and type hints without module paths."""

import inspect
import json
import re
import types
from collections.abc import Callable
from contextlib import suppress
from enum import Enum
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

import msgspec

from robrain.agent.errors import FOREIGN_ERRORS


def type_text(hint: Any) -> str:
    """A type hint in Python's own notation, without module paths.

    >>> type_text(float), type_text(list[int] | None), type_text(dict[str, inspect.Signature])
    ('float', 'list[int] | None', 'dict[str, Signature]')
    """
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is type(None):
        return "None"
    if origin is Annotated:
        return type_text(arguments[0])
    if origin is Literal:
        return f"Literal[{', '.join(map(repr, arguments))}]"
    if origin is Union or origin is types.UnionType:
        return " | ".join(map(type_text, arguments))
    if origin is not None:
        inner = ", ".join("..." if one is ... else type_text(one) for one in arguments)
        return f"{type_text(origin)}[{inner}]"
    return str(getattr(hint, "__name__", hint))


def signature_text(signature: inspect.Signature, hints: dict[str, Any]) -> str:
    """A signature without module paths.

    Args:
        signature: a function's.
        hints: its type hints by parameter name, `return` for the result; parameters without one keep their annotation.

    >>> def drive(distance_m: float, at: inspect.Parameter | None = None) -> inspect.Signature: ...
    >>> signature_text(inspect.signature(drive), inspect.get_annotations(drive))
    '(distance_m: float, at: Parameter | None = None) -> Signature'
    """
    parameters = [
        parameter.replace(annotation=_Written(type_text(hints[name]))) if name in hints else parameter
        for name, parameter in signature.parameters.items()
    ]
    returns = _Written(type_text(hints["return"])) if "return" in hints else inspect.Signature.empty
    return str(signature.replace(parameters=parameters, return_annotation=returns))


class _Written:
    """An annotation whose repr is the given text."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text


T = TypeVar("T")

TEXT_FORM_MARK = "__robrain_text_form__"
NULLS = ("null", "None")

_INTEGER = re.compile(r"[+-]?[0-9]{1,1000}")
_NAMED = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)\s*=(?!=)\s*(.*)", re.DOTALL)
_SHOWN = 60


class TextForm(NamedTuple):
    """How one type is written."""

    parse: Callable[[str], Any]
    print: Callable[[Any], str]


_of_fixed_types: dict[type, TextForm] = {}
"""Of types that take no attribute, such as `complex`; all others carry their form, so that it goes when they go."""


def register_text_form(kind: type[T], parse: Callable[[str], T], print: Callable[[T], str]) -> None:
    """Define how a type is written, so that external functions may accept and return it (the paper's `<<` and `>>`).

    The text is also the JSON form of a type that has none.

    Args:
        kind: the type.
        parse: makes one out of text; raises ValueError if it cannot.
        print: the text of one.

    Raises:
        ValueError: the type has a form already that cannot be replaced.

    """
    form = TextForm(parse, print)
    try:
        setattr(kind, TEXT_FORM_MARK, form)
    except TypeError as error:
        if not isinstance(msgspec.inspect.type_info(kind), msgspec.inspect.CustomType):
            raise ValueError(f"{kind.__name__} has a text form that cannot be replaced") from error  # noqa: TRY004
        _of_fixed_types[kind] = form


def encode_own(value: Any) -> Any:
    """The `enc_hook` of msgspec: JSON form of a value (TypeError if its type is not registered)."""
    form = _form_of_value(value)
    if form is None:
        kind = type(value).__name__
        raise TypeError(f"Encoding objects of type {kind} is unsupported; register_text_form({kind}, …) teaches it")
    return form.print(value)


def decode_own(kind: Any, value: Any) -> Any:
    """The `dec_hook` of msgspec: a value from its JSON form (ValueError if invalid, TypeError if not registered)."""
    form = _form_of(kind)
    if form is None:
        raise TypeError(_unknown(kind))
    if not isinstance(value, str):
        raise ValueError(f"expected text, got {type(value).__name__}")  # noqa: TRY004 - msgspec takes it for invalid
    return _foreign(form.parse, value, kind)


def schema_of_own(kind: Any) -> dict[str, Any]:
    """The `schema_hook` of msgspec: JSON Schema of a type (TypeError if it is not registered)."""
    if _form_of(kind) is None:
        raise TypeError(_unknown(kind))
    return {"title": kind.__name__, "type": "string"}


def _form_of(kind: Any) -> TextForm | None:
    if not isinstance(kind, type):
        return None
    found = vars(kind).get(TEXT_FORM_MARK)
    return found if isinstance(found, TextForm) else _of_fixed_types.get(kind)


def _form_of_value(value: Any) -> TextForm | None:
    return next((form for base in type(value).__mro__ if (form := _form_of(base)) is not None), None)


def _unknown(kind: Any) -> str:
    return f"{kind_name(kind)} is not supported; register_text_form({kind_name(kind)}, …) teaches it"


def _foreign(parse: Callable[[Any], Any], given: Any, kind: Any) -> Any:
    try:
        return parse(given)
    except FOREIGN_ERRORS as error:  # a plugin's own parser may raise anything
        raise ValueError(f"expected a {kind_name(kind)}, got {shown(given)}: {error}") from error


def parse_value(text: str, hint: Any) -> Any:
    """The value that a text means where a type is expected.

    Args:
        text: as typed; blanks around it do not count.
        hint: a type hint.

    Raises:
        ValueError: with the expected and the actual value.

    >>> parse_value("1.5", float), parse_value("hello you", str), parse_value("[1, 2]", list[int])
    (1.5, 'hello you', [1, 2])
    """
    text = text.strip()
    form = _form_of(hint)
    if form is not None:
        return _foreign(form.parse, text, hint)
    parse = _SCALARS.get(hint) if isinstance(hint, type) else None
    if parse is not None:
        return parse(text)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return _parse_enum(text, hint)
    origin = get_origin(hint)
    if origin is Annotated:
        return _parse_annotated(text, hint)
    if origin is Union or origin is types.UnionType:
        return _parse_union(text, hint)
    if origin is Literal:
        return _parse_literal(text, hint)
    if hasattr(hint, "__supertype__"):  # a NewType
        return parse_value(text, hint.__supertype__)
    if hint is Any or isinstance(hint, TypeVar):
        return _parse_any(text)
    return _parse_json(text, hint)


def print_value(value: Any) -> str:
    """The text of a value, in one line unless a type's own printer breaks it; `parse_value` reads it again.

    A text is quoted only if it would not be read as itself.

    >>> print_value(1.5), print_value("hello you"), print_value([1, 2]), print_value(None)
    ('1.5', 'hello you', '[1, 2]', 'null')
    """
    form = _form_of_value(value)
    if form is not None:
        return form.print(value)
    if value is None:
        return "null"
    if isinstance(value, Enum):
        return print_value(value.value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return int.__repr__(value)
    if isinstance(value, float):
        return float.__repr__(value)  # numpy's own repr names the type
    if isinstance(value, str):
        return _quoted_if_needed(value)
    encoded = msgspec.json.encode(value, enc_hook=encode_own)
    if encoded.startswith(b'"'):  # bytes, times and the like
        return _quoted_if_needed(msgspec.json.decode(encoded, type=str))
    return msgspec.json.format(encoded, indent=0).decode()


def is_quoted(text: str) -> bool:
    """Whether a text can only be meant as text."""
    return text.lstrip()[:1] in ('"', "'")


def kind_name(hint: Any) -> str:
    """A type hint as error messages show it."""
    return "null" if hint is type(None) else type_text(hint)


def shown(value: Any) -> str:
    """A given value as a message shows it; cut if it is long."""
    text = value if isinstance(value, str) else str(value)
    return repr(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…")


def _expected(what: str, text: str) -> ValueError:
    return ValueError(f"expected {what}, got {shown(text)}")


def _parse_bool(text: str) -> bool:
    known = {"true": True, "false": False}
    if text.casefold() not in known:
        raise _expected("true or false", text)
    return known[text.casefold()]


def _parse_int(text: str) -> int:
    if not _INTEGER.fullmatch(text):
        raise _expected("a whole number", text)
    return int(text)


def _parse_float(text: str) -> float:
    try:
        if text.isascii() and "_" not in text:
            return float(text)
    except ValueError:
        pass
    raise _expected("a number", text)


def _parse_none(text: str) -> None:
    if text not in NULLS:
        raise _expected("null", text)


def _unquoted(text: str) -> str:
    """The text itself, without the quotes that may stand around it."""
    if text.startswith("'"):
        if len(text) < 2 or text.find("'", 1) != len(text) - 1:
            raise _expected("one text between single quotes", text)
        return text[1:-1]
    if not text.startswith('"'):
        return text
    try:
        found = json.loads(text, strict=False)
        found.encode()  # half of a surrogate pair could not travel on
    except ValueError as error:
        raise ValueError(f"expected one text between double quotes, got {shown(text)}: {error}") from error
    assert isinstance(found, str)
    return found


def _quoted_if_needed(text: str) -> str:
    plain = text and text == text.strip() and text.isprintable() and not is_quoted(text) and text not in NULLS
    return text if plain else json.dumps(text)


_SCALARS: dict[type, Callable[[str], Any]] = {
    bool: _parse_bool,
    int: _parse_int,
    float: _parse_float,
    str: _unquoted,
    type(None): _parse_none,
}


def _parse_enum(text: str, hint: type[Enum]) -> Enum:
    plain = _unquoted(text)
    for member in hint:
        if plain == str(member.value) or text == print_value(member.value):
            return member
    if plain in hint.__members__:
        return hint[plain]
    raise _expected(f"one of {', '.join(print_value(member.value) for member in hint)}", text)


def _parse_literal(text: str, hint: Any) -> Any:
    options = get_args(hint)
    for option in options:
        if text == print_value(option) or (isinstance(option, str) and _unquoted(text) == option):
            return option
    raise _expected(f"one of {', '.join(map(print_value, options))}", text)


def _parse_annotated(text: str, hint: Any) -> Any:
    bare = get_args(hint)[0]
    if _form_of(bare) is not None:
        return parse_value(text, bare)
    if not isinstance(bare, type) or bare not in _SCALARS:
        return _parse_json(text, hint)
    try:
        return msgspec.convert(parse_value(text, bare), hint)
    except msgspec.ValidationError as error:
        raise ValueError(f"{error}, got {shown(text)}") from error


def _parse_union(text: str, hint: Any) -> Any:
    members = [member for member in get_args(hint) if member is not type(None)]
    if type(None) in get_args(hint) and text in NULLS:
        return None
    if len(members) > 1 and not is_quoted(text):
        try:
            return msgspec.json.decode(text, type=hint, dec_hook=decode_own)
        except (msgspec.DecodeError, TypeError, ValueError, RecursionError):
            pass  # not JSON, or types that msgspec does not distinguish: each is tried
    complaints = []
    # Any text is a str: it comes last, unless the text is quoted.
    for member in sorted(members, key=lambda member: (member is str) != is_quoted(text)):
        try:
            return parse_value(text, member)
        except ValueError as error:
            complaints.append(str(error))
    raise ValueError("; or ".join(complaints))


def _parse_any(text: str) -> Any:
    try:
        return msgspec.json.decode(text)
    except (msgspec.DecodeError, ValueError, RecursionError):
        return _unquoted(text)


def _parse_json(text: str, hint: Any) -> Any:
    try:
        if not text.startswith(("[", "{")):
            with suppress(msgspec.ValidationError):  # only times, bytes and the like need no quotes
                return msgspec.convert(_unquoted(text), hint, dec_hook=decode_own)
        return msgspec.json.decode(text, type=hint, dec_hook=decode_own)
    except msgspec.ValidationError as error:
        raise ValueError(str(error).replace(" - at `$", " at `$")) from error
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise ValueError(f"expected a {kind_name(hint)} as JSON, got {shown(text)}: {error}") from error


def parse_argument(word: str) -> tuple[str | None, str]:
    """An argument of a call as its name, if it has one, and its value's text.

    >>> parse_argument("distance_m=1.0"), parse_argument('"a=b"')
    (('distance_m', '1.0'), (None, '"a=b"'))
    """
    found = _NAMED.fullmatch(word)
    return (found[1], found[2]) if found is not None else (None, word)
