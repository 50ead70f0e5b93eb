"""External calls: a method's type hints are its signature on the wire."""

import inspect
from collections.abc import Callable
from typing import Any, get_type_hints

import msgspec

from robrain.agent.plugin import EXTERNAL_MARK, Plugin
from robrain.protocol.wire.errors import CallError, ErrorCode
from robrain.protocol.wire.messages import FunctionInfo


class ExternalFunction:
    """One external function of one plugin class.

    Args:
        name: its name on the wire.
        function: the plain function of the class (takes the plugin first).

    """

    def __init__(self, name: str, function: Callable[..., Any]) -> None:
        self.name = name
        self._function = function
        hints = get_type_hints(function)
        signature = inspect.signature(function)
        parameters = list(signature.parameters.values())[1:]
        self._names = [parameter.name for parameter in parameters]
        fields: list[Any] = []
        for parameter in parameters:
            kind = hints.get(parameter.name, Any)
            if parameter.default is inspect.Parameter.empty:
                fields.append((parameter.name, kind))
            else:
                fields.append((parameter.name, kind, parameter.default))
        self._arguments = msgspec.defstruct(
            f"{name}_arguments", fields, kw_only=True, forbid_unknown_fields=True, frozen=True
        )
        self.info = FunctionInfo(
            name=name,
            signature=str(signature.replace(parameters=parameters)),
            doc=inspect.getdoc(function) or "",
            parameters=msgspec.json.schema(self._arguments),
            returns=msgspec.json.schema(hints.get("return", Any)),
        )

    def call(self, plugin: Plugin, payload: bytes) -> Any:
        """Call it with JSON arguments: an array by position, an object by name, nothing for none.

        Raises:
            CallError: `bad_arguments`, naming the argument.

        """
        arguments = self._convert(payload)
        return self._function(plugin, **{name: getattr(arguments, name) for name in self._names})

    def _convert(self, payload: bytes) -> Any:
        try:
            given = msgspec.json.decode(payload) if payload.strip() else {}
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"{self.name}: arguments are not JSON: {error}") from error
        if isinstance(given, list):
            if len(given) > len(self._names):
                raise CallError(
                    ErrorCode.BAD_ARGUMENTS,
                    f"{self.name} takes at most {len(self._names)} arguments, got {len(given)}",
                )
            given = dict(zip(self._names, given, strict=False))
        if not isinstance(given, dict):
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"{self.name}: expected a JSON array or object of arguments")
        try:
            return msgspec.convert(given, self._arguments)
        except msgspec.ValidationError as error:
            text = str(error).replace(" - at `$.", " for argument `")
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"{self.name}{self.info.signature}: {text}") from error


def external_functions(plugin_class: type[Plugin]) -> dict[str, ExternalFunction]:
    """The external functions of a plugin class, by name."""
    return {
        name: ExternalFunction(name, function)
        for name, function in inspect.getmembers(plugin_class, inspect.isfunction)
        if getattr(function, EXTERNAL_MARK, False)
    }
