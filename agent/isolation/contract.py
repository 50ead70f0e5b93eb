"""Values that pass between two processes: plain data, and the types of an interface's functions and events.

Plain data is all that msgspec knows, numpy's arrays, and exceptions.
"""

import builtins
import inspect
import sys
from collections.abc import Callable
from typing import Any, Generic, Protocol, get_args, get_origin, get_type_hints

import msgspec

from robrain.agent import errors as agent_errors
from robrain.agent.errors import PluginError
from robrain.agent.event import Event
from robrain.agent.isolation.messages import CallFailure
from robrain.agent.plugin import EXTERNAL_MARK, Plugin
from robrain.agent.plugin_traceback import Raised, raised, raised_elsewhere
from robrain.protocol import errors as wire_errors
from robrain.protocol.errors import ErrorCode, RobrainError


class _Array(msgspec.Struct, frozen=True):
    dtype: str
    shape: tuple[int, ...]
    data: bytes


def encode(value: Any) -> bytes:
    """Any plain value.

    Raises:
        TypeError: it is not plain data, in words.

    """
    return _ENCODER.encode(value)


def decoder(kind: Any) -> "msgspec.msgpack.Decoder[Any]":
    """Gives values of a type back."""
    return msgspec.msgpack.Decoder(kind, dec_hook=_from_plain)


def failure_of(error: Exception) -> CallFailure:
    """An exception as it travels."""
    kept = {name: str(value) for name, value in vars(error).items() if isinstance(value, str)}
    return CallFailure(type(error).__name__, str(error), kept, *raised(error))


def error_of(failure: CallFailure, plugin: str) -> Exception:
    """The exception again, if it is one of Python's or of robrain's own; else a PluginError of the plugin."""
    kind = _exception_class(failure.kind)
    if kind is None:
        error: Exception = PluginError(plugin, f"{failure.kind}: {failure.text}")
    else:
        # Not by its constructor, whose arguments differ from class to class.
        error = kind.__new__(kind, failure.text)
        error.args = (failure.text,)
        vars(error).update(failure.attributes)
        if isinstance(error, wire_errors.CallError):
            error.code = ErrorCode(failure.attributes["code"])
    error.add_note(f"in the process of {plugin}:\n{failure.traceback}")
    return raised_elsewhere(error, Raised(failure.where, failure.traceback))


def _exception_class(name: str) -> type[Exception] | None:
    for home, base in ((agent_errors, RobrainError), (wire_errors, RobrainError), (builtins, Exception)):
        found = getattr(home, name, None)
        if isinstance(found, type) and issubclass(found, base):
            return found
    return None


def _to_plain(value: Any) -> Any:
    np = _numpy()
    if np is not None:
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            return _Array(value.dtype.str, value.shape, value.tobytes())
        if isinstance(value, np.generic):
            return value.item()
    raise TypeError(
        f"{type(value).__name__} is not plain data: values between a plugin in a separate process and the "
        "others must be numbers, text, lists, dicts, structs, dataclasses or numpy arrays"
    )


def _from_plain(kind: Any, plain: Any) -> Any:
    wanted, np = get_origin(kind) or kind, _numpy()
    if np is not None:
        if wanted is np.ndarray:
            array = msgspec.convert(plain, _Array)
            return np.frombuffer(array.data, dtype=array.dtype).reshape(array.shape).copy()  # it may be written to
        if issubclass(wanted, np.generic):
            return wanted(plain)
    raise TypeError(f"{wanted.__name__} is not plain data")


def _numpy() -> Any:
    """NumPy if anything has imported it, and with that an array could be; else None."""
    return sys.modules.get("numpy")


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_to_plain)


_BARE = (object, Protocol, Generic)
_NOTHING = encode(([], {}))
_RAW_ARGUMENTS = msgspec.msgpack.Decoder(tuple[list[msgspec.Raw], dict[str, msgspec.Raw]])
_ANY = decoder(Any)


class WireSignature:
    """How one function's arguments and result are written and read.

    Args:
        name: the function's, for messages.
        function: takes `self` first.
        declared: the same function in the interface, whose hints count where the function has none.

    Raises:
        NameError, TypeError: its type hints cannot be read, or are of no use between processes.

    """

    def __init__(self, name: str, function: Callable[..., Any], declared: Callable[..., Any] | None = None) -> None:
        self.name = name
        hints = (get_type_hints(declared) if declared is not None else {}) | get_type_hints(function)
        self._result = decoder(hints.get("return", Any))
        self._by_place: list[msgspec.msgpack.Decoder[Any]] = []
        self._by_name: dict[str, msgspec.msgpack.Decoder[Any]] = {}
        self._further = _ANY
        for parameter in list(inspect.signature(function).parameters.values())[1:]:
            read = decoder(hints.get(parameter.name, Any))
            if parameter.kind is inspect.Parameter.VAR_POSITIONAL:
                self._further = read
                continue
            if parameter.kind in (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD):
                self._by_place.append(read)
            self._by_name[parameter.name] = read

    def write_arguments(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> bytes:
        """Arguments as they travel."""
        return encode((args, kwargs)) if args or kwargs else _NOTHING

    def read_arguments(self, written: bytes) -> tuple[list[Any], dict[str, Any]]:
        """The arguments again, in the types that the function declares.

        Raises:
            TypeError: one is of another type.

        """
        if written == _NOTHING:
            return [], {}
        raw_args, raw_kwargs = _RAW_ARGUMENTS.decode(written)
        places = len(self._by_place)
        try:
            args = [
                (self._by_place[place] if place < places else self._further).decode(raw)
                for place, raw in enumerate(raw_args)
            ]
            return args, {name: self._by_name.get(name, _ANY).decode(raw) for name, raw in raw_kwargs.items()}
        except msgspec.ValidationError as error:
            raise TypeError(f"{self.name}: {error}") from error

    def read_result(self, written: bytes) -> Any:
        """The result again, in the type that the function declares (TypeError if it is another)."""
        try:
            return self._result.decode(written)
        except msgspec.ValidationError as error:
            raise TypeError(f"result of {self.name}: {error}") from error


class Contract:
    """All that one interface offers.

    Args:
        interface: a Protocol, or None for nothing.
        implementation: a class whose own functions stand for those of the same name.

    """

    def __init__(self, interface: type | None, implementation: type | None = None) -> None:
        self.functions: dict[str, WireSignature] = {}
        self.attributes: dict[str, msgspec.msgpack.Decoder[Any]] = {}
        self.events: dict[str, msgspec.msgpack.Decoder[Any]] = {}
        if interface is None:
            return
        for name, hint in get_type_hints(interface).items():
            if not name.startswith("_"):
                self._declare(name, hint)
        for base in interface.__mro__:
            if base in _BARE:
                continue
            for name, value in vars(base).items():
                if name.startswith("_") or name in self.functions:
                    continue
                if isinstance(value, property):
                    self.attributes[name] = decoder(get_type_hints(value.fget).get("return", Any))
                elif inspect.isfunction(value):
                    own = inspect.getattr_static(implementation, name, None)
                    self.functions[name] = WireSignature(name, own if inspect.isfunction(own) else value, value)

    def add(self, name: str, function: Callable[..., Any]) -> None:
        """One more function, unless the interface has it already."""
        if name not in self.functions:
            self.functions[name] = WireSignature(name, function)

    def add_event(self, name: str, event: Event[Any]) -> None:
        """One more event, as a class declares it: `Event[int]()`."""
        if name not in self.events:
            self._declare(name, getattr(event, "__orig_class__", Event[Any]))

    def _declare(self, name: str, hint: Any) -> None:
        if hint is Event or get_origin(hint) is Event:
            (value,) = get_args(hint) or (Any,)
            self.events[name] = decoder(value)
        else:
            self.attributes[name] = decoder(hint)


def contract_of(plugin_class: type[Plugin]) -> Contract:
    """The contract of a plugin: its interface, its external functions and its events.

    Raises:
        Exception: all errors of get_type_hints and msgspec for hints that are of no use between processes.

    """
    contract = Contract(plugin_class.interface, plugin_class)
    for name in dir(plugin_class):
        member = inspect.getattr_static(plugin_class, name)
        if inspect.isfunction(member) and getattr(member, EXTERNAL_MARK, False):
            contract.add(name, member)
        elif isinstance(member, Event):
            contract.add_event(name, member)
    return contract
