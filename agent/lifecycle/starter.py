"""The start of plugins: all that can start do; the others are skipped with the reason, with all that require them."""

import logging
from collections.abc import Callable
from enum import Enum, auto

from robrain.agent.errors import (
    FOREIGN_ERRORS,
    ForeignError,
    HardwareAbsent,
    ManifestError,
    PackageMissing,
    PluginError,
    PluginHung,
    PluginInactive,
)
from robrain.agent.lifecycle.access import level_conflict
from robrain.agent.lifecycle.instance import Instance
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.lifecycle.plugin_code import import_code
from robrain.agent.lifecycle.registry import PluginRegistry, start_order
from robrain.agent.lifecycle.transitions import Trigger
from robrain.agent.lifecycle.worker_pool import NotBack
from robrain.agent.manifest import Manifest
from robrain.agent.plugin import Plugin, PluginState
from robrain.agent.plugin_traceback import log_error

CheckFit = Callable[[Manifest, type[Plugin]], None]
"""Whether the edited plugin still fits in with the others; raises PluginError if not."""


class _Stage(Enum):
    """Which foreign code is running."""

    MAKING = auto()
    """The new one is imported, made, initialised."""
    LEAVING = auto()
    """The old one is deactivated."""
    STARTING = auto()
    """The new one is activated."""
    DONE = auto()
    GIVEN_UP = auto()


class Replacement:
    """Replaces the instance of one plugin.

    Args:
        plugin: plugin of the instance.
        manifest: the plugin's, read again.
        check: whether the edited plugin fits in.
        live: as in `import_code`.

    """

    def __init__(self, plugin: ManagedPlugin, manifest: Manifest, check: CheckFit, *, live: bool) -> None:
        self._plugin = plugin
        self._manifest = manifest
        self._check = check
        self._live = live
        self._old = plugin.instance
        self._old_code = plugin.imported_code
        self._old_manifest = plugin.manifest
        self._before, self._reason = plugin.state, plugin.state_reason
        self._stage = _Stage.MAKING

    def run(self) -> None:
        """Make the new instance and have it take the old one's place; handles and observers follow.

        Raises:
            PluginError, Exception: why it failed; the old one keeps running then.

        """
        code = import_code(self._manifest, fresh=True, live=self._live)
        self._check(self._manifest, code.plugin_class)
        fresh = self._plugin.create(self._manifest, code, replaces=self._old)
        try:
            with self._plugin.turn:
                self._hand_over(fresh)
        except BaseException:
            if self._stage is not _Stage.GIVEN_UP:
                fresh.close()
            raise
        finally:
            if self._stage is not _Stage.GIVEN_UP:
                self._stage = _Stage.DONE
        if self._old is not None:
            self._old.close()

    def give_up(self, reason: str) -> Callable[[], None]:
        """A thread is stuck in the new instance: abandon it and restore the old one in its place.

        Args:
            reason: the reason, for a plugin that has no instance then: they are stuck in the old one.

        Returns:
            The remaining work, which may be slow.

        """
        stage, self._stage = self._stage, _Stage.GIVEN_UP
        plugin = self._plugin
        if stage in (_Stage.LEAVING, _Stage.DONE):
            plugin.apply(Trigger.ABANDON, reason)
        elif stage is _Stage.MAKING:
            plugin.leave_new()
            if self._old is not None:
                self._old.take_over(self._old)
                plugin.environment = self._old.environment
        else:
            self._put_back(Trigger.REJECT_STUCK)
            return self._start_old
        return lambda: None

    def _hand_over(self, fresh: Instance) -> None:
        plugin = self._plugin
        self._stage = _Stage.LEAVING
        try:
            plugin.apply(Trigger.DEACTIVATE, "it is being reloaded")
        except FOREIGN_ERRORS:
            # Foreign plugin code, which is about to be replaced.
            logger.exception("plugin %s failed while it was reloaded", plugin.name)
        plugin.swap(fresh, self._manifest, fresh.code)
        plugin.apply(Trigger.REACTIVATE, plugin.state_reason)
        self._stage = _Stage.STARTING
        try:
            plugin.activate()
        except BaseException:
            if self._stage is not _Stage.GIVEN_UP:
                self._put_back(Trigger.REJECT)
                self._start_old()
            raise

    def _put_back(self, trigger: Trigger) -> None:
        """End the new instance and have the old one again, in the state that it was in if that is not to be started."""
        plugin, old = self._plugin, self._old
        plugin.apply(trigger, self._reason)
        plugin.swap(old, self._old_manifest, self._old_code)
        if old is not None:
            old.take_over(old)
        if self._before is PluginState.FAULTED:
            plugin.apply(Trigger.LEAVE_OUT, self._reason)

    def _start_old(self) -> None:
        if self._old is None or not self._before.is_running:
            return
        try:
            self._plugin.activate()
        except FOREIGN_ERRORS as error:  # foreign plugin code
            self._plugin.fault(error)


logger = logging.getLogger(__name__)

GiveUp = Callable[[str], Callable[[], None]]
"""Leaves a hanging instance to the caller that is stuck in it, for that reason; returns the remaining work, which may
be slow."""


class Starter:
    """Starts the plugins of one robot."""

    def __init__(self, registry: PluginRegistry) -> None:
        self._registry = registry

    def start_all(self) -> None:
        """Load each plugin, then activate each, requirements first."""
        self.sort()
        for plugin in self._registry.plugins.values():
            self._attempt(plugin, plugin.load)
        for plugin in self._registry.plugins.values():
            self._attempt(plugin, plugin.activate)

    def start(self, plugin: ManagedPlugin) -> None:
        """Start a plugin, and do not leave it out if that fails.

        Raises:
            Exception: why it failed; PluginHung if it does not come back, and is abandoned.

        """
        self._in_time(plugin, plugin.load, None)
        self._in_time(plugin, plugin.activate, None)

    def begin(self, plugin: ManagedPlugin) -> None:
        """Start a plugin that is listed but does not run; if that fails it is skipped with the reason."""
        if plugin.instance is not None:
            plugin.apply(Trigger.REACTIVATE)
        else:
            plugin.apply(Trigger.RESTART)
            self._attempt(plugin, plugin.load)
        self._attempt(plugin, plugin.activate)

    def replace(self, plugin: ManagedPlugin, manifest: Manifest) -> None:
        """Take a new instance, made from the manifest and code as they are now on disk, in place of the old.

        Raises:
            Exception: why it failed; the old one keeps running then.

        """
        registry = self._registry
        replacement = Replacement(plugin, manifest, registry.check_fit, live=registry.is_live)
        self._in_time(plugin, replacement.run, replacement.give_up)

    def begin_lacking(self) -> list[ManagedPlugin]:
        """Start each plugin that does not run for lack of another, if all that it requires runs now.

        Returns:
            Those that were started.

        """
        is_running, begun = self._registry.is_running, []
        for plugin in list(self._registry.plugins.values()):  # requirements first
            if plugin.lacks and is_running(plugin.lacks) and all(map(is_running, plugin.manifest.tag.requires)):
                self.begin(plugin)
                if plugin.state.is_running:
                    begun.append(plugin)
        return begun

    def sort(self) -> None:
        """Find the start order again, and skip plugins that require themselves or cannot be imported."""
        registry = self._registry
        for plugin in registry.plugins.values():
            if plugin.state is PluginState.DISCOVERED:
                self._import_class(plugin)
        order, circles = start_order(registry.requirements())
        for circle in circles:
            for name in circle:
                registry.plugins[name].apply(Trigger.LEAVE_OUT, f"requires itself: {' → '.join(circle)}")
        registry.plugins = {name: registry.plugins[name] for name in order}

    def _import_class(self, plugin: ManagedPlugin) -> None:
        try:
            self._in_time(plugin, lambda: plugin.plugin_class, None)
        except PluginError as error:
            self._leave_out(plugin, error)

    def _attempt(self, plugin: ManagedPlugin, do: Callable[[], None]) -> None:
        """Do one step of a plugin's start; if that fails it is skipped with the reason."""
        registry = self._registry
        if plugin.state is PluginState.FAULTED:
            return
        try:
            for required in plugin.manifest.tag.requires:
                if registry.is_foreign(required):
                    continue
                other = registry.get(required)
                if other.state in (PluginState.FAULTED, PluginState.INACTIVE):
                    raise PluginInactive(required, f"requires {required}, which is left out: {other.state_reason}")
                if other.plugin_class.level >= plugin.plugin_class.level:
                    raise level_conflict(plugin.name, plugin.plugin_class, required, other.plugin_class)
            self._in_time(plugin, do, None)
        except HardwareAbsent as error:
            logger.warning("%s: plugin %s is left out: %s", registry.robot, plugin.name, error)
            plugin.apply(Trigger.LEAVE_OUT, f"hardware absent: {error}", lacks=registry.lacked_by(plugin, error))
        except PluginError as error:
            self._leave_out(plugin, error)
        except FOREIGN_ERRORS as error:  # foreign plugin code
            if registry.lacked_by(plugin, error):
                self._leave_out(plugin, error)
            else:
                plugin.fault(error)

    def _leave_out(self, plugin: ManagedPlugin, error: ForeignError) -> None:
        if isinstance(error, PackageMissing):
            plugin.apply(Trigger.LEAVE_OUT, f"needs {error.needed}", error)
            logger.info("%s: plugin %s is left out: %s", self._registry.robot, plugin.name, error)
            return
        outside = error.for_outside() if isinstance(error, ManifestError) else error
        lacks = self._registry.lacked_by(plugin, error)
        plugin.apply(Trigger.LEAVE_OUT, str(outside), error, lacks=lacks)
        what = f"{self._registry.robot}: plugin {plugin.name} is left out"
        if lacks:
            logger.info("%s: %s", what, error)
        else:
            log_error(logger, what, error)

    def _in_time(self, plugin: ManagedPlugin, do: Callable[[], object], give_up: GiveUp | None) -> None:
        """Do something with a plugin that may hang; in live, if it takes longer than its `start_s`, it is given up."""
        pool = self._registry.starters
        if pool is None:
            do()
            return
        limit_s = plugin.manifest.tag.start_s
        error = pool.run({plugin.name: do}, limit_s).get(plugin.name)
        if isinstance(error, NotBack):
            reason = f"{plugin.name} has not come back from its start for {limit_s:g} s"
            rest = None
            if give_up is not None:
                rest = give_up(reason)
            else:
                plugin.apply(Trigger.ABANDON, reason)
            if rest is not None and isinstance(pool.run({plugin.name: rest}, limit_s).get(plugin.name), NotBack):
                plugin.apply(Trigger.ABANDON, reason)
            raise PluginHung(plugin.name, reason)
        if error is not None:
            raise error
