"""The plugin manager: the start sequence (figure 3 of the paper), and loads, unloads and reloads while the robot runs.

These run one at a time, and a second one is refused while the first is in progress. No lock is held while plugin code
runs that another load or the host's own step would wait for.
"""

import logging
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import MappingProxyType

from robrain.agent.errors import (
    FOREIGN_ERRORS,
    HostBusy,
    PluginError,
    PluginHung,
    PluginInactive,
    PluginInUse,
    PluginMissing,
    short_path,
)
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.lifecycle.plugin_folders import PluginFolders
from robrain.agent.lifecycle.registry import PluginRegistry
from robrain.agent.lifecycle.starter import Starter
from robrain.agent.lifecycle.transitions import Trigger
from robrain.agent.lifecycle.worker_pool import WorkerPool, run_in_turn
from robrain.agent.manifest import Manifest, read_manifest
from robrain.agent.plugin import Level, PluginState
from robrain.protocol.backoff import backoff_s
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.clock import NS_PER_S, to_ns

FLOOD_DROPS_A_SECOND = 1000
"""A plugin whose notifications overflow others' mailboxes faster than this floods."""
STEADY_S = 60.0
"""A plugin that has run for this long has its restarts forgiven."""
HUNG_PERIOD_NS = to_ns(0.1)


class FaultHandler:
    """Handles faults in the host's own step, where no plugin's lock is held.

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
        self._checked_ns = 0
        self._checked_hung_ns = 0
        self.check_ns = 0
        """When the next `check` has something to do, unless a plugin faults before."""

    def record(self, plugin: ManagedPlugin, now_ns: int) -> None:
        """Handle a fault: set the time of the restart, deactivate the plugin's users, and clean up after it."""
        if self._registry.plugins.get(plugin.name) is not plugin or plugin.state is not PluginState.FAULTED:
            return
        self._schedule_restart(plugin, now_ns)  # first: it is restarted even if a later action fails
        stuck = plugin.turn.owner
        for user in self._registry.users_of(plugin.name):
            if user.state.is_running:
                reason = f"requires {plugin.name}, which is faulted: {plugin.state_reason}"
                try:
                    if stuck is not None and user.turn.owner == stuck:  # it is in a call that does not come back
                        user.apply(Trigger.ABANDON, reason, lacks=plugin.name)
                    else:
                        user.apply(Trigger.DEACTIVATE, reason, lacks=plugin.name)
                except FOREIGN_ERRORS as error:  # foreign plugin code; it may have called a faulted plugin
                    logger.debug("%s: %s while it was deactivated: %s", self._registry.robot, user.name, error)
        plugin.apply(Trigger.CLEAN_UP)

    def _schedule_restart(self, plugin: ManagedPlugin, now_ns: int) -> None:
        policy = plugin.manifest.tag
        plugin.again_ns, plugin.started_ns = None, 0
        if policy.restart == "on-failure" and plugin.attempts < policy.restart_limit:
            plugin.attempts += 1
            plugin.again_ns = now_ns + to_ns(backoff_s(plugin.attempts, policy.backoff_s, policy.backoff_max_s))
            self.check_ns = min(self.check_ns, plugin.again_ns)

    def check(self, now_ns: int) -> None:
        """Restart due plugins; check which hang and which flood."""
        for plugin in self._registry.plugins.values():
            if plugin.again_ns is not None and now_ns >= plugin.again_ns and not self._registry.halted:
                plugin.again_ns = None
                self._later(partial(self._restart, plugin, now_ns))
            elif plugin.started_ns and now_ns - plugin.started_ns > to_ns(STEADY_S):
                plugin.attempts = 0
        has_one_thread = self._registry.has_one_thread  # then no thread is in a plugin now
        if not has_one_thread and now_ns - self._checked_hung_ns >= HUNG_PERIOD_NS:
            self._checked_hung_ns = now_ns
            self._check_hung(now_ns)
        if now_ns - self._checked_ns >= NS_PER_S:
            self._check_floods(now_ns)
        next_ns = self._checked_ns + NS_PER_S if has_one_thread else self._checked_hung_ns + HUNG_PERIOD_NS
        restarts_ns = [each.again_ns for each in self._registry.plugins.values() if each.again_ns is not None]
        self.check_ns = min([next_ns, *restarts_ns])

    def _restart(self, plugin: ManagedPlugin, now_ns: int) -> None:
        if self._registry.plugins.get(plugin.name) is not plugin or plugin.state is not PluginState.FAULTED:
            return
        plugin.restarts += 1
        plugin.started_ns = now_ns
        self._begin(plugin)
        if not plugin.state.is_running:
            self._registry.record_fault(plugin)
            return
        logger.warning("%s: plugin %s is restarted (%d)", self._registry.robot, plugin.name, plugin.restarts)

    def _check_hung(self, now_ns: int) -> None:
        overdue = [
            plugin for plugin in self._registry.plugins.values() if plugin.turn.depth and plugin.turn.is_overdue(now_ns)
        ]
        if overdue and not any(plugin.turn.compiles for plugin in overdue):
            # The lowest one hangs; those above it are in a call to it, and are deactivated as its users.
            plugin = min(overdue, key=lambda plugin: plugin.level)
            error = PluginHung(plugin.name, f"{plugin.name} has not come back for {plugin.turn.limit_s:g} s")
            plugin.fault(error.with_traceback(plugin.stuck_at()))

    def _check_floods(self, now_ns: int) -> None:
        elapsed_s = (now_ns - self._checked_ns) / NS_PER_S
        self._checked_ns = now_ns
        for plugin in self._registry.plugins.values():
            dropped = 0
            for event in plugin.events().values():
                dropped += event.dropped
            before, plugin.drops_seen = plugin.drops_seen, dropped
            if dropped - before > FLOOD_DROPS_A_SECOND * elapsed_s:
                plugin.fault(
                    PluginError(plugin.name, f"{plugin.name} floods: {dropped - before} notifications were lost")
                )


logger = logging.getLogger(__name__)

CHECK_TIMEOUT_S = 10.0
"""How long, in live, a load waits for the host's own look at faults, which is mostly over at once."""


class PluginManager:
    """Starts, loads, unloads, reloads, halts and stops the plugins of one robot.

    Args:
        registry: knows the robot's plugins.
        guard: counts faults that could not be handled.

    """

    def __init__(self, registry: PluginRegistry, guard: RecordGuard) -> None:
        self.robot = registry.robot
        self.registry = registry
        self._guard = guard
        self._starter = Starter(self.registry)
        self.faults = FaultHandler(self.registry, self._starter.begin, self.later)
        self._folders = PluginFolders([])
        self._changing = threading.Lock()
        """Held by a load, unload, reload or restart."""
        self._settling = threading.Lock()
        """Held by these as well, and by `settle`."""
        self._begins_lacking = False
        """Whether plugins that lacked another are about to be started: one thread waits for that, not one a fault."""
        self._stopped = False

    @property
    def plugins(self) -> dict[str, ManagedPlugin]:
        """The plugins by name, requirements before those that require them; replaced, never changed."""
        return self.registry.plugins

    @property
    def halted(self) -> bool:
        """Whether an emergency halt is in force."""
        return self.registry.halted

    def get(self, name: str) -> ManagedPlugin:
        """The plugin of a name (PluginMissing if there is none)."""
        return self.registry.get(name)

    def discover(
        self,
        places: Iterable[Path],
        wanted: list[str] | None = None,
        known: dict[Path, list[Path]] | None = None,
        roles: Mapping[str, str] = MappingProxyType({}),
    ) -> list[str]:
        """Find each manifest in the places; of two with one name the later place wins.

        Args:
            places: folders.
            wanted: names to take; all if None. Required plugins are loaded as well.
            known: files of folders that were read before, to which others are added.
            roles: by plugin: the one whose manifest replaces it.

        Returns:
            The names of all plugins that were found.

        Raises:
            ManifestError: a manifest is wrong.
            PluginMissing: a wanted plugin, or one that is to take a role, is in no place.

        """
        self._folders = PluginFolders(places, roles)
        found = self._folders.find(known)
        names = sorted(found) if wanted is None else list(wanted)
        plugins: dict[str, ManagedPlugin] = {}
        while names:
            name = names.pop(0)
            if name in plugins:
                continue
            if name not in found:
                raise PluginMissing(name, f"no plugin {name} in any place; there are: {', '.join(sorted(found))}")
            plugins[name] = plugin = ManagedPlugin(read_manifest(found[name]), self.registry)
            if wanted is not None:
                names += [required for required in plugin.manifest.tag.requires if required in found]
        self.registry.plugins = plugins
        return sorted(found)

    def start(self) -> None:
        """Load and initialise each plugin, then activate each, requirements first.

        A plugin that cannot start is skipped with the reason, with all that require it; the rest continues.
        """
        self._starter.start_all()

    def stop(self) -> None:
        """Deactivate all, users before their providers, and close their resources."""
        self._stopped = True
        for plugin in reversed(self.plugins.values()):
            try:
                plugin.apply(Trigger.DEACTIVATE)
            except FOREIGN_ERRORS as error:
                # Foreign plugin code; the others must still be stopped. In a halted robot plugins refuse each
                # other, which is as it should be.
                if not (isinstance(error, PluginInactive) and self.halted):
                    logger.exception("%s: plugin %s failed while it was stopped", self.robot, plugin.name)
        for plugin in self.plugins.values():
            plugin.apply(Trigger.CLOSE)

    def load(self, name_or_path: str, within: Iterable[Path] | None = None) -> list[ManagedPlugin]:
        """Load and activate a plugin, with all that it requires, and all that were skipped for lack of these.

        Args:
            name_or_path: a name in the robot's places, or the path of a manifest or of a folder with one or more.
            within: folders, besides the places, that a path must lie in; None allows any path and is only for callers
                in this process.

        Returns:
            The plugins that were loaded.

        Raises:
            AccessDenied: the path is outside all of these folders.
            PluginMissing, ManifestError, PluginError: loading failed; nothing stays loaded then.
            HostBusy: another load, unload or reload is in progress.

        """
        with self._alone():
            wanted = {manifest.name: manifest for manifest in self._folders.manifests_of(name_or_path, within)}
            fresh: dict[str, ManagedPlugin] = {}
            before = self.plugins
            try:
                for manifest in wanted.values():
                    self._load_one(manifest, fresh, wanted, ())
            except BaseException:
                for plugin in reversed(fresh.values()):
                    self._end(plugin)
                self.registry.plugins = before
                raise
            for name in fresh.keys() & before.keys():
                before[name].unload()
            return [*fresh.values(), *self._starter.begin_lacking()]

    def unload(self, name: str, *, cascade: bool = False) -> list[ManagedPlugin]:
        """Unload a plugin, with `cascade` also those that require it.

        Returns:
            The plugins that were unloaded, in that order.

        Raises:
            PluginInUse: others require it.
            PluginMissing: there is none of that name.
            HostBusy: another load, unload or reload is in progress.

        """
        with self._alone():
            plugin = self.get(name)
            users = self.registry.users_of(name)
            if users and not cascade:
                raise PluginInUse(name, [user.name for user in users])
            going = [*users, plugin]
            for each in going:
                self._end(each)
            return going

    def reload(self, name: str) -> ManagedPlugin:
        """Take a plugin's manifest and code again from disk; if that fails the old one keeps running.

        Raises:
            PluginError: why it failed.
            HostBusy: another load, unload or reload is in progress.

        """
        with self._alone():
            plugin = self.get(name)
            manifest = read_manifest(plugin.manifest.path)
            was_running = plugin.state.is_running
            try:
                self._starter.replace(plugin, manifest)
            except PluginError:
                raise
            except FOREIGN_ERRORS as error:  # foreign plugin code
                raise PluginError(name, f"{name} keeps running as it was: {type(error).__name__}: {error}") from error
            self._starter.sort()
            if not was_running:
                plugin.again_ns, plugin.attempts = None, 0
                self._starter.begin_lacking()
            return plugin

    def settle(self, now_ns: int) -> None:
        """Handle faults: their dependants, restarts, plugins that hang or flood. The host does this in its step."""
        if not self._settling.acquire(blocking=False):
            return
        try:
            self._see_to_faults(now_ns)
            self.faults.check(now_ns)
            if self.registry.newly_running and not (self.halted or self._begins_lacking):
                self.registry.newly_running = False
                self._begins_lacking = any(plugin.lacks for plugin in self.plugins.values())
                if self._begins_lacking:
                    self.later(self._begin_lacking)
        finally:
            self._settling.release()

    def later(self, do: Callable[[], object]) -> None:
        """Have something done alone that may take its time; in live not on the host's own thread."""
        pool = self.registry.starters
        if pool is None:
            do()
        else:
            pool.begin(partial(self._do_alone, do))

    def halt(self, pool: WorkerPool | None = None) -> list[str]:
        """Emergency halt; latches until `resume`: all plugins refuse calls, then devices stop, then the levels above.

        Args:
            pool: halts the plugins of a level in parallel and continues without those that hang; without it they are
                halted one after another.

        Returns:
            The names of those that failed, or have not come back in time.

        """
        self.registry.halted = True
        self.registry.halts += 1
        plugins = list(self.plugins.values())
        for plugin in plugins:
            plugin.refuse_calls()
        busy = [plugin for plugin in plugins if plugin.turn.owner is not None]
        failed: dict[str, BaseException] = {}
        for level in Level:
            calls = {plugin.name: plugin.halt for plugin in plugins if plugin.level is level}
            # Foreign code may hang. Where a plugin has none there is nothing to wait for, and no thread is needed.
            own = {plugin.name for plugin in plugins if plugin.halts_itself} if pool is not None else set()
            failed |= run_in_turn({name: call for name, call in calls.items() if name not in own})
            if pool is not None:
                failed |= pool.run({name: call for name, call in calls.items() if name in own})
        if pool is not None:
            for plugin in busy:
                pool.begin(partial(_halt_again, plugin, self.registry))
        for name, error in failed.items():
            logger.error("%s: plugin %s failed while it was halted: %s", self.robot, name, error, exc_info=error)
        return list(failed)

    def most_to_halt(self) -> int:
        """How many plugins of one level stop something by themselves in an emergency halt, at the most."""
        levels = [plugin.level for plugin in self.plugins.values() if plugin.halts_itself]
        return max(map(levels.count, Level))

    def resume(self) -> None:
        """End an emergency halt."""
        self.registry.halted = False
        for plugin in self.plugins.values():
            plugin.apply(Trigger.RESUME)

    @contextmanager
    def _alone(self) -> Iterator[None]:
        busy = HostBusy("", f"{self.robot} is busy with another load, unload or reload: try again")
        if not self._changing.acquire(blocking=False):
            raise busy
        try:
            # In lockstep it is this thread that settles, and then waiting would not help.
            if not self._settling.acquire(timeout=CHECK_TIMEOUT_S if self.registry.is_live else 0.0):
                raise busy
            try:
                self._see_to_faults(self.registry.clock.now_ns())
                yield
            finally:
                self._settling.release()
        finally:
            self._changing.release()

    def _do_alone(self, do: Callable[[], object]) -> None:
        with self._changing, self._settling:
            if not self._stopped:
                do()

    def _begin_lacking(self) -> None:
        self._begins_lacking = False
        self._starter.begin_lacking()

    def _see_to_faults(self, now_ns: int) -> None:
        new_faults = self.registry.new_faults
        faulted = [new_faults.popleft() for _ in range(len(new_faults))]
        self._guard.records(
            faulted, lambda plugin: self.faults.record(plugin, now_ns), lambda plugin: plugin.name, "fault"
        )

    def _load_one(
        self, manifest: Manifest, fresh: dict[str, ManagedPlugin], wanted: Mapping[str, Manifest], users: Sequence[str]
    ) -> None:
        registry, name = self.registry, manifest.name
        if name in fresh:
            return
        path = (*users, name)
        if name in users:
            raise PluginError(users[0], f"{name} requires itself: {' → '.join(path[users.index(name) :])}")
        before = self.plugins.get(name)
        if before is not None and before.state is not PluginState.FAULTED:
            raise PluginError(
                name,
                f"{name} is loaded already, from {short_path(before.manifest.path)}: reload it, or unload it first",
            )
        plugin = ManagedPlugin(manifest, registry)
        for required in manifest.tag.requires:
            other = self.plugins.get(required)
            if (other is None or other.state is PluginState.FAULTED) and not registry.is_foreign(required):
                there = wanted.get(required) or self._folders.read(required)
                if there is None:
                    missing = " → ".join([*path, required])
                    raise PluginMissing(required, f"{name} requires {required}, which is in no place ({missing})")
                self._load_one(there, fresh, wanted, path)
        registry.check_requirements(manifest, plugin.plugin_class)
        fresh[name] = plugin
        registry.plugins = {**self.plugins, name: plugin}
        self._starter.sort()
        if name in self.plugins and plugin.state is PluginState.FAULTED:
            raise PluginError(name, f"{name}: {plugin.state_reason}")
        try:
            self._starter.start(plugin)
        except PluginError:
            raise
        except FOREIGN_ERRORS as error:  # foreign plugin code
            raise PluginError(name, f"{name} cannot be started: {type(error).__name__}: {error}") from error

    def _end(self, plugin: ManagedPlugin) -> None:
        try:
            plugin.unload()
        except FOREIGN_ERRORS:
            # Foreign plugin code; the plugin goes nevertheless.
            logger.exception("%s: plugin %s failed while it was unloaded", self.robot, plugin.name)
        self.registry.remove(plugin)


def _halt_again(plugin: ManagedPlugin, registry: PluginRegistry) -> None:
    """Once more, after the last caller has left the plugin: its last actions may have undone the halt."""
    turn = plugin.turn
    if not turn.acquire(plugin.manifest.tag.hang_s):
        return  # it hangs, and is faulted for it
    turn.release()
    if plugin.state is PluginState.HALTED and plugin.turn is turn:
        plugin.halt()
        if not registry.halted:  # it was resumed at this very moment
            plugin.apply(Trigger.RESUME)
