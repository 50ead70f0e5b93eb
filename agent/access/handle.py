"""Handles: all that a plugin ever holds of another."""

from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

from robrain.agent.access.callee import Callee, Caller
from robrain.agent.environment import Environment
from robrain.agent.errors import AccessDenied, PluginUnloaded
from robrain.agent.event import Event, EventView
from robrain.agent.plugin import UNLOCKED_MARK


class Handle:
    """The functions and events of one interface of one plugin, for one caller.

    A call takes the callee's lock, is refused while the callee is not active, and reaches whatever instance of the
    callee is there by then.
    """

    __slots__ = ("__callee", "__caller", "__dict__", "__interface", "__locks", "__user")

    def __init__(self, callee: Callee, interface: type, caller: Caller, *, locks: bool = True) -> None:
        write = object.__setattr__
        write(self, "_Handle__callee", callee)
        write(self, "_Handle__user", caller.environment)
        write(self, "_Handle__caller", caller)
        write(self, "_Handle__interface", interface)
        write(self, "_Handle__locks", locks)

    __callee: Callee
    __caller: Caller
    __interface: type
    __locks: bool
    __user: Environment | None

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{name}: nothing can be written through a handle")

    def __getattr__(self, name: str) -> Any:
        if name[0] == "_" and name.startswith("_Handle__"):  # of a copy that `__init__` never ran for
            raise AttributeError(name)
        callee, interface, user, caller = self.__callee, self.__interface, self.__user, self.__caller
        own = callee.plugin_class.interface  # what the caller shows may be another one of the same name
        if name.startswith("_") or name not in _offered(interface) or own is None or name not in _offered(own):
            raise AccessDenied(callee.name, f"{name} is not in {interface.__name__}, the interface of {callee.name}")
        value = getattr(callee.live_plugin(), name)
        if isinstance(value, Event):
            return EventView(value)
        if not callable(value):
            return value

        if getattr(value, UNLOCKED_MARK, False):
            return lambda *args, **kwargs: getattr(callee.live_plugin(), name)(*args, **kwargs)

        kind = _locked_call if self.__locks else _lockstep_call
        call = self.__dict__[name] = kind(callee, caller, user, name)  # found there from now on
        return call

    def __repr__(self) -> str:
        return f"<handle on {self.__callee.name} as {self.__interface.__name__}>"


def _locked_call(callee: Callee, caller: Caller, user: Environment | None, name: str) -> Callable[..., Any]:
    def call(*args: Any, **kwargs: Any) -> Any:
        turn = callee.turn
        with turn:
            plugin = callee.live_plugin()
            if user is not None:
                if user.has_gone:
                    raise _gone(caller)
                if not callee.manifest.tag.shared:
                    callee.exclusive.keep(caller)
            before, turn.caller = turn.caller, caller.name
            try:
                return getattr(plugin, name)(*args, **kwargs)
            finally:
                turn.caller = before

    return call


def _lockstep_call(callee: Callee, caller: Caller, user: Environment | None, name: str) -> Callable[..., Any]:
    """As `_locked_call`, for one thread: nobody else can be in the plugin."""
    is_gone, own_name = user.gone if user is not None else (), caller.name

    def call(*args: Any, **kwargs: Any) -> Any:
        plugin = callee.callable
        if plugin is None:
            plugin = callee.live_plugin()
        if is_gone:
            raise _gone(caller)
        if not callee.manifest.tag.shared and user is not None and callee.exclusive.inside != own_name:
            callee.exclusive.keep(caller)
        turn = callee.turn
        before, turn.caller = turn.caller, own_name
        turn.depth += 1
        try:
            return getattr(plugin, name)(*args, **kwargs)
        finally:
            turn.depth -= 1
            turn.caller = before

    return call


def _gone(caller: Caller) -> PluginUnloaded:
    return PluginUnloaded(caller.name, f"this instance of {caller.name} has gone")


_offered_by: "WeakKeyDictionary[type, set[str]]" = WeakKeyDictionary()
"""Names in each interface: all robots of a run have the same ones."""


def _offered(interface: type) -> set[str]:
    found = _offered_by.get(interface)
    if found is None:
        found = _offered_by[interface] = _names_in(interface)
    return found


def _names_in(interface: type) -> set[str]:
    # Not hasattr(): a Protocol's own class has `register` and `mro`, which the interface does not offer.
    return {name for base in interface.__mro__ for name in (*vars(base), *vars(base).get("__annotations__", ()))}
