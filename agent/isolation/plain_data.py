"""Plain data: what can pass between two processes. All that msgspec knows, numpy's arrays, and exceptions."""

import builtins
import sys
from typing import Any, get_origin

import msgspec

from robrain.agent import errors as agent_errors
from robrain.agent.errors import PluginError
from robrain.agent.isolation.messages import CallFailure
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
        f"{type(value).__name__} is not plain data: what passes between a plugin in a process of its own and the "
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
