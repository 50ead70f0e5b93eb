"""The start of plugins: what can start does; what cannot is left out with the reason, and so is what requires it."""

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from robrain.agent.access import must_merge
from robrain.agent.errors import FOREIGN_ERRORS, HardwareAbsent, ManifestError, PluginError, PluginMissing
from robrain.agent.plugin_state import PluginState
from robrain.agent.plugin_traceback import log_error
from robrain.agent.requirements import start_order, way_to_missing
from robrain.agent.start_in_time import start_in_time

if TYPE_CHECKING:
    from robrain.agent.manager import PluginManager
    from robrain.agent.tag import PluginTag

logger = logging.getLogger(__name__)


class Starter:
    """Starts the plugins of one manager."""

    def __init__(self, manager: "PluginManager") -> None:
        self._manager = manager

    def start_all(self) -> None:
        """Load each plugin, then activate each, requirements first."""
        self.sort()
        for tag in self._manager.tags.values():
            self.attempt(tag, tag.load)
        for tag in self._manager.tags.values():
            self.attempt(tag, tag.activate)

    def pick_up(self, fresh: dict[str, Any]) -> None:
        """Start what was left out, or put aside, for want of what is there now."""
        manager = self._manager
        for tag in list(manager.tags.values()):
            requires = tag.manifest.tag.requires
            waits = tag.state is PluginState.INACTIVE or (tag.state is PluginState.FAULTED and not tag.is_there)
            running = (PluginState.ACTIVE, PluginState.HALTED)
            there = all(
                manager.is_foreign(name) or (name in manager.tags and manager.tags[name].state in running)
                for name in requires
            )
            if waits and there and any(name in fresh for name in requires) and tag.name not in fresh:
                self.begin(tag)
                if tag.state in running:
                    fresh[tag.name] = tag

    def begin(self, tag: "PluginTag") -> None:
        """Start a plugin that is listed but does not run; if that fails it is left out with the reason."""
        tag.state = PluginState.INACTIVE if tag.is_there else PluginState.DISCOVERED
        if not tag.is_there:
            self.attempt(tag, tag.load)
        self.attempt(tag, tag.activate)

    def sort(self) -> None:
        """Find the start order anew, and leave out what requires itself or cannot be imported."""
        manager = self._manager
        for tag in manager.tags.values():
            if tag.state is PluginState.DISCOVERED:
                self._import_class(tag)
        order, circles = start_order(manager.requirements())
        for circle in circles:
            for name in circle:
                manager.tags[name].leave_out(f"requires itself: {' → '.join(circle)}")
        manager.tags = {name: manager.tags[name] for name in order}

    def _import_class(self, tag: "PluginTag") -> None:
        try:
            self.in_time(tag, lambda: tag.plugin_class)
        except PluginError as error:
            self._leave_out(tag, error)

    def attempt(self, tag: "PluginTag", do: Callable[[], None]) -> None:
        """Do one step of a plugin's start; if that fails it is left out with the reason."""
        manager = self._manager
        if tag.state is PluginState.FAULTED:
            return
        try:
            missing = way_to_missing(
                tag.name, manager.requirements(), lambda name: name in manager.tags or manager.is_foreign(name)
            )
            if missing:
                there = ", ".join(manager.tags)
                raise PluginMissing(missing[-1], f"no plugin {missing[-1]} ({' → '.join(missing)}); there are: {there}")
            for required in tag.manifest.tag.requires:
                if manager.is_foreign(required):
                    continue
                other = manager.get(required)
                if other.state is PluginState.FAULTED:
                    raise PluginError(tag.name, f"requires {required}, which is left out: {other.why}")
                if other.plugin_class.level >= tag.plugin_class.level:
                    raise must_merge(tag.name, tag.plugin_class, required, other.plugin_class)
            self.in_time(tag, do)
        except HardwareAbsent as error:
            logger.warning("%s: plugin %s is left out: %s", manager.robot, tag.name, error)
            tag.leave_out(f"hardware absent: {error}")
            tag.drop()
        except PluginError as error:
            self._leave_out(tag, error)
            tag.drop()
        except FOREIGN_ERRORS as error:  # foreign plugin code
            tag.fault(error)

    def in_time(self, tag: "PluginTag", do: Callable[[], object]) -> None:
        """Do something with a plugin that may hang; in live it is then left behind."""
        manager = self._manager
        if manager.crew is None:
            do()
        else:
            start_in_time(manager.crew, tag, do)

    def _leave_out(self, tag: "PluginTag", error: PluginError) -> None:
        outside = error.for_outside() if isinstance(error, ManifestError) else error
        tag.leave_out(str(outside), error)
        log_error(logger, f"{self._manager.robot}: plugin {tag.name} is left out", error)
