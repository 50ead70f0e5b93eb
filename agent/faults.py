"""Faults stay where they are: what becomes of a plugin that raises, hangs or floods, and of those that require it."""

import logging
from functools import partial
from typing import TYPE_CHECKING

import msgspec

from robrain.agent.errors import FOREIGN_ERRORS, PluginError, PluginHung
from robrain.protocol.wire.clock import NS_PER_S, to_ns

if TYPE_CHECKING:
    from robrain.agent.manager import PluginManager
    from robrain.agent.tag import PluginTag

logger = logging.getLogger(__name__)

FLOOD_DROPS_A_SECOND = 1000
"""A plugin whose notifications overflow others' mailboxes faster than this floods."""
STEADY_S = 60.0
"""A plugin that has run for so long has its restarts forgiven."""
LONGEST_BACKOFF_S = 30.0
HUNG_PERIOD_NS = to_ns(0.1)


class _Case(msgspec.Struct):
    """A plugin that has faulted, and when it is started again."""

    tag: "PluginTag"
    again_ns: int | None
    started_ns: int = 0
    attempts: int = 0


class FaultDesk:
    """Sees to faults in the host's own turn, where no plugin's lock is held."""

    def __init__(self, manager: "PluginManager") -> None:
        self._manager = manager
        self._cases: dict[str, _Case] = {}
        self._drops: dict[str, int] = {}
        self._looked_ns = 0
        self._looked_hung_ns = 0

    def note(self, tag: "PluginTag", now_ns: int) -> None:
        """A plugin has faulted: put its users aside, let it clean up, and set the time of its restart."""
        if self._manager.tags.get(tag.name) is not tag or tag.state.value != "faulted":
            return
        stuck = tag.turn.owner
        for user in self._manager.users_of(tag.name):
            if user.state.value in ("active", "halted"):
                why = f"requires {tag.name}, which is faulted: {tag.why}"
                try:
                    if stuck is not None and user.turn.owner == stuck:  # it is in a call that does not come back
                        user.abandon(why)
                    else:
                        user.deactivate(why)
                except FOREIGN_ERRORS as error:  # foreign plugin code; it may have called what has faulted
                    logger.debug("%s: %s while it was put aside: %s", self._manager.robot, user.name, error)
        tag.drop()
        policy = tag.manifest.tag
        case = self._cases.get(tag.name)
        attempts = case.attempts if case is not None and case.tag is tag else 0
        if policy.restart != "on-failure" or attempts >= policy.restart_limit:
            self._cases[tag.name] = _Case(tag, None, attempts=attempts)
            return
        wait_s = min(policy.backoff_s * 2**attempts, LONGEST_BACKOFF_S)
        self._cases[tag.name] = _Case(tag, now_ns + to_ns(wait_s), attempts=attempts + 1)

    def forget(self, tag: "PluginTag") -> None:
        """A plugin is loaded anew by hand, or has gone."""
        self._cases.pop(tag.name, None)
        self._drops.pop(tag.name, None)

    def look(self, now_ns: int) -> None:
        """Restart what is due; see who hangs and who floods."""
        for case in list(self._cases.values()):
            if case.again_ns is not None and now_ns >= case.again_ns and not self._manager.halted:
                case.again_ns = None
                self._manager.later(partial(self._restart, case, now_ns))
            elif case.started_ns and now_ns - case.started_ns > to_ns(STEADY_S):
                case.attempts = 0
        if now_ns - self._looked_hung_ns >= HUNG_PERIOD_NS:
            self._looked_hung_ns = now_ns
            self._look_for_hung(now_ns)
        if now_ns - self._looked_ns >= NS_PER_S:
            self._look_for_floods(now_ns)

    def _restart(self, case: _Case, now_ns: int) -> None:
        tag = case.tag
        if self._manager.tags.get(tag.name) is not tag or tag.state.value != "faulted":
            return
        tag.restarts += 1
        case.started_ns = now_ns
        users = self._manager.users_of(tag.name)
        self._manager.begin(tag)
        if tag.state.value not in ("active", "halted"):
            self._manager.note_fault(tag)
            return
        logger.warning("%s: plugin %s is restarted (%d)", self._manager.robot, tag.name, tag.restarts)
        for user in reversed(users):
            if user.state.value in ("inactive", "faulted") and "requires" in user.why:
                self._manager.begin(user)

    def _look_for_hung(self, now_ns: int) -> None:
        overdue = [tag for tag in self._manager.tags.values() if tag.turn.depth and tag.turn.is_overdue(now_ns)]
        if overdue:
            # The lowest one hangs; those above it are in a call to it, and are put aside as its users.
            tag = min(overdue, key=lambda tag: tag.level)
            tag.fault(PluginHung(tag.name, f"{tag.name} has not come back for {tag.turn.limit_s:g} s"))

    def _look_for_floods(self, now_ns: int) -> None:
        elapsed_s = (now_ns - self._looked_ns) / NS_PER_S
        self._looked_ns = now_ns
        for tag in self._manager.tags.values():
            dropped = sum(event.dropped for event in tag.events().values())
            before = self._drops.get(tag.name, 0)
            self._drops[tag.name] = dropped
            if dropped - before > FLOOD_DROPS_A_SECOND * elapsed_s:
                tag.fault(PluginError(tag.name, f"{tag.name} floods: {dropped - before} notifications were lost"))
