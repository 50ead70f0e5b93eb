"""A reload: a new instance is made beside the old and takes its place; if anything fails the old one keeps running."""

import logging
from collections.abc import Callable
from enum import Enum, auto
from typing import TYPE_CHECKING

from robrain.agent.errors import FOREIGN_ERRORS
from robrain.agent.loading import Loaded, PluginCode, import_code
from robrain.agent.manifest import Manifest
from robrain.agent.plugin import Plugin
from robrain.agent.plugin_state import PluginState

if TYPE_CHECKING:
    from robrain.agent.tag import PluginTag

logger = logging.getLogger(__name__)

CheckHeir = Callable[[Manifest, type[Plugin]], None]
"""Whether the edited plugin still fits in with the others; raises PluginError if not."""


class _Stage(Enum):
    """Which foreign code is running."""

    MAKING = auto()
    """The new one is imported, made, initialised."""
    LEAVING = auto()
    """The old one is deactivated."""
    STARTING = auto()
    """The new one is activated."""
    GIVEN_UP = auto()


class Replacement:
    """Replaces the instance of one tag.

    Args:
        tag: of the plugin.
        manifest: the plugin's, read anew.
        old: the instance that is there; None if there is none.
        old_code: what it was made from.
        check: the manager's check of the edited plugin.
        live: as in `import_code`.

    """

    def __init__(
        self,
        tag: "PluginTag",
        manifest: Manifest,
        old: Loaded | None,
        old_code: PluginCode | None,
        check: CheckHeir,
        *,
        live: bool,
    ) -> None:
        self._tag = tag
        self._live = live
        self._manifest = manifest
        self._check_heir = check
        self._old = old
        self._old_code = old_code
        self._old_manifest = tag.manifest
        self._before, self._why = tag.state, tag.why
        self._stage = _Stage.MAKING

    def run(self) -> None:
        """Make the new instance and have it take the old one's place; handles and observers follow.

        Raises:
            PluginError, Exception: why it failed; the old one keeps running then.

        """
        code = import_code(self._manifest, fresh=True, live=self._live)
        self._check_heir(self._manifest, code.plugin_class)
        fresh = self._tag.create(self._manifest, code, heir_of=self._old)
        try:
            with self._tag.turn:
                self._hand_over(fresh)
        except BaseException:
            if self._stage is not _Stage.GIVEN_UP:
                fresh.close()
            raise
        if self._old is not None:
            self._old.close()

    def give_up(self) -> Callable[[], None] | None:
        """Somebody is stuck in the new instance: leave it behind and put the old one back in its place.

        Returns:
            What is left to do, and may take its time; None if it is the old one that they are stuck in.

        """
        stage, self._stage = self._stage, _Stage.GIVEN_UP
        if stage is _Stage.LEAVING:
            return None
        tag = self._tag
        if stage is _Stage.MAKING:
            tag.leave_making()
            if self._old is not None:
                self._old.take_over(self._old)
                tag.environment = self._old.environment
            return lambda: None
        tag.leave_instance()
        self._put_back()
        return self._start_old

    def _hand_over(self, fresh: Loaded) -> None:
        tag = self._tag
        self._stage = _Stage.LEAVING
        try:
            tag.deactivate("it is being reloaded")
        except FOREIGN_ERRORS:
            # Foreign plugin code, which is about to be replaced.
            logger.exception("plugin %s failed while it was reloaded", tag.name)
        tag.hold_instance(fresh, self._manifest, fresh.code)
        self._stage = _Stage.STARTING
        try:
            tag.begin_with(fresh)
        except BaseException:
            if self._stage is not _Stage.GIVEN_UP:
                tag.let_go()
                tag.clean_up(fresh)
                fresh.end_wire()
                self._put_back()
                self._start_old()
            raise

    def _put_back(self) -> None:
        tag, old = self._tag, self._old
        tag.hold_instance(old, self._old_manifest, self._old_code)
        tag.become(self._before, self._why)
        if old is not None:
            old.take_over(old)

    def _start_old(self) -> None:
        tag, old = self._tag, self._old
        if old is None or self._before not in (PluginState.ACTIVE, PluginState.HALTED):
            return
        try:
            with tag.turn:
                tag.begin_with(old)
        except FOREIGN_ERRORS as error:  # foreign plugin code
            tag.fault(error)
