"""The allocator interface, its time limit, and the registry of allocators.

The key `method` of `[planning]`, in a scenario or a planning file, selects one by name.
"""

import math
from collections.abc import Callable
from typing import Final, Protocol, runtime_checkable

from robrain.algorithms.allocation.plan import Plan
from robrain.algorithms.allocation.problem import Problem
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.registry import Registry

Monotonic = Callable[[], float]
"""A monotonic clock in seconds, with an arbitrary origin; passed in, as all time is."""

OPTIMAL: Final = "optimal"
"""An auction, improved by a search."""
AUCTION: Final = "auction"
GREEDY: Final = "greedy"


class Allocator(Protocol):
    """Makes plans. Each passes `validate`, and is no worse than the warm start as far as that is feasible."""

    @property
    def objective(self) -> Objective:
        """The objective for which the plans of this allocator are optimised."""

    def plan(
        self,
        problem: Problem,
        *,
        deadline_s: float | None = None,
        iterations: int | None = None,
        seed: int = 0,
        warm_start: Plan | None = None,
    ) -> Plan:
        """Assign the jobs to workers and order them.

        Args:
            problem: jobs, workers and paths.
            deadline_s: return within this many seconds of the allocator's clock.
            iterations: number of search iterations; equal input then gives an equal plan on any machine.
            seed: of the random choices.
            warm_start: an earlier plan, of this problem or a similar one; its jobs and workers may no longer exist. The
                result is at least as good as the part of it that is still feasible.

        """


class Effort:
    """The remaining part of a search's deadline and iterations.

    Raises ValueError if neither is given, because the search would not end.

    Args:
        monotonic: the clock.
        deadline_s: counted from now.
        iterations: in total.

    """

    def __init__(self, monotonic: Monotonic, deadline_s: float | None, iterations: int | None) -> None:
        if deadline_s is None and iterations is None:
            raise ValueError("expected deadline_s or iterations, got neither")
        self._monotonic = monotonic
        self._end_s = math.inf if deadline_s is None else monotonic() + deadline_s
        self._iterations = math.inf if iterations is None else iterations

    @property
    def left_s(self) -> float:
        """Seconds to the deadline; infinite without one, and then the clock is not read."""
        return self._end_s - self._monotonic() if math.isfinite(self._end_s) else math.inf

    @property
    def left_iterations(self) -> float:
        """Remaining iterations; infinite if only the deadline limits the search."""
        return self._iterations

    def spend(self) -> None:
        """Count one iteration."""
        self._iterations -= 1


@runtime_checkable
class Searching(Protocol):
    """An allocator with a companion that improves its plans, one search at a time."""

    def search(self) -> Allocator | None:
        """Return the allocator that improves its plans; None if the package it needs is not installed."""


ALLOCATORS: Registry[Callable[[Objective], Allocator]] = Registry(
    "method",
    "robrain.allocators",
    {
        OPTIMAL: "robrain.algorithms.allocation.searched_auction:SearchedAuction",
        AUCTION: "robrain.algorithms.allocation.auction:AuctionAllocator",
        GREEDY: "robrain.algorithms.allocation.auction:GreedyAllocator",
    },
    has_files=True,
)
"""Each entry makes an allocator for an objective."""
