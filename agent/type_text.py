"""Type hints as text for people, without module paths."""

import inspect
import types
from typing import Annotated, Any, Literal, Union, get_args, get_origin


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
