"""The descriptions of plugins, and of those that do not run, that a robot publishes."""

import zlib
from collections import defaultdict

import msgspec

from robrain.agent.errors import PluginError
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.lifecycle.registry import PluginRegistry
from robrain.agent.plugin import PluginState
from robrain.agent.plugin_traceback import where_raised
from robrain.protocol.messages.robots.plugin_messages import PluginInfo, TaskKind
from robrain.protocol.messages.robots.robot_messages import PluginFault
from robrain.protocol.model.ranges import cut


def plugin_faults(registry: PluginRegistry) -> list[PluginFault]:
    """The causes for which plugins of a robot do not run, once each, with the plugins that each one affects."""
    causes: dict[ManagedPlugin, list[str]] = defaultdict(list)
    for plugin in registry.plugins.values():
        if plugin.lacks or plugin.state is PluginState.FAULTED:
            root = registry.root_cause(plugin)
            causes[root] += [plugin.name] if root is not plugin else []
    return [
        PluginFault(plugin=root.name, why=cut(root.raised.after(root.why)), dependants=dependants)
        for root, dependants in causes.items()
    ]


def plugin_info(plugin: ManagedPlugin, registry: PluginRegistry) -> PluginInfo:
    """A plugin as `robot/ROBOT/plugins` lists it."""
    code, root_cause = plugin.imported_code, registry.root_cause(plugin)
    return PluginInfo(
        name=plugin.name,
        level=code.plugin_class.level.name.lower() if code is not None else "",
        state=plugin.state.value,
        why=cut(plugin.why + _still_inside(plugin)),
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
    where = where_raised(PluginError(plugin.name, "").with_traceback(stuck))
    return f"; its code still runs, at {where}, until the agent ends"


def _announced_kind(plugin: ManagedPlugin) -> TaskKind | None:
    code = plugin.imported_code
    if code is None or code.task_kind is None:
        return None
    settings = zlib.crc32(msgspec.json.encode(plugin.settings, order="deterministic"))
    return msgspec.structs.replace(code.task_kind, settings=settings)
