"""Faults of the wire: messages are lost, late or out of order, and components are cut off."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from robrain.protocol.clock import to_ns
from robrain.protocol.messages.team.arena_messages import LinkCounters
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec

UPDATE_PERIOD_NS = to_ns(0.1)
"""Period in which components find out whether they still reach each other."""
_RNG_OF_FAULTS = 11


class Cut(NamedTuple):
    """A fault of the wire that has begun."""

    fault: FaultSpec
    side: frozenset[str]

    def crosses(self, one: str, other: str) -> bool:
        """Whether it is between two components."""
        return (one in self.side) != (other in self.side)


class WireFaults:
    """A `Network` with the faults of the wire that are in force; without one every message arrives at once.

    A request or reply that is lost is not sent again, so that its caller gets a timeout.

    Args:
        seed: of the run, from which losses and delays are drawn.

    """

    parties: Sequence[str] = ()

    def __init__(self, seed: int) -> None:
        self.counters = LinkCounters()
        self.is_open = True
        self.lost = 0
        """Messages, requests and replies that were lost so far."""
        self._rng = np.random.default_rng([seed, _RNG_OF_FAULTS])
        self._cuts: dict[int, Cut] = {}
        self._on: Collection[str] | None = None
        self._update_ns: int | None = 0

    def begin(self, number: int, fault: FaultSpec) -> None:
        """A fault begins."""
        self._cuts[number] = Cut(fault, frozenset((fault.robot, *fault.side)))
        self.is_open, self._update_ns = False, 0

    def end(self, number: int) -> None:
        """A fault ends."""
        del self._cuts[number]
        self.is_open, self._update_ns = not self._cuts, 0

    def update(self, now_ns: int, on: Collection[str]) -> bool:
        """See `Network`."""
        if on == self._on and (self._update_ns is None or now_ns < self._update_ns):
            return False
        self._on, self._update_ns = on, None if self.is_open else now_ns + UPDATE_PERIOD_NS
        return True

    def reaches(self, source: str, target: str) -> bool:
        """See `Network`: whether no partition is between two components."""
        return not self._has(FaultKind.PARTITION, source, target)

    def overtakes(self, source: str, target: str) -> bool:
        """See `Network`."""
        return self._has(FaultKind.REORDER, source, target)

    def spread(self, source: str, targets: Sequence[str], size: int, now_ns: int) -> dict[str, int]:
        """See `Network`."""
        delays_ns = {target: self.delay_ns(source, target) for target in targets}
        return {target: delay_ns for target, delay_ns in delays_ns.items() if delay_ns is not None}

    def carry(self, source: str, target: str, size: int, now_ns: int, limit_ns: int) -> int | None:
        """See `Network`."""
        return self.delay_ns(source, target)

    def delay_ns(self, source: str, target: str) -> int | None:
        """By how much a message is late; None if it is lost."""
        late_ns = 0
        for cut in self._cuts.values():
            if not cut.crosses(source, target):
                continue
            fault = cut.fault
            if fault.kind is FaultKind.PARTITION or (fault.share is not None and self._rng.random() < fault.share):
                self.lost += 1
                return None
            if fault.late_s is not None:
                late_ns = max(late_ns, to_ns(float(self._rng.uniform(*fault.late_s))))
        return late_ns

    def _has(self, kind: FaultKind, source: str, target: str) -> bool:
        return any(cut.fault.kind is kind and cut.crosses(source, target) for cut in self._cuts.values())
