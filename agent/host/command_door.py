"""The door to the outside: what the plugin `command` and the host's text commands reach the robot's plugins by."""

from collections.abc import Iterable

from robrain.agent.errors import PluginError, PluginMissing
from robrain.agent.host.text_command import Question, parse_command
from robrain.agent.lifecycle.plugin_info import plugin_info
from robrain.agent.lifecycle.registry import PluginRegistry
from robrain.agent.manifest import COMMAND
from robrain.agent.transform import Transform
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo, PluginInfo


class TextCommandDoor:
    """Executes the text form on one robot's plugins, as far as these are visible to `command`.

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
            by: who asks, for plugins that one caller at a time may use; see `ManagedPlugin.call_external`.

        Returns:
            A call's result, through the plugin's `[transform]`, empty if it has none; names with blanks between
            them; lines of help.

        Raises:
            CallError: the command, or what it calls, is wrong or refused.

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
    """What `list` and `help` say, of the plugins that are open to the outside.

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
