"""Access rules: whether a plugin may be used by another plugin, or called from outside."""

from robrain.agent.access.callee import Callee, Caller
from robrain.agent.errors import AccessDenied, PluginError
from robrain.agent.manifest import ANYBODY, COMMAND
from robrain.agent.plugin import Plugin


def check_use(callee: Callee, caller: Caller, interface: type) -> None:
    """Whether one plugin may use another by an interface (AccessDenied, saying what speaks against it)."""
    own = callee.plugin_class
    if own.level >= caller.plugin_class.level:
        raise AccessDenied(
            callee.name,
            f"{caller.name} ({caller.plugin_class.level.name.lower()}) may not call {callee.name} "
            f"({own.level.name.lower()}): calls go to lower levels only; merge {caller.name} and {callee.name}",
        )
    visible = callee.manifest.tag.visibility
    if caller.name not in visible and ANYBODY not in visible:
        raise AccessDenied(callee.name, f"{caller.name} is not in the visibility of {callee.name}")
    if own.interface is None or not _offers(own.interface, interface):
        offered = own.interface.__name__ if own.interface else "nothing"
        raise AccessDenied(callee.name, f"{callee.name} offers {offered}, not {interface.__name__}")


def level_conflict(name: str, plugin_class: type[Plugin], required: str, required_class: type[Plugin]) -> PluginError:
    """What to tell of a plugin that requires one that is not of a lower level."""
    levels = plugin_class.level.name.lower(), required_class.level.name.lower()
    return PluginError(
        name,
        f"{name} ({levels[0]}) requires {required} ({levels[1]}): "
        f"merge {name} and {required}, calls go to lower levels only",
    )


def check_outside(callee: Callee) -> None:
    """Whether a plugin is open to the outside (AccessDenied if not)."""
    if COMMAND not in callee.manifest.tag.visibility:
        raise AccessDenied(callee.name, f"{callee.name} is not open to the outside")


def _offers(own: type, wanted: type) -> bool:
    """By name, not by identity: after a reload the class that a caller knows is another one of the same name."""
    name = (wanted.__module__, wanted.__qualname__)
    return any((base.__module__, base.__qualname__) == name for base in own.__mro__)
