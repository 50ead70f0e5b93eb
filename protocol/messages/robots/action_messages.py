"""Long actions of a robot's plugins: their ids, progress and ends."""

from enum import StrEnum
from typing import Any, NewType

import msgspec

ActionId = NewType("ActionId", str)
"""Result of a function that starts a long action."""


class Outcome(StrEnum):
    """How an action ended."""

    DONE = "done"
    SUPERSEDED = "superseded"
    """Another action, or another call, has taken its place."""
    CANCELLED = "cancelled"
    FAILED = "failed"


class ActionProgress(msgspec.Struct, frozen=True, kw_only=True):
    """Progress of an action, published at most twice a second."""

    action: str
    share: float
    """0 to 1."""


class ActionEnd(msgspec.Struct, frozen=True, kw_only=True):
    """The end of an action; notified once for each started action."""

    action: str
    outcome: Outcome
    why: str = ""
    result: Any = None
    """Purpose of the action, if it has one."""
    by: str | msgspec.UnsetType = msgspec.UNSET
    """Name of the plugin that superseded it, such as `explore`, or of the action; absent if nothing did."""

    @property
    def words(self) -> str:
        """The end in words, without the result."""
        return self.why if self.outcome is Outcome.SUPERSEDED else f"{self.outcome}{self.why and f': {self.why}'}"
