"""Times at which the faults of a run begin and end: fixed, after an event, or drawn from the seed."""

from collections.abc import Sequence
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from robrain.protocol.clock import to_ns
from robrain.sim.faults.fault_spec import COORDINATOR, FaultMoment, FaultSpec

_RNG_OF_FAULTS = 7


class FaultChange(NamedTuple):
    """A fault that begins or ends now."""

    number: int
    """Of the fault, in the order of the scenario."""
    fault: FaultSpec
    begins: bool


class FaultTimes:
    """Gives the faults that begin and end.

    Args:
        faults: of the scenario.
        seed: of the run.

    """

    def __init__(self, faults: Sequence[FaultSpec], seed: int) -> None:
        self._due: list[tuple[int, int, bool]] = []
        self._faults = tuple(faults)
        self._waiting: list[int] = []
        self._later_ns = [
            to_ns(float(np.random.default_rng([seed, _RNG_OF_FAULTS, number]).uniform(0.0, fault.within_s)))
            for number, fault in enumerate(faults)
        ]
        for number, fault in enumerate(faults):
            if fault.on is None:
                self._begin(number, 0)
            else:
                self._waiting.append(number)

    @property
    def is_over(self) -> bool:
        """Whether no fault begins or ends any more, unless a fault still waits for an event."""
        return not self._due

    def record(self, moment: FaultMoment, robot: str, now_ns: int) -> None:
        """An event has happened to a robot, or the coordinator."""
        for number in list(self._waiting):
            fault = self._faults[number]
            if fault.on is moment and (COORDINATOR in (fault.robot, robot) or fault.robot == robot):
                self._waiting.remove(number)
                self._begin(number, now_ns)

    def due(self, now_ns: int) -> list[FaultChange]:
        """Faults that begin or end by now and were not returned before, in order of time."""
        found = []
        while self._due and self._due[0][0] <= now_ns:
            _, number, begins = heappop(self._due)
            found.append(FaultChange(number, self._faults[number], begins))
        return found

    def _begin(self, number: int, from_ns: int) -> None:
        fault = self._faults[number]
        start_ns = from_ns + self._later_ns[number]
        heappush(self._due, (start_ns + to_ns(fault.at_s), number, True))
        if fault.until_s is not None:
            heappush(self._due, (start_ns + to_ns(fault.until_s), number, False))
