"""Callers and callees: what each sees of the other, and whether the one may use the other or be called from outside."""

from collections.abc import Mapping
from typing import Protocol

from robrain.agent.access.exclusive_use import ExclusiveUse, User
from robrain.agent.access.external_function import ExternalFunction
from robrain.agent.access.turn import PluginLock
from robrain.agent.environment import Environment
from robrain.agent.errors import AccessDenied, ForeignError, PluginError
from robrain.agent.manifest import ANYBODY, COMMAND, Manifest
from robrain.agent.plugin import Level, Plugin


class Caller(User, Protocol):
    """A plugin that calls others."""

    @property
    def plugin_class(self) -> type[Plugin]:
        """Its class."""

    @property
    def environment(self) -> Environment | None:
        """What its instance was given, the one that is there or is being made."""


class Callee(User, Protocol):
    """A plugin that is called."""

    @property
    def why(self) -> str:
        """The reason of its state, in words; may be empty."""

    @property
    def manifest(self) -> Manifest:
        """Its manifest."""

    @property
    def turn(self) -> PluginLock:
        """Its lock."""

    @property
    def plugin_class(self) -> type[Plugin]:
        """Its class (ManifestError if it cannot be imported)."""

    @property
    def functions(self) -> Mapping[str, ExternalFunction] | None:
        """Its external functions by name; None if its class could not be imported."""

    @property
    def exclusive(self) -> ExclusiveUse:
        """Who holds it, if it is not shared."""

    @property
    def callable(self) -> Plugin | None:
        """The instance while it may be called, else None."""

    def live_plugin(self) -> Plugin:
        """The instance, if it may be called now (PluginInactive, PluginUnloaded if not)."""

    def holds(self, environment: Environment) -> bool:
        """Whether the instance that was given this is the one that is there now."""

    def blame(self, error: ForeignError) -> None:
        """Its code has raised this."""


def check_use(callee: Callee, caller: Caller, interface: type) -> None:
    """Whether one plugin may use another by an interface (AccessDenied, saying what speaks against it)."""
    own = callee.plugin_class
    if own.level >= caller.plugin_class.level:
        raise AccessDenied(
            callee.name,
            level_refusal(caller.name, caller.plugin_class.level, callee.name, own.level),
        )
    visible = callee.manifest.tag.visibility
    if caller.name not in visible and ANYBODY not in visible:
        raise AccessDenied(callee.name, f"{caller.name} is not in the visibility of {callee.name}")
    if own.interface is None or not _offers(own.interface, interface):
        offered = own.interface.__name__ if own.interface else "nothing"
        raise AccessDenied(callee.name, f"{callee.name} offers {offered}, not {interface.__name__}")


def level_refusal(caller: str, level: Level, callee: str, callee_level: Level) -> str:
    """Why a plugin may not call one that is not of a lower level, and what makes it possible."""
    if callee_level is Level.BEHAVIOR:  # no level is above it
        advice = f"put what {caller} needs of {callee} into a skill that both use"
    else:
        advice = f"make {caller} a {Level(callee_level + 1).name.lower()}"
    levels = level.name.lower(), callee_level.name.lower()
    return f"{caller} ({levels[0]}) may not call {callee} ({levels[1]}): calls go to lower levels only; {advice}"


def level_conflict(name: str, plugin_class: type[Plugin], required: str, required_class: type[Plugin]) -> PluginError:
    """The error of a plugin that requires one that is not of a lower level."""
    return PluginError(name, level_refusal(name, plugin_class.level, required, required_class.level))


def check_outside(callee: Callee) -> None:
    """Whether a plugin is open to the outside (AccessDenied if not)."""
    if COMMAND not in callee.manifest.tag.visibility:
        raise AccessDenied(callee.name, f"{callee.name} is not open to the outside")


def _offers(own: type, wanted: type) -> bool:
    """By name, not by identity: after a reload the class that a caller knows is another one of the same name."""
    if wanted in own.__mro__:
        return True
    name = (wanted.__module__, wanted.__qualname__)
    return any((base.__module__, base.__qualname__) == name for base in own.__mro__)
