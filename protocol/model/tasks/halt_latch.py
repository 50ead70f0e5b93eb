"""The latch of an emergency halt: its holders, and the names that may open it.

The sender of a halt holds the latch and may release it; it opens when it has no holder. An operator opens it for all. A
sender states its own name: the access rules of the wire decide which names it may use.
"""

from robrain.protocol.model.ranges import STAMP_MAX

OPERATOR = "operator"
"""Identities that start with this may end any halt: `operator`, `operator:dashboard`, `operator:ann`."""
NAME_LENGTH = 64
REASON_LENGTH = 200
MOST_HOLDERS = 64
LATEST_NS = STAMP_MAX // 2
"""Later stamps count as this one, so that those after it still fit into messages."""


class HaltLatch:
    """Follows halts and resumes in the order of their arrival.

    Their stamps come from different clocks. `stamp_ns` only grows, so that receivers of the same messages can decide
    whether a report is new.
    """

    def __init__(self) -> None:
        self.stamp_ns = 0
        """Of the last halt or resume; greater than that of the one before, whatever its sender's clock reads."""
        self.since_ns = 0
        """When it was closed, or opened, by its stamp."""
        self.opened_by = ""
        self._holders: dict[str, str] = {}

    @property
    def is_held(self) -> bool:
        """Whether there is a halt."""
        return bool(self._holders)

    @property
    def holders(self) -> list[str]:
        """Names of the holders, in the order of their halts."""
        return list(self._holders)

    @property
    def reason(self) -> str:
        """Reason given with the last halt."""
        return list(self._holders.values())[-1] if self._holders else ""

    def hold(self, by: str, reason: str, stamp_ns: int = 0) -> None:
        """Add a holder; without a stamp it is the next after the last.

        >>> latch = HaltLatch()
        >>> latch.hold("ann", "a person is in the way")
        >>> latch.release("bob")
        'bob may not end the halt of ann: only ann may, or an operator'
        >>> latch.release("operator:bob")
        ''
        """
        self._advance(stamp_ns)
        by = by[:NAME_LENGTH]
        if not self._holders:
            self.since_ns = self.stamp_ns
        if by in self._holders or len(self._holders) < MOST_HOLDERS:
            self._holders.pop(by, None)
            self._holders[by] = reason[:REASON_LENGTH]

    def release(self, by: str, stamp_ns: int = 0) -> str:
        """Remove a holder.

        Returns:
            Why the latch stays closed; empty if it is open.

        """
        by = by[:NAME_LENGTH]
        if not self._holders:
            if by.startswith(OPERATOR):  # it counts also for a halt that was not received
                self._advance(stamp_ns)
            return ""
        names = " and ".join(name or "nobody named" for name in self._holders)
        if by.startswith(OPERATOR):
            self._holders.clear()
        elif by in self._holders:
            del self._holders[by]
        else:
            return f"{by or 'nobody named'} may not end the halt of {names}: only {names} may, or an operator"
        self._advance(stamp_ns)
        if self._holders:
            return f"it is still halted by {' and '.join(self._holders)}"
        self.since_ns = self.stamp_ns
        self.opened_by = by
        return ""

    def _advance(self, stamp_ns: int) -> None:
        self.stamp_ns = max(min(stamp_ns, LATEST_NS), self.stamp_ns + 1)
