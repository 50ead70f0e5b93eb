"""The description of a plugin that a robot publishes."""

import zlib

import msgspec

from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.protocol.model.ranges import cut
from robrain.protocol.wire.messages.robots.plugin_messages import PluginInfo, TaskKind


def plugin_info(plugin: ManagedPlugin) -> PluginInfo:
    """A plugin as `robot/ROBOT/plugins` lists it."""
    code = plugin.imported_code
    return PluginInfo(
        name=plugin.name,
        level=code.plugin_class.level.name.lower() if code is not None else "",
        state=plugin.state.value,
        why=cut(plugin.why),
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


def _announced_kind(plugin: ManagedPlugin) -> TaskKind | None:
    code = plugin.imported_code
    if code is None or code.task_kind is None:
        return None
    settings = zlib.crc32(msgspec.json.encode(plugin.settings, order="deterministic"))
    return msgspec.structs.replace(code.task_kind, settings=settings)
