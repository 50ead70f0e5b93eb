"""A reload: a new instance is made beside the old and takes its place; if anything fails the old one keeps running."""

import logging
from collections.abc import Callable
from enum import Enum, auto

from robrain.agent.errors import FOREIGN_ERRORS
from robrain.agent.lifecycle.instance import Instance
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.lifecycle.plugin_code import import_code
from robrain.agent.lifecycle.transitions import Trigger
from robrain.agent.manifest import Manifest
from robrain.agent.plugin import Plugin, PluginState

logger = logging.getLogger(__name__)

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
        plugin: whose instance it is.
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
        self._before, self._why = plugin.state, plugin.why
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

    def give_up(self, why: str) -> Callable[[], None]:
        """Somebody is stuck in the new instance: leave it to them and put the old one back in its place.

        Args:
            why: the reason, for a plugin that has no instance then: they are stuck in the old one.

        Returns:
            What is left to do, and may take its time.

        """
        stage, self._stage = self._stage, _Stage.GIVEN_UP
        plugin = self._plugin
        if stage in (_Stage.LEAVING, _Stage.DONE):
            plugin.apply(Trigger.ABANDON, why)
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
        plugin.apply(Trigger.REACTIVATE, plugin.why)
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
        plugin.apply(trigger, self._why)
        plugin.swap(old, self._old_manifest, self._old_code)
        if old is not None:
            old.take_over(old)
        if self._before is PluginState.FAULTED:
            plugin.apply(Trigger.LEAVE_OUT, self._why)

    def _start_old(self) -> None:
        if self._old is None or not self._before.is_running:
            return
        try:
            self._plugin.activate()
        except FOREIGN_ERRORS as error:  # foreign plugin code
            self._plugin.fault(error)
