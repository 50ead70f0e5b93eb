"""Who has a plugin that is not shared for themselves: one plugin of the robot, or one caller outside, by a lease."""

import threading
from typing import TYPE_CHECKING

from robrain.agent.errors import PluginBusy
from robrain.agent.leases import ExternalLeases, Lease
from robrain.agent.plugin_state import PluginState

if TYPE_CHECKING:
    from robrain.agent.tag import PluginTag


class Holding:
    """The exclusive use of one plugin; it may be asked for on any thread.

    Args:
        plugin: its name.
        leases: the robot's, of those outside.

    """

    def __init__(self, plugin: str, leases: ExternalLeases) -> None:
        self.inside = ""
        """Who in the robot has it; nobody if empty."""
        self._plugin = plugin
        self._leases = leases
        self._deciding = threading.Lock()

    @property
    def by(self) -> str:
        """Who has it, inside or outside; nobody if empty."""
        return self.inside or self._leases.holder(self._plugin)

    def keep(self, user: "PluginTag", *, granted: bool = False) -> None:
        """Let a plugin that runs, or is granted a handle, have it from now on (PluginBusy if somebody else has)."""
        if self.inside == user.name:
            return
        with self._deciding:
            if self.by:
                raise PluginBusy(self._plugin, self.by)
            if granted or user.state is PluginState.ACTIVE:
                self.inside = user.name

    def lease(self, by: str, lease_s: float) -> Lease:
        """Let somebody outside have it for a time, or longer if they have it.

        Raises:
            PluginBusy: somebody else has it.
            BadName, ValueError: see ExternalLeases.take.

        """
        with self._deciding:
            if self.inside:
                raise PluginBusy(self._plugin, self.inside)
            return self._leases.take(self._plugin, by, lease_s)
