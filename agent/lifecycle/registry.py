"""The plugins of one robot: their requirements, their holders, and their descriptions."""

import zlib
from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter

import msgspec

from robrain.agent.errors import PluginCrashed, PluginError, PluginInactive, PluginMissing
from robrain.agent.isolation.foreign_plugins import ForeignPlugins
from robrain.agent.lifecycle.access import AccessiblePlugin, level_conflict
from robrain.agent.lifecycle.instance import RobotContext
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.manifest import Manifest
from robrain.agent.plugin import Plugin, PluginState
from robrain.agent.plugin_traceback import causes_of, raised
from robrain.protocol.messages.robots.plugin_messages import PluginInfo, TaskKind
from robrain.protocol.messages.robots.robot_messages import PluginFault
from robrain.protocol.model.ranges import cut


@dataclass(eq=False, kw_only=True)
class PluginRegistry(RobotContext):
    """Knows the plugins of one robot; its dict of them is replaced, never changed, so that readers need no lock."""

    foreign: ForeignPlugins | None = None
    """Plugins in separate processes, in live."""
    plugins: dict[str, ManagedPlugin] = field(default_factory=dict)
    """Requirements before those that require them."""
    new_faults: deque[ManagedPlugin] = field(default_factory=deque)
    """Plugins that have faulted since the host's last look at them."""

    def get(self, name: str) -> ManagedPlugin:
        """The plugin of a name (PluginMissing if there is none)."""
        try:
            return self.plugins[name]
        except KeyError:
            raise PluginMissing(name, f"no plugin {name}; there are: {', '.join(self.plugins)}") from None

    def remove(self, plugin: ManagedPlugin) -> None:
        """Know a plugin no more."""
        self.plugins = {name: other for name, other in self.plugins.items() if other is not plugin}

    def requirements(self) -> dict[str, list[str]]:
        """Requirements of each plugin, by name."""
        return {name: plugin.manifest.tag.requires for name, plugin in self.plugins.items()}

    def users_of(self, name: str) -> list[ManagedPlugin]:
        """All that require a plugin, also through others; users before their providers."""
        needed = {name}
        users = []
        for plugin in self.plugins.values():  # requirements first
            if needed.intersection(plugin.manifest.tag.requires):
                needed.add(plugin.name)
                users.append(plugin)
        return users[::-1]

    def root_cause(self, plugin: ManagedPlugin) -> ManagedPlugin:
        """The plugin because of which a plugin does not run: the plugin itself, or one that it requires."""
        while (lacked := self.plugins.get(plugin.lacks)) is not None:
            plugin = lacked
        return plugin

    def is_running(self, name: str) -> bool:
        """Whether a plugin of that name runs."""
        return self.is_foreign(name) or (name in self.plugins and self.plugins[name].state.is_running)

    def lacked_by(self, plugin: AccessiblePlugin, error: BaseException) -> str:
        """The required plugin that raised an error because it does not run or hangs; empty if none did."""
        branch = branch_of(plugin.name, self.requirements())
        for cause in causes_of(error):
            if isinstance(cause, PluginInactive | PluginCrashed | PluginMissing) and cause.plugin in branch:
                return cause.plugin
        return ""

    def excuses(self, plugin: AccessiblePlugin, error: BaseException) -> bool:
        """Whether an error that a plugin raised is the fault of one that it requires, or of a halt."""
        return (self.halted and isinstance(error, PluginInactive)) or bool(self.lacked_by(plugin, error))

    def check_requirements(self, manifest: Manifest, plugin_class: type[Plugin]) -> None:
        """Whether all plugins that a plugin requires run, and are of lower levels (PluginError if not)."""
        for required in manifest.tag.requires:
            if self.is_foreign(required):
                continue
            other = self.get(required)
            if other.plugin_class.level >= plugin_class.level:
                raise level_conflict(manifest.name, plugin_class, required, other.plugin_class)
            if not other.state.is_running:
                raise PluginError(
                    manifest.name, f"{manifest.name} requires {required}, which is {other.state}: {other.state_reason}"
                )

    def check_fit(self, manifest: Manifest, plugin_class: type[Plugin]) -> None:
        """Whether a plugin, edited, still fits its requirements, and the plugins that require it.

        Raises:
            PluginError: a level forbids it, or a required plugin does not run.

        """
        self.check_requirements(manifest, plugin_class)
        for user in self.plugins.values():
            if manifest.name in user.manifest.tag.requires and user.plugin_class.level <= plugin_class.level:
                raise level_conflict(user.name, user.plugin_class, manifest.name, plugin_class)

    def request(self, caller: AccessiblePlugin, name: str, interface: type) -> object:
        """Pass a plugin's request for another on to the other, or to a foreign process of that name."""
        if self.foreign is not None and self.is_foreign(name):
            return self.foreign.use(caller.name, caller.plugin_class.level, name, interface)
        return self.get(name).grant(caller, interface)

    def release(self, name: str) -> None:
        """A plugin goes: it holds no other any more."""
        for plugin in self.plugins.values():
            if plugin.exclusive.inside == name:
                plugin.exclusive.inside = ""

    def record_fault(self, plugin: ManagedPlugin) -> None:
        """A plugin has faulted; its users' locks must not be taken from below, so this is seen to later."""
        if plugin not in self.new_faults:
            self.new_faults.append(plugin)

    def is_foreign(self, name: str) -> bool:
        """Whether a foreign process has this name."""
        return self.foreign is not None and name not in self.plugins and name in self.foreign

    def foreign_infos(self) -> list[PluginInfo]:
        """The plugins in separate processes; the robot's plugins come first where names are equal."""
        return [info for info in self.foreign.infos() if info.name not in self.plugins] if self.foreign else []


Requires = Mapping[str, Sequence[str]]
"""For each plugin the names of those that it requires."""


def start_order(requires: Requires) -> tuple[list[str], list[list[str]]]:
    """The plugins, requirements first, and the circles among them, each as the path round.

    >>> start_order({"b": ["a"], "a": []})
    (['a', 'b'], [])
    """
    graph = {name: [each for each in wanted if each in requires] for name, wanted in sorted(requires.items())}
    circles: list[list[str]] = []
    while True:
        try:
            return list(TopologicalSorter(graph).static_order()), circles
        except CycleError as error:
            circle = list(reversed(error.args[1]))
            circles.append(circle)
            for name in circle:
                graph[name] = []


def branch_of(name: str, requires: Requires) -> set[str]:
    """All that a plugin requires, also through others."""
    branch: set[str] = set()
    waiting = list(requires.get(name, ()))
    while waiting:
        required = waiting.pop()
        if required not in branch:
            branch.add(required)
            waiting += requires.get(required, ())
    return branch


def plugin_faults(registry: PluginRegistry) -> list[PluginFault]:
    """The causes for which plugins of a robot do not run, once each, with the plugins that each one affects."""
    causes: dict[ManagedPlugin, list[str]] = defaultdict(list)
    for plugin in registry.plugins.values():
        if plugin.lacks or plugin.state is PluginState.FAULTED:
            root = registry.root_cause(plugin)
            causes[root] += [plugin.name] if root is not plugin else []
    return [
        PluginFault(plugin=root.name, why=cut(root.raised.after(root.state_reason)), dependants=dependants)
        for root, dependants in causes.items()
    ]


def plugin_info(plugin: ManagedPlugin, registry: PluginRegistry) -> PluginInfo:
    """A plugin as `robot/ROBOT/plugins` lists it."""
    code, root_cause = plugin.imported_code, registry.root_cause(plugin)
    return PluginInfo(
        name=plugin.name,
        level=code.plugin_class.level.name.lower() if code is not None else "",
        state=plugin.state.value,
        why=cut(plugin.state_reason + _still_inside(plugin)),
        because_of=root_cause.name if root_cause is not plugin else "",
        needs=plugin.needs,
        where=cut(plugin.raised.where),
        detail=plugin.raised.detail,
        visibility=plugin.manifest.tag.visibility,
        requires=plugin.manifest.tag.requires,
        holder=plugin.exclusive.by,
        period_s=plugin.period_s,
        overruns=plugin.overruns,
        restarts=plugin.restarts,
        doc=(code.plugin_class.__doc__ or "").strip().partition("\n")[0] if code is not None else "",
        functions=[info for each in code.functions.values() for info in each.infos] if code is not None else [],
        task_kind=_announced_kind(plugin),
    )


def _still_inside(plugin: ManagedPlugin) -> str:
    """A note on a thread that is still in a plugin that does not run; empty if there is none."""
    if plugin.state not in (PluginState.FAULTED, PluginState.UNLOADED) or (stuck := plugin.stuck_at()) is None:
        return ""
    where = raised(PluginError(plugin.name, "").with_traceback(stuck)).where
    return f"; its code still runs, at {where}, until the agent ends"


def _announced_kind(plugin: ManagedPlugin) -> TaskKind | None:
    code = plugin.imported_code
    if code is None or code.task_kind is None:
        return None
    settings = zlib.crc32(msgspec.json.encode(plugin.settings, order="deterministic"))
    return msgspec.structs.replace(code.task_kind, settings=settings)
