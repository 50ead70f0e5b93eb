"""Handles: all that a plugin ever holds of another."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from robrain.agent.errors import AccessDenied, PluginUnloaded
from robrain.agent.event import Event, EventView
from robrain.agent.plugin import UNLOCKED_MARK

if TYPE_CHECKING:
    from robrain.agent.tag import PluginTag


class Handle:
    """The functions and events of one interface of one plugin, for one caller.

    Made by the caller's tag. A call takes the callee's lock, is refused while the callee is not active, and
    reaches whatever instance the callee's tag holds by then.
    """

    __slots__ = ("__caller", "__calls", "__interface", "__tag", "__user")

    def __init__(self, tag: "PluginTag", interface: type, caller: "PluginTag") -> None:
        self.__tag = tag
        self.__user = caller.environment
        self.__caller = caller
        self.__interface = interface
        self.__calls: dict[str, Callable[..., Any]] = {}

    def __getattr__(self, name: str) -> Any:
        if name[0] == "_" and name.startswith("_Handle__"):  # of a copy that was never made by a tag
            raise AttributeError(name)
        calls = self.__calls
        if name in calls:
            return calls[name]
        tag, interface, user, caller = self.__tag, self.__interface, self.__user, self.__caller
        own = tag.plugin_class.interface  # what the caller shows may be another one of the same name
        if name.startswith("_") or name not in _offered(interface) or own is None or name not in _offered(own):
            raise AccessDenied(tag.name, f"{name} is not in {interface.__name__}, the interface of {tag.name}")
        value = getattr(tag.live_plugin(), name)
        if isinstance(value, Event):
            return EventView(value)
        if not callable(value):
            return value

        if getattr(value, UNLOCKED_MARK, False):
            return lambda *args, **kwargs: getattr(tag.live_plugin(), name)(*args, **kwargs)

        def call(*args: Any, **kwargs: Any) -> Any:
            with tag.turn:
                plugin = tag.live_plugin()
                if user is not None:
                    if user.has_gone:
                        raise PluginUnloaded(caller.name, f"this instance of {caller.name} has gone")
                    if not tag.manifest.tag.shared:
                        tag.keep(caller)
                return getattr(plugin, name)(*args, **kwargs)

        calls[name] = call
        return call

    def __repr__(self) -> str:
        return f"<handle on {self.__tag.name} as {self.__interface.__name__}>"


def _offered(interface: type) -> set[str]:
    # Not hasattr(): a Protocol's own class has `register` and `mro`, which the interface does not offer.
    return {name for base in interface.__mro__ for name in (*vars(base), *vars(base).get("__annotations__", ()))}
