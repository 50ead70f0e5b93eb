"""Whether a plugin's class has what its interface promises to other plugins."""

import dis
import inspect
from collections.abc import Callable, Iterator
from itertools import pairwise
from types import NoneType, UnionType
from typing import Any, Generic, Protocol, Union, get_args, get_origin, get_type_hints

from robrain.agent.event import Event
from robrain.agent.plugin import Plugin

POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
BY_NAME = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)


def interface_differences(plugin_class: type[Plugin]) -> Iterator[tuple[str, str]]:
    """What of its interface a class lacks or has otherwise: the name, and what is wrong with it.

    Types are compared where both sides give them; what cannot be decided is not complained of.
    """
    interface: object = plugin_class.interface  # whatever its author has put there
    if interface is None:
        return
    if not isinstance(interface, type):
        yield "interface", f"expected a Protocol, got {interface!r}"
        return
    hints = _hints(interface)
    for name in _promised(interface):
        promised = inspect.getattr_static(interface, name, None)
        if inspect.isfunction(promised):
            yield from ((name, what) for what in _function_differences(plugin_class, interface, name))
        elif get_origin(hints.get(name)) is Event or hints.get(name) is Event:
            if not isinstance(getattr(plugin_class, name, None), Event):
                yield name, f"{interface.__name__} has the event {name}, {plugin_class.__name__} has not"
        elif not _has(plugin_class, name):
            yield name, f"{interface.__name__} has {name}, {plugin_class.__name__} has not"


def sets_attribute(plugin_class: type, name: str) -> bool:
    """Whether a function of the class sets an attribute of that name."""
    functions = (function for _, function in inspect.getmembers(plugin_class, inspect.isfunction))
    steps = (step for function in functions for step in dis.get_instructions(function))
    return any(step.opname == "STORE_ATTR" and step.argval == name for step in steps)


def used_plugins(plugin_class: type) -> Iterator[tuple[str, str]]:
    """Each function of a class that calls `env.use` with a name that is written there, and the name."""
    for function_name, function in inspect.getmembers(plugin_class, inspect.isfunction):
        steps = list(dis.get_instructions(function))
        for step, name in pairwise(steps):
            if step.opname == "LOAD_METHOD" and step.argval == "use" and name.opname == "LOAD_CONST":
                yield function_name, name.argval


def _promised(interface: type) -> list[str]:
    bases = [base for base in interface.__mro__ if base not in (object, Protocol, Generic)]
    names = (name for base in bases for name in (*vars(base), *vars(base).get("__annotations__", ())))
    return sorted({name for name in names if not name.startswith("_")})


def _has(plugin_class: type, name: str) -> bool:
    declared = any(name in vars(base).get("__annotations__", ()) for base in plugin_class.__mro__)
    return declared or hasattr(plugin_class, name) or sets_attribute(plugin_class, name)


def _function_differences(plugin_class: type, interface: type, name: str) -> Iterator[str]:
    own = getattr(plugin_class, name, None)
    if not callable(own):
        yield f"{interface.__name__} has the function {name}, {plugin_class.__name__} has not"
        return
    try:
        own_signature, wanted = _signature(plugin_class, name), _signature(interface, name)
    except (TypeError, ValueError):  # Python cannot tell the signature of what is written in C
        return
    if not _fits(own_signature, wanted):
        yield (
            f"{plugin_class.__name__}.{name}{own_signature} cannot be called as "
            f"{interface.__name__}.{name}{wanted} promises"
        )
        return
    own_hints, wanted_hints = _hints(own), _hints(getattr(interface, name))
    for parameter in own_signature.parameters.keys() & wanted.parameters.keys():
        promised, taken = wanted_hints.get(parameter, Any), own_hints.get(parameter, Any)
        if not _accepts(taken, promised):
            yield f"takes {_word(taken)} for {parameter}, {interface.__name__} promises to take {_word(promised)}"
    promised, returned = wanted_hints.get("return", Any), own_hints.get("return", Any)
    if promised is not NoneType and not _accepts(promised, returned):
        yield f"returns {_word(returned)}, {interface.__name__} promises {_word(promised)}"


def _signature(owner: type, name: str) -> inspect.Signature:
    """The signature as a caller sees it, without hints, whose differences are a matter of their own."""
    signature = inspect.signature(getattr(owner, name))
    parameters = list(signature.parameters.values())
    if inspect.isfunction(inspect.getattr_static(owner, name)):
        parameters = parameters[1:]
    return signature.replace(
        parameters=[parameter.replace(annotation=inspect.Parameter.empty) for parameter in parameters],
        return_annotation=inspect.Signature.empty,
    )


def _fits(own: inspect.Signature, wanted: inspect.Signature) -> bool:
    """Whether each call that `wanted` allows reaches the same parameters of `own`."""
    parameters = wanted.parameters.values()
    required = [parameter for parameter in parameters if parameter.default is inspect.Parameter.empty]
    try:
        for called in (list(parameters), [each for each in required if each.kind in (*POSITIONAL, *BY_NAME)]):
            by_place = [each.name for each in called if each.kind in POSITIONAL]
            by_name = {each.name: each.name for each in called if each.kind is inspect.Parameter.KEYWORD_ONLY}
            reached = own.bind(*by_place, **by_name).arguments
            if any(value != name for name, value in reached.items() if name in by_place):
                return False
            only_place = [each.name for each in called if each.kind is inspect.Parameter.POSITIONAL_ONLY]
            own.bind(*only_place, **{each.name: each.name for each in called if each.kind in BY_NAME})
    except TypeError:
        return False
    return True


def _hints(of: Callable[..., Any] | type) -> dict[str, Any]:
    try:
        return get_type_hints(of)
    except Exception:  # noqa: BLE001 - hints are foreign code, and may name types imported only for type checkers
        return {}


def _accepts(wide: Any, narrow: Any) -> bool:
    """Whether a value of type `narrow` is one of type `wide`; True where that cannot be decided."""
    if wide == narrow or Any in (wide, narrow) or (wide, narrow) in ((float, int), (complex, float), (complex, int)):
        return True
    if get_origin(narrow) in (Union, UnionType):
        return all(_accepts(wide, part) for part in get_args(narrow))
    if get_origin(wide) in (Union, UnionType):
        return any(_accepts(part, narrow) for part in get_args(wide))
    outer, inner = get_origin(wide) or wide, get_origin(narrow) or narrow
    if not (isinstance(outer, type) and isinstance(inner, type)):
        return True
    try:
        if not issubclass(inner, outer):
            return False
    except TypeError:  # a Protocol with attributes
        return True
    pairs = zip(get_args(wide), get_args(narrow), strict=False) if outer is inner else ()
    return all(_accepts(*pair) for pair in pairs)


def _word(kind: Any) -> str:
    return kind.__name__ if isinstance(kind, type) and not get_args(kind) else str(kind)
