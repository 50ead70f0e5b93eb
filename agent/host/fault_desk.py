"""Faults stay where they are: what becomes of a plugin that raises, hangs or floods, and of those that require it."""

import logging
from collections.abc import Callable
from functools import partial

import msgspec

from robrain.agent.errors import FOREIGN_ERRORS, PluginError, PluginHung
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.lifecycle.registry import PluginRegistry
from robrain.agent.lifecycle.transitions import Trigger
from robrain.agent.plugin import PluginState
from robrain.protocol.wire.clock import NS_PER_S, to_ns

logger = logging.getLogger(__name__)

FLOOD_DROPS_A_SECOND = 1000
"""A plugin whose notifications overflow others' mailboxes faster than this floods."""
STEADY_S = 60.0
"""A plugin that has run for so long has its restarts forgiven."""
DOUBLINGS = 64
"""More of them make no difference."""
HUNG_PERIOD_NS = to_ns(0.1)


class _Case(msgspec.Struct):
    """A plugin that has faulted, and when it is started again."""

    plugin: ManagedPlugin
    again_ns: int | None
    started_ns: int = 0
    attempts: int = 0


class FaultDesk:
    """Sees to faults in the host's own step, where no plugin's lock is held.

    Args:
        registry: of the robot's plugins.
        begin: starts a plugin that is listed but does not run.
        later: has something done alone that may take its time.

    """

    def __init__(
        self,
        registry: PluginRegistry,
        begin: Callable[[ManagedPlugin], None],
        later: Callable[[Callable[[], None]], None],
    ) -> None:
        self._registry = registry
        self._begin = begin
        self._later = later
        self._cases: dict[str, _Case] = {}
        self._drops: dict[str, int] = {}
        self._looked_ns = 0
        self._looked_hung_ns = 0
        self.look_ns = 0
        """When the next `look` has something to do, unless a plugin faults before."""

    def note(self, plugin: ManagedPlugin, now_ns: int) -> None:
        """A plugin has faulted: deactivate its users, let it clean up, and set the time of its restart."""
        if self._registry.plugins.get(plugin.name) is not plugin or plugin.state is not PluginState.FAULTED:
            return
        stuck = plugin.turn.owner
        for user in self._registry.users_of(plugin.name):
            if user.state.is_running:
                why = f"requires {plugin.name}, which is faulted: {plugin.why}"
                try:
                    if stuck is not None and user.turn.owner == stuck:  # it is in a call that does not come back
                        user.apply(Trigger.ABANDON, why, lacks=plugin.name)
                    else:
                        user.apply(Trigger.DEACTIVATE, why, lacks=plugin.name)
                except FOREIGN_ERRORS as error:  # foreign plugin code; it may have called what has faulted
                    logger.debug("%s: %s while it was deactivated: %s", self._registry.robot, user.name, error)
        plugin.apply(Trigger.CLEAN_UP)
        policy = plugin.manifest.tag
        case = self._cases.get(plugin.name)
        attempts = case.attempts if case is not None and case.plugin is plugin else 0
        if policy.restart != "on-failure" or attempts >= policy.restart_limit:
            self._cases[plugin.name] = _Case(plugin, None, attempts=attempts)
            return
        # 2.0 to the power of a thousand restarts has no place in a float.
        wait_s = min(policy.backoff_s * 2.0 ** min(attempts, DOUBLINGS), policy.backoff_max_s)
        again_ns = now_ns + to_ns(wait_s)
        self._cases[plugin.name] = _Case(plugin, again_ns, attempts=attempts + 1)
        self.look_ns = min(self.look_ns, again_ns)

    def forget(self, plugin: ManagedPlugin) -> None:
        """A plugin is loaded again by hand, or has gone."""
        self._cases.pop(plugin.name, None)
        self._drops.pop(plugin.name, None)

    def look(self, now_ns: int) -> None:
        """Restart what is due; see who hangs and who floods."""
        for case in list(self._cases.values()):
            if case.again_ns is not None and now_ns >= case.again_ns and not self._registry.halted:
                case.again_ns = None
                self._later(partial(self._restart, case, now_ns))
            elif case.started_ns and now_ns - case.started_ns > to_ns(STEADY_S):
                case.attempts = 0
        if now_ns - self._looked_hung_ns >= HUNG_PERIOD_NS:
            self._looked_hung_ns = now_ns
            self._look_for_hung(now_ns)
        if now_ns - self._looked_ns >= NS_PER_S:
            self._look_for_floods(now_ns)
        restarts_ns = [case.again_ns for case in self._cases.values() if case.again_ns is not None]
        self.look_ns = min([self._looked_hung_ns + HUNG_PERIOD_NS, *restarts_ns])

    def _restart(self, case: _Case, now_ns: int) -> None:
        plugin = case.plugin
        if self._registry.plugins.get(plugin.name) is not plugin or plugin.state is not PluginState.FAULTED:
            return
        plugin.restarts += 1
        case.started_ns = now_ns
        self._begin(plugin)
        if not plugin.state.is_running:
            self._registry.note_fault(plugin)
            return
        logger.warning("%s: plugin %s is restarted (%d)", self._registry.robot, plugin.name, plugin.restarts)

    def _look_for_hung(self, now_ns: int) -> None:
        overdue = [
            plugin for plugin in self._registry.plugins.values() if plugin.turn.depth and plugin.turn.is_overdue(now_ns)
        ]
        if overdue and not any(plugin.turn.compiles for plugin in overdue):
            # The lowest one hangs; those above it are in a call to it, and are deactivated as its users.
            plugin = min(overdue, key=lambda plugin: plugin.level)
            error = PluginHung(plugin.name, f"{plugin.name} has not come back for {plugin.turn.limit_s:g} s")
            plugin.fault(error.with_traceback(plugin.stuck_at()))

    def _look_for_floods(self, now_ns: int) -> None:
        elapsed_s = (now_ns - self._looked_ns) / NS_PER_S
        self._looked_ns = now_ns
        for plugin in self._registry.plugins.values():
            dropped = 0
            for event in plugin.events().values():
                dropped += event.dropped
            before = self._drops.get(plugin.name, 0)
            self._drops[plugin.name] = dropped
            if dropped - before > FLOOD_DROPS_A_SECOND * elapsed_s:
                plugin.fault(
                    PluginError(plugin.name, f"{plugin.name} floods: {dropped - before} notifications were lost")
                )
