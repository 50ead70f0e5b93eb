"""Exclusive use of a plugin that is not shared: by one plugin of the robot, or by one caller outside, with a lease.

A holder's name is what the caller says it is: leases keep those who mean well from meddling with each other. Who may
speak to a robot at all is the router's business.
"""

import threading
from typing import Protocol

from robrain.agent.errors import PluginBusy
from robrain.agent.plugin import PluginState
from robrain.protocol.clock import Clock, to_ns
from robrain.protocol.keys import check_name
from robrain.protocol.messages.robots.host_messages import Lease


class ExternalLeases:
    """The leases of one robot. May be used from any thread; a lease that has run out is as none.

    Args:
        clock: the run's clock.

    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._leases: dict[str, Lease] = {}
        """How long each was given for."""

    def take(self, plugin: str, holder: str, lease_s: float) -> Lease:
        """Give a plugin to a holder, from now on for so long; the holder's own lease is renewed by it.

        Raises:
            PluginBusy: another one holds it.
            BadName: the holder's name cannot be one.

        """
        role, _, name = holder.rpartition(":")  # in a secured team: `operator:ann`
        for part in (name, role) if role else (holder,):
            check_name("holder", part)
        with self._lock:
            found = self._valid(plugin)
            if found is not None and found.holder != holder:
                raise PluginBusy(plugin, found.holder)
            lease = Lease(plugin=plugin, holder=holder, until_ns=self._clock.now_ns() + to_ns(lease_s))
            self._leases[plugin] = lease
            return lease

    def release(self, plugin: str, holder: str) -> bool:
        """End a holder's lease; False if it has none."""
        with self._lock:
            found = self._valid(plugin)
            if found is None or found.holder != holder:
                return False
            del self._leases[plugin]
            return True

    def drop(self, plugin: str) -> None:
        """End whatever lease there is: the plugin goes."""
        with self._lock:
            self._leases.pop(plugin, None)

    def holder(self, plugin: str) -> str:
        """Who outside holds a plugin now; empty if nobody does."""
        with self._lock:
            found = self._valid(plugin)
            return found.holder if found is not None else ""

    def _valid(self, plugin: str) -> Lease | None:
        found, now_ns = self._leases.get(plugin), self._clock.now_ns()
        if found is None:
            return None
        if now_ns >= found.until_ns:
            del self._leases[plugin]
            return None
        return found


class User(Protocol):
    """A plugin that uses another."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def state(self) -> PluginState:
        """Its state."""


class ExclusiveUse:
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

    def rival_of(self, by: str) -> str:
        """Who keeps somebody outside from calling the plugin; empty if nobody does."""
        outside = self._leases.holder(self._plugin)
        return self.inside or (outside if outside != by else "")

    def keep(self, user: User, *, granted: bool = False) -> None:
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
            BadName: the holder's name cannot be one.

        """
        with self._deciding:
            if self.inside:
                raise PluginBusy(self._plugin, self.inside)
            return self._leases.take(self._plugin, by, lease_s)
