"""Access control: whether a plugin may be used by another plugin, or called from outside."""

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from robrain.agent.errors import FOREIGN_ERRORS, AccessDenied, PluginBusy, PluginError
from robrain.agent.external import ExternalFunction, find_function
from robrain.agent.manifest import ANYBODY, COMMAND
from robrain.agent.plugin import Plugin
from robrain.agent.plugin_state import PluginState
from robrain.agent.plugin_traceback import log_error
from robrain.protocol.wire.errors import CallError, ErrorCode

if TYPE_CHECKING:
    from robrain.agent.tag import PluginTag

logger = logging.getLogger(__name__)


def check_use(callee: "PluginTag", caller: "PluginTag", interface: type) -> None:
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


def must_merge(name: str, plugin_class: type[Plugin], required: str, required_class: type[Plugin]) -> PluginError:
    """What to tell of a plugin that requires one that is not of a lower level."""
    levels = plugin_class.level.name.lower(), required_class.level.name.lower()
    return PluginError(
        name,
        f"{name} ({levels[0]}) requires {required} ({levels[1]}): "
        f"merge {name} and {required}, calls go to lower levels only",
    )


def check_outside(callee: "PluginTag") -> None:
    """Whether a plugin is open to the outside (AccessDenied if not)."""
    if COMMAND not in callee.manifest.tag.visibility:
        raise AccessDenied(callee.name, f"{callee.name} is not open to the outside")


def external_function(callee: "PluginTag", function: str, held_by: Callable[[], str], by: str) -> ExternalFunction:
    """An external function that somebody outside may call now.

    Args:
        callee: whose function it is.
        function: its external name, or that of one signature.
        held_by: tells who outside holds the plugin, or nothing.
        by: who calls; only that one may call a plugin that it holds.

    Raises:
        CallError: with the code that says why not.

    """
    if COMMAND not in callee.manifest.tag.visibility:
        raise CallError(ErrorCode.FORBIDDEN, f"{callee.name} is not open to the outside")
    if not callee.is_imported:
        raise CallError(ErrorCode.INACTIVE, f"{callee.name} is {callee.state}: {callee.why}")
    functions = callee.code.functions
    known = find_function(functions, function)
    if known is None:
        names = ", ".join(functions) or "none"
        raise CallError(ErrorCode.UNKNOWN_FUNCTION, f"{callee.name} has no function {function}; it has: {names}")
    if callee.state is PluginState.HALTED:
        raise CallError(ErrorCode.HALTED, f"{callee.name} is halted")
    if not callee.manifest.tag.shared:
        outside = held_by()
        holder = callee.holder or (outside if outside != by else "")
        if holder:
            raise CallError(ErrorCode.BUSY, str(PluginBusy(callee.name, holder)), holder)
    return known


def call_from_outside(callee: "PluginTag", known: ExternalFunction, call: Callable[[Plugin], Any]) -> Any:
    """Call a plugin that is live, in its turn unless the function needs none (CallError if it refuses)."""
    try:
        if known.unlocked:
            return call(callee.live_plugin())
        with callee.turn:
            return call(callee.live_plugin())
    except CallError:
        raise
    except PluginError as error:
        raise CallError(error.code, str(error), getattr(error, "holder", "")) from error
    except FOREIGN_ERRORS as error:  # foreign plugin code; the caller and the log both get its traceback
        kind = type(error).__name__
        detail = log_error(logger, f"plugin {callee.name}: {known.name} failed: {kind}", error)
        raise CallError(ErrorCode.FAILED, f"{kind}: {error}", detail) from error


def _offers(own: type, wanted: type) -> bool:
    """By name, not by identity: after a reload the class that a caller knows is another one of the same name."""
    name = (wanted.__module__, wanted.__qualname__)
    return any((base.__module__, base.__qualname__) == name for base in own.__mro__)
