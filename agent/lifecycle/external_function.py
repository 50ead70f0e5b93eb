"""External calls: a method's type hints are its signature on the wire and in the text form."""

import inspect
import re
import types
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import msgspec

from robrain.agent.plugin import EXTERNAL_MARK, UNLOCKED_MARK, Plugin
from robrain.agent.text_form import (
    decode_own,
    encode_own,
    is_quoted,
    parse_argument,
    parse_value,
    print_value,
    schema_of_own,
    signature_text,
)
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.action_messages import ActionId
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo

TYPE_WORDS: Mapping[Any, str] = {type(None): "void", float: "double", str: "string", Any: "any"}
"""Types whose word in a signature is not their name; the paper's words are those of C++."""


class Fit(NamedTuple):
    """Arguments that a signature takes, and how well they fit: first types, then number."""

    arguments: dict[str, Any]
    converted: int
    """Arguments that fit a type only after conversion: a whole number for a float, a bare word for a str."""
    defaults: int
    """Parameters that were left to their defaults."""

    @property
    def loss(self) -> tuple[int, int]:
        """The key by which fits are compared; the best fit has the least."""
        return self.converted, self.defaults


class Signature:
    """One method of a plugin class that can be called from outside.

    Args:
        name: its external name.
        function: the plain function of the class (takes the plugin first).

    Raises:
        TypeError: it takes arguments that have no name, or of types without a written form.

    """

    def __init__(self, name: str, function: Callable[..., Any]) -> None:
        self.name = name
        self.unlocked = bool(getattr(function, UNLOCKED_MARK, False))
        self._function = function
        hints = get_type_hints(function, include_extras=True)
        signature = inspect.signature(function)
        parameters = list(signature.parameters.values())[1:]
        for parameter in parameters:
            if parameter.kind not in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
                raise TypeError(f"{name}: external functions take named parameters, {parameter} is none")
        self.hints = {parameter.name: hints.get(parameter.name, Any) for parameter in parameters}
        self._defaults = {one.name: one.default for one in parameters if one.default is not inspect.Parameter.empty}
        returns = hints.get("return", Any)
        self._returns_nothing = returns is type(None)
        words = [type_word(hint) for hint in self.hints.values()]
        self.signature_name = "-".join([f"{type_word(str if returns is ActionId else returns)}.{name}", *words])
        """As in section 3.4 of the paper: `void.foo-int-string`."""
        fields = [
            (field, hint, self._defaults[field]) if field in self._defaults else (field, hint)
            for field, hint in self.hints.items()
        ]
        self._struct: Any = msgspec.defstruct(
            f"{name}_arguments", fields, kw_only=True, forbid_unknown_fields=True, frozen=True
        )
        self._in_order: Any = msgspec.defstruct(f"{name}_in_order", fields, array_like=True, forbid_unknown_fields=True)
        self._by_name_only = any(parameter.kind is parameter.KEYWORD_ONLY for parameter in parameters)
        own_types: list[Any] = []

        def schema_hook(kind: Any) -> dict[str, Any]:
            own_types.append(kind)
            return schema_of_own(kind)

        returned = msgspec.json.schema(returns, schema_hook=schema_hook)
        self._returns_own = bool(own_types)
        self.info = FunctionInfo(
            name=name,
            signature=signature_text(signature.replace(parameters=parameters), hints),
            doc=inspect.getdoc(function) or "",
            parameters=msgspec.json.schema(self._struct, schema_hook=schema_of_own),
            returns=returned,
            starts_action=returns is ActionId,
        )

    def run(self, plugin: Plugin, arguments: dict[str, Any]) -> Any:
        """Call it; a value that JSON cannot express is returned as its JSON form."""
        return self._as_json(self._function(plugin, **arguments))

    def read_json(self, payload: bytes) -> tuple[Any, ...] | None:
        """The arguments in order, straight out of JSON: the path of nearly all calls, in a third of the time.

        None if that cannot be: `fit_json` then gives the reason.
        """
        kind = self._in_order if payload[:1] == b"[" else self._struct
        try:
            return msgspec.structs.astuple(msgspec.json.decode(payload or b"{}", type=kind, dec_hook=decode_own))
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            return None

    def run_in_order(self, plugin: Plugin, arguments: tuple[Any, ...]) -> Any:
        """Call it with these; a value that JSON cannot express is returned as its JSON form."""
        if self._by_name_only:
            return self.run(plugin, dict(zip(self.hints, arguments, strict=True)))
        return self._as_json(self._function(plugin, *arguments))

    def _as_json(self, result: Any) -> Any:
        if result is None or isinstance(result, (bool, int, float, str)):
            return result
        if isinstance(result, msgspec.Struct) and not self._returns_own:
            return result
        return msgspec.to_builtins(result, enc_hook=encode_own)

    def run_text(self, plugin: Plugin, arguments: dict[str, Any]) -> str:
        """Call it; the result as text, empty if the function promises none."""
        result = self._function(plugin, **arguments)
        return "" if result is None and self._returns_nothing else print_value(result)

    def fit_json(self, given: list[Any] | dict[str, Any]) -> Fit:
        """Convert JSON arguments to the parameters' types (CallError `bad_arguments`)."""
        if isinstance(given, list):
            if len(given) > len(self.hints):
                raise self._too_many(len(given))
            given = dict(zip(self.hints, given, strict=False))
        try:
            struct = msgspec.convert(given, self._struct, dec_hook=decode_own, str_keys=True)
        except msgspec.ValidationError as error:
            text = str(error).replace(" - at `$.", " for argument `")
            raise self._bad(text) from error
        arguments = {name: getattr(struct, name) for name in self.hints}
        converted = sum(
            isinstance(value, (int, float, str)) and type(arguments[name]) is not type(value)
            for name, value in given.items()
        )
        return Fit(arguments, converted, len(self.hints) - len(given))

    def fit_text(self, words: list[str]) -> Fit:
        """Convert text arguments: named ones first, the others in order (CallError `bad_arguments`)."""
        named: dict[str, str] = {}
        unnamed: list[str] = []
        for word in words:
            name, text = parse_argument(word)
            if name is None:
                unnamed.append(text)
            elif name not in self.hints:
                raise self._bad(f"no parameter `{name}`; put text that contains = in quotes")
            elif name in named:
                raise self._bad(f"argument `{name}` is given twice")
            else:
                named[name] = text
        free = [name for name in self.hints if name not in named]
        if len(unnamed) > len(free):
            raise self._too_many(len(words))
        given = named | dict(zip(free, unnamed, strict=False))
        arguments = {}
        for name, hint in self.hints.items():
            if name in given:
                try:
                    arguments[name] = parse_value(given[name], hint)
                except ValueError as error:
                    raise self._bad(f"argument `{name}`: {error}") from error
            elif name not in self._defaults:
                raise self._bad(f"missing argument `{name}`")
        converted = sum(_is_guessed(text, arguments[name]) for name, text in given.items())
        # The struct fills in the defaults, with new lists each time.
        defaults = self._struct(**arguments) if len(arguments) < len(self.hints) else None
        whole = {name: arguments[name] if name in arguments else getattr(defaults, name) for name in self.hints}
        return Fit(whole, converted, len(self.hints) - len(given))

    def _too_many(self, given: int) -> CallError:
        return CallError(ErrorCode.BAD_ARGUMENTS, f"{self.name} takes at most {len(self.hints)} arguments, got {given}")

    def _bad(self, what: str) -> CallError:
        return CallError(ErrorCode.BAD_ARGUMENTS, f"{self.name}{self.info.signature}: {what}")


class ExternalFunction:
    """All signatures that share one external name.

    Of several, the one whose arguments convert is called. If more than one does, types decide first, then the number of
    defaults. A whole number fits an int better than a float, quoted text a str, a bare word the type of its spelling. A
    call that is still ambiguous is refused; its signature name selects one.
    """

    def __init__(self, name: str, *signatures: Signature) -> None:
        self.name = name
        self.signatures = signatures
        self.unlocked = all(signature.unlocked for signature in signatures)
        """Whether it is called without the plugin's lock: all of it is marked so."""
        self._only = signatures[0] if len(signatures) == 1 else None
        names = self.signature_names
        if len(set(names)) < len(names):
            raise TypeError(f"two external functions have the signature {max(names, key=names.count)}")

    @property
    def signature_names(self) -> list[str]:
        """As in section 3.4 of the paper, in the order of definition."""
        return [signature.signature_name for signature in self.signatures]

    @property
    def infos(self) -> list[FunctionInfo]:
        """The description of each signature."""
        return [signature.info for signature in self.signatures]

    def call(self, plugin: Plugin, payload: bytes) -> Any:
        """Call it with JSON arguments: an array by position, an object by name, nothing for none.

        Returns:
            A value that JSON can express.

        Raises:
            CallError: `bad_arguments`, naming the argument or the signatures that there are.

        """
        if self._only is not None and (arguments := self._only.read_json(payload)) is not None:
            return self._only.run_in_order(plugin, arguments)
        try:
            given = msgspec.json.decode(payload) if payload.strip() else {}
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"{self.name}: arguments are not JSON: {error}") from error
        if not isinstance(given, (list, dict)):
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"{self.name}: expected a JSON array or object of arguments")
        signature, named = self._choose(lambda signature: signature.fit_json(given))
        return signature.run(plugin, named)

    def call_text(self, plugin: Plugin, words: list[str]) -> str:
        """Call it with arguments as text, each `VALUE` or `NAME=VALUE`; see `robrain.agent.text_form`.

        Returns:
            The result as text; nothing of a function that returns nothing.

        Raises:
            CallError: `bad_arguments`, naming the argument or the signatures that there are.

        """
        signature, arguments = self._choose(lambda signature: signature.fit_text(words))
        return signature.run_text(plugin, arguments)

    def _choose(self, fit: Callable[[Signature], Fit]) -> tuple[Signature, dict[str, Any]]:
        if len(self.signatures) == 1:
            return self.signatures[0], fit(self.signatures[0]).arguments
        fits: list[tuple[Signature, Fit]] = []
        complaints = []
        for signature in self.signatures:
            try:
                fits.append((signature, fit(signature)))
            except CallError as error:
                complaints.append(f"{signature.signature_name} ({error.message})")
        if not fits:
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"no {self.name} takes these arguments: {'; '.join(complaints)}")
        least = min(found.loss for _, found in fits)
        best = [(signature, found) for signature, found in fits if found.loss == least]
        if len(best) > 1:
            names = ", ".join(signature.signature_name for signature, _ in best)
            raise CallError(
                ErrorCode.BAD_ARGUMENTS, f"{self.name} is ambiguous with these arguments; call one of {names}"
            )
        signature, found = best[0]
        return signature, found.arguments


def external_functions(plugin_class: type[Plugin]) -> dict[str, ExternalFunction]:
    """The external functions of a plugin class, by external name.

    Raises:
        TypeError: one cannot be described, or two cannot be distinguished.

    """
    # Not dir(): overloads are listed in the order of their definition.
    members = dict.fromkeys(name for base in reversed(plugin_class.__mro__) for name in vars(base))
    signatures: dict[str, list[Signature]] = {}
    for member in members:
        function: Any = getattr(plugin_class, member, None)
        name = getattr(function, EXTERNAL_MARK, None) if inspect.isfunction(function) else None
        if isinstance(name, str):
            signatures.setdefault(name, []).append(Signature(name, function))
    return {name: ExternalFunction(name, *signatures[name]) for name in sorted(signatures)}


def find_function(functions: Mapping[str, ExternalFunction], name: str) -> ExternalFunction | None:
    """A function by its external name, or exactly one signature of it by its signature name."""
    if name in functions or "." not in name:
        return functions.get(name)
    for function in functions.values():
        for signature in function.signatures:
            if signature.signature_name == name:
                return ExternalFunction(function.name, signature)
    return None


def type_word(hint: Any) -> str:
    """A type in a signature: letters, digits and _ only, so that it can stand in a key.

    >>> type_word(float), type_word(list[int]), type_word(int | None)
    ('double', 'list_int', 'int_or_void')
    """
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return type_word(arguments[0])
    if origin is Literal:
        return "literal"
    if origin is Union or origin is types.UnionType:
        return "_or_".join(map(type_word, arguments))
    if origin is not None:
        return "_".join([type_word(origin), *(type_word(one) for one in arguments if one is not ...)])
    word = TYPE_WORDS.get(hint) or str(getattr(hint, "__name__", hint))
    return re.sub(r"[^A-Za-z0-9_]", "_", word)


def _is_guessed(text: str, value: Any) -> bool:
    """Whether a bare word was taken for a str, or quoted text for something else, or a whole number for a float."""
    if isinstance(value, float):
        return text.strip().lstrip("+-").isdecimal()
    return (type(value) is str) != is_quoted(text)
