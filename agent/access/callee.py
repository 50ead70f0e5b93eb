"""A plugin as those see it who call it, and as those see it whom it calls."""

from collections.abc import Mapping
from typing import Protocol

from robrain.agent.access.exclusive_use import ExclusiveUse, User
from robrain.agent.access.external_function import ExternalFunction
from robrain.agent.access.turn import Turn
from robrain.agent.environment import Environment
from robrain.agent.errors import ForeignError
from robrain.agent.manifest import Manifest
from robrain.agent.plugin import Plugin


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
    def turn(self) -> Turn:
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

    def live_plugin(self) -> Plugin:
        """The instance, if it may be called now (PluginInactive, PluginUnloaded if not)."""

    def holds(self, environment: Environment) -> bool:
        """Whether the instance that was given this is the one that is there now."""

    def blame(self, error: ForeignError) -> None:
        """Its code has raised this."""
