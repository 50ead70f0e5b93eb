"""What every allocator promises, and how long it may think."""

import math
from collections.abc import Callable
from typing import Protocol

from robrain.coordinator.allocation.plan import Plan
from robrain.coordinator.allocation.problem import Objective, Problem

Monotonic = Callable[[], float]
"""Seconds from some beginning, never going back; it is passed in, as all time is."""


class Allocator(Protocol):
    """Makes plans. Each that it returns passes `validate`; none is worse than its warm start, if that can be kept."""

    @property
    def objective(self) -> Objective:
        """What its plans are good at."""

    def plan(
        self,
        problem: Problem,
        *,
        deadline_s: float | None = None,
        iterations: int | None = None,
        seed: int = 0,
        warm_start: Plan | None = None,
    ) -> Plan:
        """Decide who does what, and in which order.

        Args:
            problem: jobs, workers and ways.
            deadline_s: the answer is there after so many seconds of the allocator's clock.
            iterations: the search does so many rounds; equal input then gives an equal plan, however fast the machine.
            seed: of what is random in it.
            warm_start: an earlier plan, of this problem or one like it. What of it still can be done is the least that
                comes back. Its jobs and workers may be gone.

        """


class Effort:
    """How much of a search's deadline and iterations is left.

    Raises ValueError if neither is given: a search would then not end.

    Args:
        monotonic: the clock.
        deadline_s: from now.
        iterations: in all.

    """

    def __init__(self, monotonic: Monotonic, deadline_s: float | None, iterations: int | None) -> None:
        if deadline_s is None and iterations is None:
            raise ValueError("expected deadline_s or iterations, got neither")
        self._monotonic = monotonic
        self._end_s = math.inf if deadline_s is None else monotonic() + deadline_s
        self._iterations = math.inf if iterations is None else iterations

    @property
    def left_s(self) -> float:
        """Seconds to the deadline; infinite without one. Without one the clock is not read."""
        return self._end_s - self._monotonic() if math.isfinite(self._end_s) else math.inf

    @property
    def left_iterations(self) -> float:
        """Infinite if only the deadline counts."""
        return self._iterations

    def spend(self) -> None:
        """Count one iteration."""
        self._iterations -= 1
