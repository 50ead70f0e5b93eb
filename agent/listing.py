"""What the host tells of a plugin."""

from typing import TYPE_CHECKING

from robrain.protocol.model.ranges import cut
from robrain.protocol.wire.messages import PluginInfo

if TYPE_CHECKING:
    from robrain.agent.tag import PluginTag


def plugin_info(tag: "PluginTag") -> PluginInfo:
    """One plugin as `robot/ROBOT/plugins` lists it."""
    known = tag.code if tag.is_imported else None
    return PluginInfo(
        name=tag.name,
        level=known.plugin_class.level.name.lower() if known is not None else "",
        state=tag.state.value,
        why=cut(tag.why),
        where=cut(tag.raised.where),
        detail=tag.raised.detail,
        visibility=tag.manifest.tag.visibility,
        requires=tag.manifest.tag.requires,
        holder=tag.held_by,
        period_s=tag.period_s,
        overruns=tag.overruns,
        restarts=tag.restarts,
        doc=(known.plugin_class.__doc__ or "").strip().partition("\n")[0] if known is not None else "",
        functions=[info for each in known.functions.values() for info in each.infos] if known is not None else [],
    )
