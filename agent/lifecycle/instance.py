"""One instance of a plugin, with all that was made for it."""

from typing import Any

import msgspec

from robrain.agent.environment import Environment
from robrain.agent.event import Event
from robrain.agent.lifecycle.plugin_code import PluginCode
from robrain.agent.plugin import Plugin
from robrain.protocol.wire.endpoint import Endpoint


class Instance(msgspec.Struct, frozen=True, eq=False):
    """One instance of a plugin, with the environment that was made for it.

    What it declares on the wire in `init` stays for as long as the instance, what it declares from `activate` on goes
    with `deactivate`: that is an endpoint of its own.
    """

    code: PluginCode
    plugin: Plugin
    environment: Environment
    wire: Endpoint
    """The endpoint of its `init`."""

    def begin(self, wire: Endpoint) -> None:
        """It is about to be activated, and uses this endpoint from now on."""
        self.end_wire()
        self.environment.wire = wire
        self.environment.begin(self.events())

    def end_wire(self) -> None:
        """It is active no more: close the endpoint of its activation."""
        wire, self.environment.wire = self.environment.wire, self.wire
        if wire is not self.wire:
            wire.close()

    def close(self) -> None:
        """It goes: close everything that was made for it."""
        self.end_wire()
        self.environment.close()

    def take_over(self, other: "Instance") -> None:
        """Have the observers of another instance observe this one: the event objects themselves move."""
        own = self.events()
        for name, event in other.events().items():
            if name in own:
                event.outside = getattr(type(self.plugin), name).outside
                self.plugin.__dict__[name] = event

    def events(self) -> dict[str, Event[Any]]:
        """The instance's own events, by name."""
        return {name: getattr(self.plugin, name) for name in self.code.events}
