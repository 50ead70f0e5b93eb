"""Faults of the wire: which messages between two components are lost or late.

A message crosses a fault if one of sender and receiver is on the fault's side and the other is not. `FaultyExchange`
asks for each message, `TeamRadio` for each hop.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from robrain.protocol.clock import Clock, to_ns
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec


class Cut(NamedTuple):
    """A fault of the wire that has begun."""

    fault: FaultSpec
    side: frozenset[str]
    since_ns: int

    @property
    def is_partition(self) -> bool:
        """Whether nothing crosses it."""
        return self.fault.kind is FaultKind.PARTITION

    def crosses(self, one: str, other: str) -> bool:
        """Whether it is between two components; an empty name is no component."""
        return bool(one and other) and (one in self.side) != (other in self.side)


class WireFaults:
    """The faults of the wire that are in force.

    Args:
        clock: of the run.
        seed: of the run, from which losses and delays are drawn.

    """

    def __init__(self, clock: Clock, seed: int) -> None:
        self.lost = 0
        """Messages, requests and replies that were lost so far."""
        self._clock = clock
        self._rng = np.random.default_rng([seed, 11])
        self._cuts: dict[int, Cut] = {}
        self._latest_ns: dict[tuple[str, str], int] = {}

    def __bool__(self) -> bool:
        """Whether there is any."""
        return bool(self._cuts)

    def __iter__(self) -> Iterator[Cut]:
        """The faults in the order in which they began."""
        return iter(self._cuts.values())

    def begin(self, number: int, fault: FaultSpec) -> None:
        """A fault begins."""
        self._cuts[number] = Cut(fault, frozenset((fault.robot, *fault.side)), self._clock.now_ns())

    def end(self, number: int) -> Cut:
        """A fault ends; returns it."""
        self._latest_ns.clear()
        return self._cuts.pop(number)

    def is_linked(self, one: str, other: str) -> bool:
        """Whether no partition is between two components."""
        return not any(cut.is_partition and cut.crosses(one, other) for cut in self._cuts.values())

    def reorders(self, one: str, other: str) -> bool:
        """Whether messages between two components overtake each other."""
        return any(cut.fault.kind is FaultKind.REORDER and cut.crosses(one, other) for cut in self._cuts.values())

    def fate(self, sender: str, receiver: str) -> int | None:
        """By how much a message is late, ns; None if it is lost."""
        late_ns, now_ns = 0, self._clock.now_ns()
        for cut in self._cuts.values():
            if not cut.crosses(sender, receiver):
                continue
            fault = cut.fault
            if fault.kind is FaultKind.PARTITION:
                return None
            if fault.share is not None and self._rng.random() < fault.share:
                return None
            if fault.late_s is not None:
                drawn_ns = to_ns(float(self._rng.uniform(*fault.late_s)))
                if fault.kind is FaultKind.DELAY:
                    pair = (sender, receiver)
                    due_ns = self._latest_ns[pair] = max(self._latest_ns.get(pair, 0), now_ns + drawn_ns)
                    drawn_ns = due_ns - now_ns
                late_ns = max(late_ns, drawn_ns)
        return late_ns
