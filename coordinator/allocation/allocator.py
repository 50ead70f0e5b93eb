"""What every allocator promises, its time limit, and the allocators by name.

`[planning] method` of a scenario or a planning file chooses one.
"""

import math
from collections.abc import Callable
from typing import Final, Protocol, runtime_checkable

from robrain.coordinator.allocation.plan import Plan
from robrain.coordinator.allocation.problem import Problem
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.registry import Registry

Monotonic = Callable[[], float]
"""Seconds from some beginning, never going back; it is passed in, as all time is."""

OPTIMAL: Final = "optimal"
"""An auction, improved by a search."""
AUCTION: Final = "auction"
GREEDY: Final = "greedy"


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


@runtime_checkable
class Searching(Protocol):
    """An allocator whose plans another can improve, search by search."""

    def search(self) -> Allocator | None:
        """The one that improves them; None if what it needs is not installed."""


ALLOCATORS: Registry[Callable[[Objective], Allocator]] = Registry(
    "method",
    "robrain.allocators",
    {
        OPTIMAL: "robrain.coordinator.allocation.searched_auction:SearchedAuction",
        AUCTION: "robrain.coordinator.allocation.auction:AuctionAllocator",
        GREEDY: "robrain.coordinator.allocation.auction:GreedyAllocator",
    },
)
"""Each makes an allocator for an objective."""
