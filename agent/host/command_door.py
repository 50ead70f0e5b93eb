"""Text commands, `call PLUGIN FUNCTION(ARGUMENTS)`, `list` and `help [PLUGIN]`, and the door to the plugins.

    call driver drive(1.0)
    call driver drive(distance_m=1.0, "a b")

The plugin `command` and the host use the door. How an argument is written is in `robrain.agent.text_form`.
"""

import re
from collections.abc import Iterable
from typing import Literal, NamedTuple

from robrain.agent.errors import PluginError, PluginMissing
from robrain.agent.lifecycle.registry import PluginRegistry, plugin_info
from robrain.agent.manifest import COMMAND
from robrain.agent.text_form import shown
from robrain.agent.transform import Transform
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo, PluginInfo

GRAMMAR = "`call PLUGIN FUNCTION(ARGUMENTS)`, `list` or `help [PLUGIN]`"
_CALL = re.compile(r"call\s+([^\s()]+)\s+([^\s()]+)\s*(.*)", re.DOTALL)
_QUESTION = re.compile(r"(list)|help(?:\s+([^\s()]+))?")
_CLOSING = {"(": ")", "[": "]", "{": "}"}


class TextCall(NamedTuple):
    """`call PLUGIN FUNCTION(ARGUMENTS)`, taken apart."""

    plugin: str
    function: str
    """Its external name, or its signature as `void.foo-int-string`."""
    arguments: list[str]
    """As typed, `name=` and quotes included."""


class Question(NamedTuple):
    """`list`, `help` or `help PLUGIN`."""

    verb: Literal["list", "help"]
    plugin: str = ""


def parse_command(text: str) -> TextCall | Question:
    """Take any command apart.

    Raises:
        CallError: `bad_arguments`, with the expected arguments.

    """
    found = _QUESTION.fullmatch(text.strip())
    if found is None:
        return parse_call(text)
    return Question("list") if found[1] else Question("help", found[2] or "")


def parse_call(text: str) -> TextCall:
    """Take a call apart; without brackets it has no arguments.

    Raises:
        CallError: `bad_arguments`, with the expected arguments.

    >>> parse_call('call driver drive(distance_m=1.0, "a, b")')
    TextCall(plugin='driver', function='drive', arguments=['distance_m=1.0', '"a, b"'])
    """
    found = _CALL.fullmatch(text.strip())
    if found is None:
        raise CallError(ErrorCode.BAD_ARGUMENTS, f"expected {GRAMMAR}, got {shown(text)}")
    plugin, function, rest = found.groups()
    if rest and not rest.startswith("("):
        raise CallError(ErrorCode.BAD_ARGUMENTS, f"expected ( after {function}, got {shown(rest)}")
    return TextCall(plugin, function, _split(rest) if rest else [])


def _split(text: str) -> list[str]:
    """Split `(…)` at its commas, but not within brackets or quotes.

    Neither shlex, which takes the quotes away, nor tokenize, which knows no bare words, serves here.
    """
    words: list[str] = []
    closing: list[str] = []
    quote, start = "", 1
    places = iter(enumerate(text))
    for place, char in places:
        if quote:
            if char == "\\" and quote == '"':
                next(places, None)
            elif char == quote:
                quote = ""
        elif char in "\"'" and (text[place - 1].isspace() or text[place - 1] in "([{,=:"):  # not in o'clock
            quote = char
        elif char in _CLOSING:
            closing.append(_CLOSING[char])
        elif char == "," and len(closing) == 1:
            words.append(text[start:place])
            start = place + 1
        elif char in _CLOSING.values():
            if closing.pop() != char:
                raise CallError(ErrorCode.BAD_ARGUMENTS, f"{char} without its opening bracket in {shown(text)}")
            if not closing:
                return _whole([*words, text[start:place]], text[place + 1 :])
    missing = quote or closing[-1]
    raise CallError(ErrorCode.BAD_ARGUMENTS, f"expected {missing} before the end of {shown(text)}")


def _whole(words: Iterable[str], rest: str) -> list[str]:
    stripped = [word.strip() for word in words]
    if rest.strip():
        raise CallError(ErrorCode.BAD_ARGUMENTS, f"expected nothing after the closing ), got {shown(rest.strip())}")
    if stripped == [""]:
        return []
    if "" in stripped:
        raise CallError(ErrorCode.BAD_ARGUMENTS, f'argument {stripped.index("") + 1} is empty; write null or ""')
    return stripped


class TextCommandDoor:
    """Executes the text form on one robot's plugins, if these are visible to `command`.

    May be used from any thread; holds no lock, so that it may be called from below.

    Args:
        registry: of the robot's plugins.

    """

    def __init__(self, registry: PluginRegistry) -> None:
        self._registry = registry

    def plugins(self) -> list[PluginInfo]:
        """The plugins that are open to the outside."""
        own = [plugin_info(plugin, self._registry) for plugin in self._registry.plugins.values()]
        return visible_to_command([*own, *self._registry.foreign_infos()])

    def call_text(self, text: str, *, by: str = "") -> str:
        """Execute `call PLUGIN FUNCTION(ARGUMENTS)`, `list` or `help [PLUGIN]`.

        Args:
            text: the command.
            by: name of the caller, for plugins that one caller at a time may use; see `ManagedPlugin.call_external`.

        Returns:
            A call's result, through the plugin's `[transform]`, empty if it has none; names with blanks between
            them; lines of help.

        Raises:
            CallError: the command, or its call, is wrong or refused.

        """
        command = parse_command(text)
        if isinstance(command, Question):
            return answer_question(command, self.plugins())
        foreign = self._registry.foreign
        if foreign is not None and self._registry.is_foreign(command.plugin):
            return foreign.call_text(command.plugin, command.function, command.arguments)
        try:
            plugin = self._registry.get(command.plugin)
            transform = Transform(plugin.manifest.transform)
            words = transform.incoming(command.arguments)
            return transform.outgoing(plugin.call_external_text(command.function, words, by=by))
        except PluginMissing as error:
            raise CallError(ErrorCode.UNKNOWN_PLUGIN, str(error)) from error
        except PluginError as error:
            raise CallError(error.code, str(error)) from error


def visible_to_command(plugins: Iterable[PluginInfo]) -> list[PluginInfo]:
    """Those that are open to the outside."""
    return [plugin for plugin in plugins if COMMAND in plugin.visibility]


def answer_question(question: Question, plugins: list[PluginInfo]) -> str:
    """The replies of `list` and `help` for plugins that are open to the outside.

    Raises:
        CallError: `unknown_plugin`, naming those that there are.

    """
    if question.verb == "list":
        return " ".join(plugin.name for plugin in plugins)
    if not question.plugin:
        lines = ["call PLUGIN FUNCTION(ARGUMENTS)   list   help PLUGIN"]
        return "\n".join([*lines, *(_with_doc(plugin.name, plugin.doc) for plugin in plugins)])
    for plugin in plugins:
        if plugin.name == question.plugin:
            state = f"{plugin.level}, {plugin.state}{f': {plugin.why}' if plugin.why else ''}"
            functions = (f"  {_with_doc(usage(function), function.doc)}" for function in plugin.functions)
            return "\n".join([_with_doc(f"{plugin.name} ({state})", plugin.doc), *functions])
    names = ", ".join(plugin.name for plugin in plugins) or "none"
    raise CallError(ErrorCode.UNKNOWN_PLUGIN, f"no plugin {question.plugin} is open to the outside; there are: {names}")


def usage(function: FunctionInfo) -> str:
    """How a function is called: `drive(distance_m: float) -> None`."""
    return f"{function.name}{function.signature}"


def _with_doc(what: str, doc: str) -> str:
    first = doc.strip().partition("\n")[0]
    return f"{what}  {first}" if first else what
